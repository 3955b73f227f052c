"""Disturbance models: batched, seeded by episode, and added with ``+``. See `model` for what they say and must do.

| model | where |
|---|---|
| `Constant`, `Sinusoid`, `StillAir`, `Drawn` | `steady` |
| `Gusts`, `PaperGusts` | `gusts` |
| `OrnsteinUhlenbeck`, `Dryden`, `VonKarman` | `turbulence` |

`PRESETS` are winds by name, from the calm to the storm: ``wind="windy"``.
"""

from quadpend_gym.wind.base import KINDS, PRESETS, WIND_FIELDS, WIND_SIZE, Sum, Wind, as_wind
from quadpend_gym.wind.gusts import Gusts, PaperGusts
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

KINDS |= {
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
PRESETS |= {
    "calm": None,
    "breeze": OrnsteinUhlenbeck(0.15),
    "windy": OrnsteinUhlenbeck(0.3),
    "storm": Drawn(Dryden("moderate")) + Gusts(velocity=(6.0, 0.0, 0.0)),
    "paper": PaperGusts(onset=2.0),
}
