"""Policies in files: networks, their export, and loading by name."""
