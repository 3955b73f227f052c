"""Wind and other disturbance models.

Every model acts on a batch of sub-environments, draws its random numbers from the stream of the episode, and can be
added to other models with ``+``. `base` defines the interface and the units.

| models                                                | module       |
|-------------------------------------------------------|--------------|
| `Constant`, `Sinusoid`, `StillAir`, `Drawn`, `Rescaled` | `steady`     |
| `Gusts`, `PaperGusts`                                 | `gusts`      |
| `OrnsteinUhlenbeck`, `Dryden`, `VonKarman`            | `turbulence` |
| `KINDS` and `PRESETS` (as in ``wind="windy"``)        | `registry`   |
"""

from quadpend_gym.wind.base import WIND_FIELDS, WIND_SIZE, Sum, Wind, WindFromFactory
from quadpend_gym.wind.gusts import Gusts, PaperGusts
from quadpend_gym.wind.registry import KINDS, PRESETS, as_wind
from quadpend_gym.wind.steady import Constant, Drawn, Rescaled, Sinusoid, StillAir
from quadpend_gym.wind.time_series import time_series
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
    "Rescaled",
    "Sinusoid",
    "StillAir",
    "Sum",
    "VonKarman",
    "Wind",
    "WindFromFactory",
    "as_wind",
    "time_series",
]
