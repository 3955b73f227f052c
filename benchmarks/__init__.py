"""Benchmarks: how fast everything is, beside something measured in the same run."""
