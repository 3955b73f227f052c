"""The control step, the observation and the references as functions of CasADi.

Every function is a `casadi.Function` with named arguments and results, which are column vectors. Derivatives are made
by ``function.factory``, for example the Jacobian of the next state with respect to the action by
``f.factory("B", f.name_in(), ["jac:next_state:action"])``, and products with the transposed Jacobian by
``["adj:state"]`` of ``[*f.name_in(), "adj:next_state", "adj:next_memory"]``.

| argument or result | size | unit and frame |
|---|---|---|
| state, next_state | 18 | `quadpend_gym.physics.state` |
| memory, next_memory | k | what a vehicle has besides the state, see `step_function` |
| action | 4 | components in [−1, 1], of the simulation's interface |
| wind | 12 | d_Q, d_B (N), d_τ (N·m), air velocity (m/s), `quadpend_gym.wind`; constant during a control period |
| parameters | 9 | `Parameters.as_array` |
| loop | 10 + s | of an episode with a drawn loop, see `Schedule.loops` |
| hand | 4 | of a wind with a hand, `quadpend_gym.wind` |
| point | 24 | derivatives of order 0 to 6 of (F_x, F_y, z), and of order 0 to 2 of ψ; `ReferencePoint` |
"""

from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.engines.lifting import columns, lift, vector
from quadpend_gym.envs.loops import Schedule
from quadpend_gym.physics.plant_kernel import LANE_STATE_SIZE, LOOP_SIZE, acts_later
from quadpend_gym.physics.plants import plant_of
from quadpend_gym.physics.state import (
    ACTION_SIZE,
    COMMAND_SIZE,
    DISTURBANCE_SIZE,
    STATE_SIZE,
)
from quadpend_gym.randomization import LoopRanges
from quadpend_gym.tasks.observation import (
    ALL,
    Target,
    observe_measured,
    observe_reference,
    observe_state,
    observe_target,
    tracking_errors,
)
from quadpend_gym.tasks.references import POINT_SIZE, REFERENCE_SIZE, load_point
from quadpend_gym.tasks.trajectories import reference_at
from quadpend_gym.vehicles import Simulation
from quadpend_gym.vehicles.parameters import BOB_MASS, PARAMETERS_SIZE, ROD_LENGTH
from quadpend_gym.wind import HAND, WIND_FIELDS, WIND_SIZE


def actions_under_way(simulation: Simulation, ranges: LoopRanges | None = None) -> int:
    """Return the number of actions whose effect a control period begins with: the latency in periods, rounded up."""
    return Schedule(ranges, simulation, 0).slots - 1


def initial_memory(simulation: Simulation, state: Floats, ranges: LoopRanges | None = None) -> Floats:
    """Return the memories at the beginning of episodes with states of shape (n, 18), shape (n, k)."""
    under_way = np.zeros((len(state), ACTION_SIZE * actions_under_way(simulation, ranges)))
    return np.hstack([plant_of(simulation).initial_memory(state), under_way])


def _symbols(**sizes: int) -> dict[str, Any]:
    return {name: ca.SX.sym(name, size) for name, size in sizes.items()}


def _function(name: str, arguments: dict[str, Any], **results: Any) -> Any:
    return ca.Function(name, {**arguments, **results}, list(arguments), list(results))


def plant_lanes(simulation: Simulation, state: Any, memory: Any) -> Any:
    """Return the (field, lane) buffer of a vehicle for `PlantKernel.integrate`, from vectors of CasADi."""
    axis = ca.SX(LANE_STATE_SIZE - STATE_SIZE, 1)
    return columns(ca.vertcat(state, axis, memory), plant_of(simulation).kernel.lane_size)


