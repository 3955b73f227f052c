"""The control step of the environment as a CasADi function: lag of the actuators, command, drag and motion.

The state of the plant is the state of the environment (`quadpend_gym.physics.state`), followed by the memories y of
the lags, four numbers each. The equations of motion and their integration are those of `controllers.nmpc_model`, the
drag repeats `quadpend_gym.physics.drag`, and the lag `quadpend_gym.actuators.MotorLag`. A test compares the whole step
with the environment (10⁻¹²).
"""

from types import SimpleNamespace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from quadpend_baselines.controllers import nmpc_model
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.drag import AIR_DENSITY
from quadpend_gym.physics.state import ACTION_SIZE, DISTURBANCE_SIZE, STATE_FIELDS, STATE_SIZE
from quadpend_gym.vehicles import PARAMETER_NAMES
from quadpend_gym.vehicles.parameters import PARAMETERS_SIZE
from quadpend_gym.wind import WIND_FIELDS, WIND_SIZE

KNOWN_SIZE = WIND_SIZE + PARAMETERS_SIZE  # wind and parameters of a control period
_SMALLEST_SPEED = 1e-6  # m/s, keeps the drag differentiable at rest; it changes the drag by less than 10⁻¹⁴ N


class Plant(NamedTuple):
    """What determines the motion in a scenario of the paper's vehicle, besides start, parameters and wind."""

    simulation: Simulation  # control period, substeps, and scale of the actions
    moves_air: bool = False  # whether the wind can have a velocity, so that there is drag
    lags: tuple[float, ...] = ()  # time constants of the first-order lags through which the action passes, s
    delay: int = 0  # control steps from an action to the moment when it acts; hover acts before

    @property
    def state_size(self) -> int:
        """Size of the state of the plant."""
        return STATE_SIZE + ACTION_SIZE * len(self.lags)


def symbolic_parameters(vector: Any) -> Any:
    """Return an object with the attributes of `Parameters` that `nmpc_model` reads, of a symbol of shape (9, 1)."""
    named = dict(zip(PARAMETER_NAMES, ca.vertsplit(vector), strict=True))
    return SimpleNamespace(**named, total_mass=named["quadrotor_mass"] + named["bob_mass"])


def drag(area: Any, relative: Any) -> Any:
    """Return the drag ½ ρ A |v| v of `quadpend_gym.physics.drag`, N."""
    return 0.5 * AIR_DENSITY * area * ca.sqrt(ca.sumsqr(relative) + _SMALLEST_SPEED**2) * relative


def disturbance(state: Any, wind: Any, p: Any, moves_air: bool) -> Any:
    """Return d_Q, d_B and d_τ over a control period that begins in `state`, shape (9, 1)."""
    loads = wind[:DISTURBANCE_SIZE]
    if not moves_air:
        return loads
    on_quadrotor = wind[WIND_FIELDS["velocity"]] - state[STATE_FIELDS["velocity"]]
    on_bob = on_quadrotor - p.rod_length * state[STATE_FIELDS["direction_rate"]]
    drags = drag(p.quadrotor_drag_area, on_quadrotor), drag(p.bob_drag_area, on_bob)
    return loads + ca.vertcat(*drags, ca.SX(3, 1))


def step(plant: Plant) -> tuple[Any, Any, Any, Any]:
    """Return the symbols x, a and q and the expression of the state after a control period.

    x is the state of the plant, a the action after its delay, shape (4, 1), and q wind and parameters, shape (21, 1).
    """
    simulation = plant.simulation
    x, a, q = ca.SX.sym("x", plant.state_size), ca.SX.sym("a", ACTION_SIZE), ca.SX.sym("q", KNOWN_SIZE)
    action, memories = a, []
    for i, time_constant in enumerate(plant.lags):
        first = STATE_SIZE + ACTION_SIZE * i
        action, memory = _lagged(action, x[first : first + ACTION_SIZE], simulation.period / time_constant)
        memories.append(memory)
    p = symbolic_parameters(q[WIND_SIZE:])
    command = ca.DM(simulation.command_scale) * (ca.DM([1.0, 0.0, 0.0, 0.0]) + action)
    loads, y = disturbance(x[:STATE_SIZE], q[:WIND_SIZE], p, plant.moves_air), x[:STATE_SIZE]
    for _ in range(simulation.substeps):
        y = nmpc_model.next_state(y, command, loads, p, simulation.period / simulation.substeps)
    return x, a, q, ca.vertcat(y, *memories)


def _lagged(action: Any, memory: Any, ratio: float) -> tuple[Any, Any]:
    """Return the mean action after a lag and its memory y after the period; `ratio` is period over time constant."""
    gap = memory - action
    return action - np.expm1(-ratio) / ratio * gap, action + np.exp(-ratio) * gap


def lag_memories(plant: Plant, actions: Floats) -> Floats:
    """Return the memories of the lags before each action and after the last one, shape (N + 1, 4 × number of lags).

    `actions` are those after the delay, shape (N, 4).
    """
    columns, inputs = [np.zeros((len(actions) + 1, 0))], actions
    for time_constant in plant.lags:
        ratio, memory = plant.simulation.period / time_constant, np.zeros((len(inputs) + 1, ACTION_SIZE))
        outputs = np.empty_like(inputs)
        for k, action in enumerate(inputs):
            outputs[k], memory[k + 1] = _lagged(action, memory[k], ratio)
        inputs = outputs
        columns.append(memory)
    return np.hstack(columns)
