"""What the compiled loops of both kinds of vehicles share: blocks of sub-environments, and the actions that act.

The loops work on blocks of 64 sub-environments. They copy each block into buffers of shape (field, lane), with one lane
for each sub-environment, so that the compiler can turn every loop over lanes into vector instructions. A batch of one
sub-environment runs the same code and gives bit-identical results.

A loop between action and thrust is a column of numbers: those of `rigid_settings.with_loop`, which begin with the
efficiency, and from `LOOP_SIZE` on, for each substep, the control steps since the action that acts was issued.
"""

from typing import Any, NamedTuple

import numpy as np

from quadpend_gym.core.elementary import select
from quadpend_gym.core.jit import inlined
from quadpend_gym.physics.state import ACTION_SIZE, DISTURBANCE_SIZE, STATE_SIZE
from quadpend_gym.physics.vectors import Four, load_four, store_four
from quadpend_gym.vehicles.parameters import PARAMETERS_SIZE

BLOCK = 64  # sub-environments in a block
LOOP_EFFICIENCY = 0  # first of four rows of a loop: thrust and torques that act, divided by the nominal ones
LOOP_SIZE = 10  # rows of a loop before those of the substeps
# In the (field, lane) buffers, the thrust axis follows the state. Then come what a vehicle has besides, the action or
# command that acts, and what else `PlantKernel.integrate` remembers.
THRUST_AXIS = STATE_SIZE
LANE_STATE_SIZE = STATE_SIZE + 3
DIVERGENCE_LIMIT = 1e6  # a state diverges when the sum of its absolute values reaches this


class PlantKernel(NamedTuple):
    """The functions of one kind of vehicle that compiled code calls, resolved when it is compiled."""

    memory_size: int  # numbers of a vehicle besides its state; in the buffers they follow the thrust axis
    lane_size: int  # fields of the buffer of a block
    integrate: Any  # advances a block by a control period, see `euler_kernel.integrate_euler`
    store_outputs: Any  # writes what follows from the other fields of the state, and the thrust axis
    store_axis: Any  # writes the thrust axis
    store_command: Any  # writes thrust (N) and torques (N·m) at this moment


@inlined
def gather(rows: Any, first: int, lanes: int, out: Any) -> None:
    """Copy rows `first` to `first + lanes` of a (row, field) array into a (field, lane) buffer."""
    for lane in range(lanes):
        for field in range(rows.shape[1]):
            out[field, lane] = rows[first + lane, field]


@inlined
def scatter(lanes_in: Any, first: int, lanes: int, out: Any) -> None:
    """Copy a (field, lane) buffer into rows `first` to `first + lanes` of a (row, field) array."""
    for lane in range(lanes):
        for field in range(out.shape[1]):
            out[first + lane, field] = lanes_in[field, lane]


@inlined
def acts_later(loops: Any, substep: int, lanes: int) -> bool:
    """Return whether in some lane another action acts in a substep than in the first substep."""
    differs = False
    for lane in range(lanes):
        differs |= loops[LOOP_SIZE + substep, lane] != loops[LOOP_SIZE, lane]
    return differs


@inlined
def find_acting(issued: Any, loops: Any, substep: int, lanes: int, out: Any) -> None:
    """Write the actions that act in a substep into a (4, lane) buffer.

    Each loop is over lanes, so that the compiler can vectorise it.

    Args:
        issued: Actions of the last k control steps, the oldest first, in a (4 k, lane) buffer.
        loops: The loops, in a (field, lane) buffer.
        substep: The substep.
        lanes: The number of lanes.
        out: The output.
    """
    newest = issued.shape[0] // ACTION_SIZE - 1
    for field in range(ACTION_SIZE):
        for lane in range(lanes):
            out[field, lane] = issued[ACTION_SIZE * newest + field, lane]
    for k in range(newest):
        for field in range(ACTION_SIZE):
            for lane in range(lanes):
                before = issued[ACTION_SIZE * (newest - 1 - k) + field, lane]
                out[field, lane] = select(loops[LOOP_SIZE + substep, lane] > k, before, out[field, lane])


@inlined
def add_mean(value: Four, share: float, lane: int, out: Any) -> None:
    """Move the mean in the four rows of `out` to a value by `share`; the mean of equal values is exact."""
    mean = load_four(out, 0, lane)
    gap = Four(value.a - mean.a, value.b - mean.b, value.c - mean.c, value.d - mean.d)
    a, b, c, d = mean.a + share * gap.a, mean.b + share * gap.b, mean.c + share * gap.c, mean.d + share * gap.d
    store_four(out, 0, lane, Four(a, b, c, d))


@inlined
def advance_rows(
    plant: PlantKernel,
    state: Any,
    memory: Any,
    action: Any,
    loops: Any,
    disturbance: Any,
    parameters: Any,
    settings: Any,
    period: float,
    substeps: int,
) -> None:
    """Advance n states, shape (n, 18), and memories, shape (n, k), in place by one period, in air at rest.

    Actions, disturbances and parameters have the shapes (n, 4), (n, 9) and (n, 9), the loops (10 + s, n). The buffers
    of a block and the settings are those of `plant.integrate`.
    """
    state_lanes, issued = np.empty((plant.lane_size, BLOCK)), np.empty((ACTION_SIZE, BLOCK))
    disturbance_lanes, physics_lanes = np.empty((DISTURBANCE_SIZE, BLOCK)), np.empty((PARAMETERS_SIZE, BLOCK))
    loop_lanes, velocity_lanes = np.empty((loops.shape[0], BLOCK)), np.zeros((3, BLOCK))
    command, hand_lanes = np.empty((ACTION_SIZE, BLOCK)), np.zeros((4, BLOCK))
    for first in range(0, state.shape[0], BLOCK):
        lanes = min(BLOCK, state.shape[0] - first)
        gather(state, first, lanes, state_lanes)
        gather(memory, first, lanes, state_lanes[LANE_STATE_SIZE:])
        gather(action, first, lanes, issued)
        gather(loops.T, first, lanes, loop_lanes)
        gather(disturbance, first, lanes, disturbance_lanes)
        gather(parameters, first, lanes, physics_lanes)
        plant.integrate(
            state_lanes,
            issued,
            loop_lanes,
            disturbance_lanes,
            velocity_lanes,
            hand_lanes,
            physics_lanes,
            settings,
            lanes,
            period,
            substeps,
            command,
        )
        scatter(state_lanes, first, lanes, state)
        scatter(state_lanes[LANE_STATE_SIZE:], first, lanes, memory)
