"""Presets of wind, and the door for everything that names a wind."""

from quadpend_gym.wind.base import WINDS
from quadpend_gym.wind.gusts import Gusts, PaperGusts
from quadpend_gym.wind.steady import Drawn
from quadpend_gym.wind.turbulence import Dryden, OrnsteinUhlenbeck

__all__ = ["KINDS", "PRESETS", "as_wind"]

as_wind, KINDS, PRESETS = WINDS.parse, WINDS.kinds, WINDS.presets
PRESETS |= {
    "calm": None,
    "breeze": OrnsteinUhlenbeck(0.15),
    "windy": OrnsteinUhlenbeck(0.3),
    "storm": Drawn(Dryden("moderate")) + Gusts(velocity=(6.0, 0.0, 0.0)),
    "paper": PaperGusts(onset=2.0),
}
