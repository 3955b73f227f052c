"""Wind and other disturbance models.

Every model acts on a batch of sub-environments, draws its random numbers from the stream of the episode, and can be
added to other models with ``+``. `base` defines the interface and the units. A model is declared, registered and named
in ``__all__`` in its module, and nowhere else.

| models                                                | module       |
|-------------------------------------------------------|--------------|
| `Constant`, `Sinusoid`, `StillAir`, `Drawn`, `Rescaled` | `steady`     |
| `Gusts`, `PaperGusts`                                 | `gusts`      |
| `OrnsteinUhlenbeck`, `Dryden`, `VonKarman`            | `turbulence` |
| `KINDS` and `PRESETS` (as in ``wind="windy"``)        | `registry`   |
"""

from quadpend_gym.wind.base import *
from quadpend_gym.wind.gusts import *
from quadpend_gym.wind.registry import *
from quadpend_gym.wind.steady import *
from quadpend_gym.wind.time_series import *
from quadpend_gym.wind.turbulence import *
