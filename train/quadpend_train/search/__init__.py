"""Searches for gains of controllers."""
