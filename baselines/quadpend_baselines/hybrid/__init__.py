"""Hybrids: a classical base controller combined with a learned policy."""

from quadpend_baselines.hybrid.bandwidth_scheduling import BandwidthScheduling
from quadpend_baselines.hybrid.estimate_only import EstimateOnly
from quadpend_baselines.hybrid.protocol import Hybrid, HybridMemory
from quadpend_baselines.hybrid.registry import HYBRIDS, hybrid_from_data
from quadpend_baselines.hybrid.residual_action import ResidualAction
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
