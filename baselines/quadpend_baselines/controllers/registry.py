"""Classical controllers by name, with the gains that stand in `gains`."""

from collections.abc import Callable
from functools import partial
from typing import Any

from quadpend_baselines.controllers.adrc import ADRC
from quadpend_baselines.controllers.flatness import Flatness
from quadpend_baselines.controllers.lqr import Lqr
from quadpend_baselines.controllers.mppi import Mppi
from quadpend_baselines.controllers.output_feedback import OutputFeedback
from quadpend_baselines.gains import GAINS
from quadpend_baselines.policy.protocol import Policy
from quadpend_gym import Simulation

# name: makes the controller of its gains and of what it believes of the plant and its actuators
CONTROLLER_FACTORIES: dict[str, Callable[[Any, Simulation | None], Policy]] = {
    "adrc-paper": ADRC,
    "adrc-matched": ADRC,
    "adrc-tuned": ADRC,
    "adrc-linear": ADRC,
    "lqr": partial(OutputFeedback, Lqr),
    "lqi": partial(OutputFeedback, Lqr),
    "flatness": partial(OutputFeedback, Flatness),
    "mppi": partial(OutputFeedback, Mppi),
}
CONTROLLERS = tuple(CONTROLLER_FACTORIES)


def controller(name: str, simulation: Simulation | None = None) -> Policy:
    """The controller called `name`.

    Args:
        name: one of `CONTROLLERS`.
        simulation: what it believes of the plant and its actuators; None: the paper's.

    Raises:
        ValueError: there is no such controller.
    """
    if name not in CONTROLLER_FACTORIES:
        raise ValueError(f"there is no controller {name!r}; there are {', '.join(CONTROLLERS)}")
    return CONTROLLER_FACTORIES[name](GAINS[name], simulation)
