"""One script for each published page of docs/, run from the root of a checkout: ``python -m experiments.results``."""
