"""Shared foundations: array types, compilation, validation, random streams, and models as data."""
