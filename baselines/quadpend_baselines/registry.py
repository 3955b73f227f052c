"""Classical controllers by name, with the gains of `gains.GAINS`."""

from collections.abc import Callable
from functools import partial
from typing import Any

from quadpend_baselines.controllers.adrc import ADRC
from quadpend_baselines.controllers.controller import Controller
from quadpend_baselines.controllers.dual_mode import DualMode
from quadpend_baselines.controllers.flatness import Flatness
from quadpend_baselines.controllers.lqr import Lqr
from quadpend_baselines.controllers.mppi import Mppi
from quadpend_baselines.controllers.nmpc import Nmpc
from quadpend_baselines.controllers.output_feedback import OutputFeedback
from quadpend_baselines.controllers.swing_up import SwingUp
from quadpend_baselines.controllers.vehicle_gains import gains_for
from quadpend_gym import Simulation
from quadpend_gym.core.settings import suggest

# Each factory makes a controller from its gains, or a function that returns them for a nominal simulation, and the
# nominal simulation (None: the default).
CONTROLLER_FACTORIES: dict[str, Callable[[Any, Simulation | None], Controller]] = {
    "adrc-paper": ADRC,
    "adrc-matched": ADRC,
    "adrc-tuned": ADRC,
    "adrc-linear": ADRC,
    "lqr": partial(OutputFeedback, Lqr),
    "lqi": partial(OutputFeedback, Lqr),
    "flatness": partial(OutputFeedback, Flatness),
    "dual-mode": partial(OutputFeedback, DualMode),
    "mppi": partial(OutputFeedback, Mppi),
    "nmpc": partial(OutputFeedback, Nmpc),
    "flatness-unpredicted": partial(OutputFeedback, Flatness),
    "lqr-unpredicted": partial(OutputFeedback, Lqr),
    "swing-up": SwingUp,
}
CONTROLLERS = tuple(CONTROLLER_FACTORIES)
DESCRIPTIONS = {
    "adrc-paper": "the paper's ADRC with discontinuous observers (ADRC-DESO), its control law and its gains",
    "adrc-matched": "adrc-paper, with the force of the wind also estimated and compensated where it enters",
    "adrc-tuned": "adrc-matched with tuned gains",
    "adrc-linear": "adrc-tuned with linear observers",
    "lqr": "linear-quadratic regulator around hover, with feedforward of the reference",
    "lqi": "lqr with integrators",
    "flatness": "nonlinear, flatness-based cascade",
    "dual-mode": "flatness, which becomes an optimal linear feedback near the reference",
    "mppi": "model-predictive control with sampled trajectories (MPPI) around a linear feedback",
    "nmpc": "nonlinear model-predictive control by real-time iterations; needs CasADi",
    "flatness-unpredicted": "flatness, without the prediction through known delays and lags",
    "lqr-unpredicted": "lqr, without the prediction through known delays and lags",
    "swing-up": "planned swing-up of a hanging pendulum with linear-quadratic feedback; flatness then balances it",
}


def controller(name: str, simulation: Simulation | None = None) -> Controller:
    """Return the controller with a name.

    Args:
        name: One of `CONTROLLERS`.
        simulation: Nominal vehicle, interface and control period; None: the default simulation, which has the paper's
            vehicle. The gains are those of the vehicle, see `controllers.vehicle_gains`.

    Raises:
        ValueError: If no controller has this name.
    """
    if name not in CONTROLLER_FACTORIES:
        raise ValueError(
            f"there is no controller {name!r}{suggest(name, CONTROLLERS)}; there are {', '.join(CONTROLLERS)}"
        )
    return CONTROLLER_FACTORIES[name](partial(gains_for, name), simulation)
