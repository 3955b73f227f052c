"""Classical controllers by name, with the gains of `gains.GAINS`."""

from collections.abc import Callable
from functools import partial
from typing import Any

from quadpend_baselines import gains
from quadpend_baselines.controllers.adrc import ADRC
from quadpend_baselines.controllers.controller import Controller
from quadpend_baselines.controllers.dual_mode import DualMode
from quadpend_baselines.controllers.flatness import Flatness
from quadpend_baselines.controllers.lqg import Lqg
from quadpend_baselines.controllers.lqr import Lqr
from quadpend_baselines.controllers.nmpc import Nmpc
from quadpend_baselines.controllers.output_feedback import OutputFeedback
from quadpend_baselines.controllers.swing_up import SwingUp
from quadpend_baselines.controllers.vehicle_gains import gains_for
from quadpend_gym import Simulation
from quadpend_gym.core.settings import suggest

# Each factory makes a controller from its gains, or a function that returns them for a nominal simulation, and the
# nominal simulation (None: the default). Here they are listed by the class of the gains, below by the controller.
_FACTORIES: dict[type, Callable[[Any, Simulation | None], Controller]] = {
    gains.AdrcGains: ADRC,
    gains.LqrGains: partial(OutputFeedback, Lqr),
    gains.FlatnessGains: partial(OutputFeedback, Flatness),
    gains.DualModeGains: partial(OutputFeedback, DualMode),
    gains.LqgGains: partial(OutputFeedback, Lqg),
    gains.NmpcGains: partial(OutputFeedback, Nmpc),
    gains.SwingUpGains: SwingUp,
}
CONTROLLER_FACTORIES = {
    name: _FACTORIES[type(gains.GAINS[name.removesuffix(gains.UNPREDICTED)])] for name in gains.DESCRIPTIONS
}
CONTROLLERS = tuple(CONTROLLER_FACTORIES)


def controller(name: str, simulation: Simulation | None = None) -> Controller:
    """Return the controller with a name, one of `CONTROLLERS`.

    It is designed for the nominal vehicle, interface and control period of `simulation`; None: the default simulation,
    which has the paper's vehicle. The gains are those of the vehicle, see `controllers.vehicle_gains`.
    """
    if name not in CONTROLLER_FACTORIES:
        raise ValueError(
            f"there is no controller {name!r}{suggest(name, CONTROLLERS)}; there are {', '.join(CONTROLLERS)}"
        )
    return CONTROLLER_FACTORIES[name](partial(gains_for, name), simulation)
