"""Kinds and presets of wind models by name."""

from typing import Any

from quadpend_gym.wind.base import WINDS, Sum
from quadpend_gym.wind.gusts import Gusts, PaperGusts
from quadpend_gym.wind.steady import Constant, Drawn, Rescaled, Sinusoid, StillAir
from quadpend_gym.wind.turbulence import Dryden, OrnsteinUhlenbeck, VonKarman

KINDS, PRESETS = WINDS.kinds, WINDS.presets

KINDS |= {
    "constant": Constant,
    "sinusoid": Sinusoid,
    "still_air": StillAir,
    "drawn": Drawn,
    "rescaled": Rescaled,
    "gusts": Gusts,
    "paper_gusts": PaperGusts,
    "ornstein_uhlenbeck": OrnsteinUhlenbeck,
    "dryden": Dryden,
    "von_karman": VonKarman,
    "sum": Sum,
}

PRESETS |= {
    "calm": None,
    "breeze": OrnsteinUhlenbeck(0.15),
    "windy": OrnsteinUhlenbeck(0.3),
    "storm": Drawn(Dryden("moderate")) + Gusts(velocity=(6.0, 0.0, 0.0)),
    "paper": PaperGusts(onset=2.0),
}


def as_wind(value: Any) -> tuple[Any, ...]:
    """Convert `value` to a tuple of wind models; see `quadpend_gym.core.models.Registry.parse`."""
    return WINDS.parse(value)
