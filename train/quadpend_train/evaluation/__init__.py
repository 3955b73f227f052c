"""Evaluation of policies: episodes, results, statistics and comparisons."""
