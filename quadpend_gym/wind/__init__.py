"""Disturbance models: batched, seeded by episode, and added with ``+``. See `model` for what they say and must do.

| model | where |
|---|---|
| `Constant`, `Sinusoid`, `StillAir`, `Drawn` | `steady` |
| `Gusts`, `PaperGusts` | `gusts` |
| `OrnsteinUhlenbeck`, `Dryden`, `VonKarman` | `turbulence` |

`PRESETS` are winds by name, from the calm to the storm: ``wind="windy"``.
"""

from typing import Any

from quadpend_gym.models import Family
from quadpend_gym.wind.gusts import Gusts, PaperGusts
from quadpend_gym.wind.model import WIND_FIELDS, WIND_SIZE, Sum, Wind
from quadpend_gym.wind.series import series
from quadpend_gym.wind.steady import Constant, Drawn, Sinusoid, StillAir
from quadpend_gym.wind.turbulence import Dryden, OrnsteinUhlenbeck, VonKarman

__all__ = [
    "KINDS",
    "PRESETS",
    "WIND_FIELDS",
    "WIND_SIZE",
    "Constant",
    "Drawn",
    "Dryden",
    "Gusts",
    "OrnsteinUhlenbeck",
    "PaperGusts",
    "Sinusoid",
    "StillAir",
    "Sum",
    "VonKarman",
    "Wind",
    "as_wind",
    "series",
]

KINDS: dict[str, type[Any]] = {
    "constant": Constant,
    "sinusoid": Sinusoid,
    "still_air": StillAir,
    "drawn": Drawn,
    "gusts": Gusts,
    "paper_gusts": PaperGusts,
    "ornstein_uhlenbeck": OrnsteinUhlenbeck,
    "dryden": Dryden,
    "von_karman": VonKarman,
    "sum": Sum,
}
PRESETS: dict[str, Any] = {}
_FAMILY = Family("wind", "a wind model, the name of a wind", Wind, KINDS, PRESETS)


def as_wind(value: Any) -> tuple[Any, ...]:
    """The wind models that `value` is or describes; see `models.Family.members`."""
    return _FAMILY.members(value)


PRESETS |= {
    "calm": None,
    "breeze": OrnsteinUhlenbeck(0.15),
    "windy": OrnsteinUhlenbeck(0.3),
    "storm": Drawn(Dryden("moderate")) + Gusts(velocity=(6.0, 0.0, 0.0)),
    "paper": PaperGusts(onset=2.0),
}
