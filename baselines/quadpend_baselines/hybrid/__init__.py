"""Hybrids: a classical base controller combined with a learned policy."""

from quadpend_baselines.hybrid.hybrids import (
    HYBRIDS,
    BandwidthScheduling,
    EstimateOnly,
    Hybrid,
    HybridMemory,
    ResidualAction,
    hybrid_from_data,
)
from quadpend_baselines.hybrid.wrappers import HybridWrapper, VectorHybridWrapper

__all__ = [
    "HYBRIDS",
    "BandwidthScheduling",
    "EstimateOnly",
    "Hybrid",
    "HybridMemory",
    "HybridWrapper",
    "ResidualAction",
    "VectorHybridWrapper",
    "hybrid_from_data",
]
