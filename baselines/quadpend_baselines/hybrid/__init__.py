"""Hybrids: a classical base controller combined with a learned policy."""

from quadpend_baselines.hybrid.hybrids import *
from quadpend_baselines.hybrid.wrapper import VectorHybridWrapper as VectorHybridWrapper
