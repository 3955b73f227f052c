"""Models for controller design: linear model, flat outputs, Taylor series."""
