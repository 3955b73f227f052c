"""Classical controllers by name, with the gains that stand in `gains`."""

from collections.abc import Callable
from functools import partial
from typing import Any

from baselines.adrc import ADRC
from baselines.flatness import Flatness
from baselines.gains import GAINS
from baselines.lqr import Lqr
from baselines.mppi import Mppi
from baselines.observed import Observed
from baselines.policy import Policy
from quadpend_gym import Simulation

# name: makes the controller of its gains and of what it believes of the plant and its actuators
MAKERS: dict[str, Callable[[Any, Simulation | None], Policy]] = {
    "adrc-paper": ADRC,
    "adrc-matched": ADRC,
    "adrc-tuned": ADRC,
    "adrc-linear": ADRC,
    "lqr": partial(Observed, Lqr),
    "lqi": partial(Observed, Lqr),
    "flatness": partial(Observed, Flatness),
    "mppi": partial(Observed, Mppi),
}
CONTROLLERS = tuple(MAKERS)


def controller(name: str, simulation: Simulation | None = None) -> Policy:
    """The controller called `name`.

    Args:
        name: one of `CONTROLLERS`.
        simulation: what it believes of the plant and its actuators; None: the paper's.

    Raises:
        ValueError: there is no such controller.
    """
    if name not in MAKERS:
        raise ValueError(f"there is no controller {name!r}; there are {', '.join(CONTROLLERS)}")
    return MAKERS[name](GAINS[name], simulation)
