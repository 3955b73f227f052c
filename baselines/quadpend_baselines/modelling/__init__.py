"""Models that controllers are designed with: linearisation, flat outputs, Taylor series."""
