"""Wind and other disturbance models.

Every model acts on a batch of sub-environments, draws its random numbers from the stream of the episode, and can be
added to other models with ``+``. `base` defines the interface and the units. A model is declared, registered and named
in ``__all__`` in its module, and nowhere else.
"""

from quadpend_gym.wind.base import *
from quadpend_gym.wind.base import WINDS
from quadpend_gym.wind.gusts import *
from quadpend_gym.wind.hand import *
from quadpend_gym.wind.steady import *
from quadpend_gym.wind.steady import Relative
from quadpend_gym.wind.turbulence import *

as_wind, KINDS, PRESETS = WINDS.parse, WINDS.kinds, WINDS.presets
PRESETS |= {  # as in ``wind="windy"``
    "calm": None,
    "breeze": Relative({"kind": "ornstein_uhlenbeck", "force": 0.15}),
    "windy": Relative({"kind": "ornstein_uhlenbeck", "force": 0.3}),
    "storm": Relative(
        [
            {"kind": "drawn", "wind": {"kind": "dryden", "intensity": "moderate"}},
            {"kind": "gusts", "velocity": (6.0, 0.0, 0.0)},
        ]
    ),
    "paper": Relative({"kind": "paper_gusts", "onset": 2.0}),
}
