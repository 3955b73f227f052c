"""Classical controllers by name, with the gains of `gains.GAINS`."""

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

# Each factory makes a controller from its gains and the nominal simulation (None: the default).
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
    """Return the controller with a name.

    Args:
        name: One of `CONTROLLERS`.
        simulation: Nominal plant, torque limits and control period; None: the default simulation, which has the paper's
            parameters.

    Raises:
        ValueError: If no controller has this name.
    """
    if name not in CONTROLLER_FACTORIES:
        raise ValueError(f"there is no controller {name!r}; there are {', '.join(CONTROLLERS)}")
    return CONTROLLER_FACTORIES[name](GAINS[name], simulation)