@lru_cache(maxsize=32)
def step_function(
    simulation: Simulation, moves_air: bool = False, ranges: LoopRanges | None = None, holds: bool = False
) -> Any:
    """Return the control step, (state, memory, action, wind, parameters) → (next_state, next_memory).

    The memory of rigid vehicles begins with quaternion, body rate and rotor thrusts (`rigid_kernel`), 11 numbers; that
    of the paper's vehicle with none. With a latency, the actions under way follow, the oldest first, four numbers each.

    Args:
        simulation: The vehicle with its interface, period, substeps and latency.
        moves_air: Whether the wind can have a velocity. If not, the paper's vehicle has no drag, as in the environment;
            rigid vehicles always have drag.
        ranges: Those of the loop of a rigid vehicle, if it is drawn; the function then has a sixth argument, the loop.
        holds: Whether a hand can hold the pole of a rigid vehicle; the function then has a last argument, the hand.
    """
    plant, schedule = plant_of(simulation), Schedule(ranges, simulation, 1)
    size, period, substeps = plant.memory_size, simulation.period, simulation.substeps
    under_way = ACTION_SIZE * (schedule.slots - 1)
    x = _symbols(state=STATE_SIZE, memory=size + under_way, action=ACTION_SIZE, wind=WIND_SIZE)
    x |= _symbols(parameters=PARAMETERS_SIZE)
    loops, replaced = columns(schedule.loops[:, 0]), {}
    if ranges is not None:
        x |= _symbols(loop=LOOP_SIZE + substeps)
        loops, replaced = columns(x["loop"]), {acts_later: lambda *_: True}
    hand = columns([], HAND.stop - HAND.start)
    if holds:
        x |= _symbols(hand=len(hand))
        hand = columns(x["hand"])
    issued, command = columns(ca.vertcat(x["memory"][size:], x["action"])), columns([], COMMAND_SIZE)
    disturbance, air = columns(x["wind"][:DISTURBANCE_SIZE]), columns(x["wind"][WIND_FIELDS["velocity"]])
    lanes, settings = plant_lanes(simulation, x["state"], x["memory"][:size]), plant.settings(moves_air)
    flying = lanes, issued, loops, disturbance, air, hand, columns(x["parameters"]), settings
    kernel = plant.held_kernel if holds else plant.kernel
    lift(kernel.integrate, replaced)(*flying, 1, period, substeps, command)
    next_memory = ca.vertcat(vector(lanes[LANE_STATE_SIZE : LANE_STATE_SIZE + size]), *issued[ACTION_SIZE:, 0])
    return _function("step", x, next_state=vector(lanes[:STATE_SIZE]), next_memory=next_memory)


@lru_cache(maxsize=1)
def reference_function() -> Any:
    """Return a reference at a time (s), (reference, time) → point; `reference` is a `Reference.as_array`."""
    x = _symbols(reference=REFERENCE_SIZE, time=1)
    return _function("reference", x, point=vector(lift(reference_at)(columns(x["reference"]), 0, x["time"])))


@lru_cache(maxsize=1)
def observation_function() -> Any:
    """Return the observation and its first part in metres, (state, parameters, point) → (observation, tracking_error).

    The observation has all fields, `quadpend_gym.tasks.observation.ALL`, not rounded to float32, of a sample of age 0
    and with the true pole.
    """
    x = _symbols(state=STATE_SIZE, parameters=PARAMETERS_SIZE, point=POINT_SIZE)
    state, point, out = columns(x["state"]), lift(load_point)(columns(x["point"]), 0), columns([], ALL.size)
    target, p = Target(point.d0, point.d1, point.yaw), x["parameters"]
    tracking = lift(tracking_errors)(state, 0, p[ROD_LENGTH], target)
    lift(observe_state)(state, 0, tracking, out, 0)
    lift(observe_reference)(point, 0, out)
    lift(observe_measured)(state, 0, 0.0, out, 0)
    lift(observe_target)(target, p[ROD_LENGTH], p[BOB_MASS], 0, out)
    return _function("observation", x, observation=vector(out), tracking_error=vector(tracking.error))
