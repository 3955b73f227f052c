"""Benchmarks, which make runs and which are not installed: speed, training time, and golden hashes of results."""
