"""Hybrids of a classical controller and a learned policy."""
