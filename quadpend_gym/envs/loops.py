"""The loops of n sub-environments whose constants are drawn for each episode, see `randomization.LoopRanges`.

The action of control step k is issued at the substep k·s, for s substeps in a control period. It acts from the substep
kS + Dₖ on, but not before the preceding action, until the next one acts. Dₖ is the latency D of the episode, in
substeps; with jitter it is D + ⌊jε + u⌋, at least 0, where j is the jitter in substeps, ε is uniform in [−1, 1], and u,
uniform in [0, 1], rounds at random, so that the mean is D. Actions before the episode are hover.
"""

from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadpend_gym.core.arrays import Floats, Floats32, Integers
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.core.streams import LOOP_STREAM, Keys, Streams, uniform, uniform_between
from quadpend_gym.physics.rigid_settings import LOOP_SIZE, loop_numbers
from quadpend_gym.physics.state import ACTION_SIZE
from quadpend_gym.randomization import LOOP_NAMES, LoopRanges
from quadpend_gym.vehicles import Simulation

JITTER_STREAM = 1  # substream of the jitter


class LoopRows:
    """The constants of the loop of each sub-environment, and its actions under way.

    Attributes:
        drawn: The drawn values of the episodes in the order of `LOOP_NAMES`, shape (4, n); the latency in s.
        columns: For the step kernel: numbers of each loop (`rigid_settings.LOOP_SIZE`), then the actions that act
            during each of the s substeps of a control period, shape (7 + 4 s, n).
        jitter: j, substeps.
        ages: Control steps since each of these actions was issued, shape (s, n); `slots` or more for hover.
        slots: Actions that can act in a control period.
    """

    def __init__(self, ranges: LoopRanges | None, simulation: Simulation, rows: int) -> None:
        self._simulation, substeps = simulation, simulation.substeps
        nominal = simulation.latency, 1.0, 1.0, 1.0
        pairs = [getattr(ranges, name, None) or (value, value) for name, value in zip(LOOP_NAMES, nominal, strict=True)]
        self._lowest, self._highest = np.array(pairs).T
        self.jitter = getattr(ranges, "jitter", 0.0) / simulation.period * substeps
        latest = self._in_substeps(self._highest[0]) + ceil(self.jitter)
        self.slots = slots = -(-int(latest) // substeps) + 1  # of the ring buffer
        self.ages = np.zeros((substeps, rows), np.int64)
        self.drawn = np.zeros((len(LOOP_NAMES), rows))
        self.columns = np.zeros((LOOP_SIZE + substeps * ACTION_SIZE, rows))
        self._latency = np.zeros(rows, np.int64)  # substeps
        self._under_way, self._arrival = np.zeros((slots, ACTION_SIZE, rows)), np.zeros((slots, rows), np.int64)
        self._acting = np.zeros(rows, np.int64)  # number of the action that acts, or −1
        self._keys = np.zeros(rows, np.uint64)

    def start_episodes(self, rows: Integers, streams: Streams) -> None:
        """Draw the constants of new episodes, each from its own number; `streams` are those of the episodes."""
        own, simulation = streams.derive(LOOP_STREAM), self._simulation
        drawn = self.draw(own)
        self._latency[rows] = drawn[:, 0]
        drawn[:, 0] *= simulation.period / simulation.substeps
        self.drawn[:, rows] = drawn.T
        self.columns[:LOOP_SIZE, rows] = np.array([loop_numbers(simulation, *row) for row in drawn[:, 1:].tolist()]).T
        self.columns[LOOP_SIZE:, rows] = 0.0
        self._acting[rows] = -1
        self._keys[rows] = own.derive(JITTER_STREAM).keys

    def draw(self, streams: Streams) -> Floats:
        """Draw the constants of episodes in the order of `LOOP_NAMES`, shape (n, 4); the latency in substeps."""
        drawn = streams.between(0, self._lowest, self._highest)
        drawn[:, 0] = self._in_substeps(drawn[:, 0])
        return drawn

    def at_hover(self, rows: Integers) -> Floats:
        """Return `columns` of the sub-environments `rows` with actions of zero."""
        columns = self.columns.take(rows, axis=1)
        columns[LOOP_SIZE:] = 0.0
        return columns

    def schedule(self, action: Floats, step: Integers) -> Floats32:
        """Take the actions of a control step, shape (4, n), into `columns`, and return those that act at its end.

        `step` is the number of control steps since each episode began, shape (n,).
        """
        last = np.empty((len(step), ACTION_SIZE), np.float32)
        loop, queue = (self._latency, self.jitter, self._keys), (self._under_way, self._arrival, self._acting)
        _schedule(action, step, *loop, *queue, self.ages, self.columns[LOOP_SIZE:], last)
        return last

    def _in_substeps(self, latency: Any) -> Any:
        return np.rint(latency / self._simulation.period * self._simulation.substeps)


@inlined
def lateness(key: Any, step: int, latency: float, jitter: float) -> float:
    """Return the delay Dₖ of the action of a control step, substeps; `jitter` is j."""
    if jitter == 0.0:
        return latency
    change = uniform_between(key, 2 * step, -jitter, jitter) + uniform(key, 2 * step + 1)
    return float(max(latency + np.floor(change), 0.0))


@compiled
def _schedule(
    action: Floats,
    step: Integers,
    latency: Integers,
    jitter: float,
    keys: Keys,
    under_way: NDArray[np.float64],
    arrival: Integers,
    acting: Integers,
    ages: Integers,
    substeps: Floats,
    last: Floats32,
) -> None:
    slots, rows = arrival.shape
    count = substeps.shape[0] // ACTION_SIZE
    for row in range(rows):
        now, current = step[row], acting[row]
        late = int(lateness(keys[row], now, float(latency[row]), jitter))
        arrival[now % slots, row] = now * count + late
        if now > 0:
            arrival[now % slots, row] = max(now * count + late, arrival[(now - 1) % slots, row])
        for i in range(ACTION_SIZE):
            under_way[now % slots, i, row] = action[i, row]
        for substep in range(count):
            while current < now and arrival[(current + 1) % slots, row] <= now * count + substep:
                current += 1
            ages[substep, row] = now - current if current >= 0 else slots
            for i in range(ACTION_SIZE):
                substeps[substep * ACTION_SIZE + i, row] = under_way[current % slots, i, row] if current >= 0 else 0.0
        acting[row] = current
        for i in range(ACTION_SIZE):
            last[row, i] = substeps[(count - 1) * ACTION_SIZE + i, row]
