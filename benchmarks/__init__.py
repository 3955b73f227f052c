"""Benchmarks, run by make and not installed: speed, training time, and hashes that prove that no number changed."""
