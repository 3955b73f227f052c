"""Wrappers that bring the wind, for a single environment and for a vector of them."""

from quadpend_gym.wrappers.wind import VectorWindWrapper, WindWrapper

__all__ = ["VectorWindWrapper", "WindWrapper"]
