"""Searches for gains of controllers and for settings of learners."""
