"""The schedule of actions: which action acts in which substep, and the constants of the loops of n sub-environments.

The action of control step k is issued at the substep k·s, for s substeps in a control period. It acts from the substep
ks + Dₖ on, but not before the preceding action, until the next one acts. Dₖ is the latency D of the episode, in
substeps; with jitter it is D + ⌊jε + u⌋, at least 0, where j is the jitter in substeps, ε is uniform in [−1, 1], and u,
uniform in [0, 1], rounds at random, so that the mean is D. Actions before the episode are hover.

`randomization.LoopRanges` draws latency, time constants and thrust for each episode; without it they are nominal.
Latency, thrust and the efficiency of one rotor can change once within an episode (`LoopChanges`); the actions issued
from this control step on have the changed latency.
"""

from math import ceil
from typing import Any

import numpy as np

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.core.streams import LOOP_STREAM, Keys, Streams, uniform, uniform_between
from quadpend_gym.physics.plant_kernel import LOOP_EFFICIENCY, LOOP_SIZE
from quadpend_gym.physics.rigid_settings import loop_numbers, nominal_loop
from quadpend_gym.physics.state import ACTION_SIZE
from quadpend_gym.randomization import LOOP_NAMES, LoopChanges, LoopRanges
from quadpend_gym.vehicles import Simulation

JITTER_STREAM, CHANGE_STREAM = 1, 2  # substreams of the jitter, and of the changes within an episode
_LATENCY, _THRUST = LOOP_NAMES.index("latency"), LOOP_NAMES.index("thrust")
_EFFICIENCY = slice(LOOP_EFFICIENCY, LOOP_EFFICIENCY + ACTION_SIZE)
_NEVER = -1  # control step of the change of a loop that does not change


class Schedule:
    """The loops of n sub-environments.

    Attributes:
        ranges: Intervals of the constants; None: every loop is nominal.
        slots: Number of actions that can act in a control period, this one included.
        jitter: j, substeps.
        loops: Each loop for the step kernel, see `physics.plant_kernel`, shape (10 + s, n), or without ranges that of
            all, shape (10 + s, 1).
        ages: The last s rows of it: for each substep of the next control period, control steps since the action that
            acts was issued; 0 is the action of this control step.
        drawn: The constants of the episodes in the order of `LOOP_NAMES`, shape (4, n); the latency in s. After a
            change they are the changed ones; that of a single rotor is no part of them.
    """

    def __init__(self, ranges: LoopRanges | None, simulation: Simulation, rows: int) -> None:
        self.ranges, self._simulation = ranges, simulation
        nominal = simulation.latency, 1.0, 1.0, 1.0
        pairs = [getattr(ranges, name, None) or (value, value) for name, value in zip(LOOP_NAMES, nominal, strict=True)]
        self._lowest, self._highest = np.array(pairs).T
        self.jitter = getattr(ranges, "jitter", 0.0) / simulation.period * simulation.substeps
        self._changes: LoopChanges | None = getattr(ranges, "changes", None)
        changed = getattr(self._changes, "latency", None)
        self._varies = self.jitter > 0.0 or changed is not None  # whether the latency varies within an episode
        latest = self._in_substeps(max(self._highest[_LATENCY], *(changed or (0.0,)))) + ceil(self.jitter)
        self.slots = -(-int(latest) // simulation.substeps) + 1
        self.drawn = np.array(nominal)[:, np.newaxis] + np.zeros(rows)
        self.loops = np.repeat(nominal_loop(simulation)[:, np.newaxis], 1 if ranges is None else rows, axis=1)
        self.ages = self.loops[LOOP_SIZE:]
        self.ages[:] = self._ages(self._in_substeps(simulation.latency))
        self._latency = np.zeros(rows, np.int64)  # substeps
        self._arrival, self._acting = np.zeros((self.slots, rows), np.int64), np.zeros(rows, np.int64)
        self._keys = np.zeros(rows, np.uint64)
        self._change_step = np.full(rows, _NEVER)
        self._changed = np.zeros((len(LOOP_NAMES) + ACTION_SIZE, rows))  # `drawn` and efficiencies after the change

    def start_episodes(self, rows: Integers, streams: Streams) -> None:
        """Draw the constants of new episodes, each from its own number; `streams` are those of the episodes."""
        if self.ranges is None:
            return
        own, simulation = streams.derive(LOOP_STREAM), self._simulation
        drawn = self.draw(own)
        latency = drawn[:, 0].copy()
        drawn[:, 0] *= simulation.period / simulation.substeps
        self.drawn[:, rows] = drawn.T
        self.loops[:LOOP_SIZE, rows] = np.array([loop_numbers(simulation, *row) for row in drawn[:, 1:].tolist()]).T
        self.ages[:, rows] = self._ages(latency)
        self._latency[rows], self._acting[rows] = latency, -1
        self._keys[rows] = own.derive(JITTER_STREAM).keys
        if self._changes is not None:
            self._draw_change(rows, own.derive(CHANGE_STREAM))

    def _draw_change(self, rows: Integers, streams: Streams) -> None:
        """Draw the changes of new episodes, whose constants are drawn, each from its own number."""
        drawn, simulation = self.drawn[:, rows], self._simulation
        step, latency, thrust, efficiency = self.draw_change(self._latency[rows], drawn[_THRUST], streams)
        drawn[_LATENCY], drawn[_THRUST] = latency * simulation.period / simulation.substeps, thrust
        self._changed[:, rows] = [*drawn, *efficiency.T]
        self._change_step[rows] = step
        self._change(rows[self._change_step[rows] == 0])

    def draw_change(self, latency: Any, thrust: Any, streams: Streams) -> tuple[Any, Any, Any, Any]:
        """Return the control steps of the changes, shape (n,), and the loops from then on.

        They are the latency (substeps) and the thrust, shape (n,) as before, and the efficiency of each rotor, (n, 4).
        """
        changes: Any = self._changes
        bounds = (changes.at, *((pair or (1.0, 1.0)) for pair in (changes.latency, changes.thrust, changes.rotors)))
        numbers = streams.between(0, *zip(*bounds, (0.0, ACTION_SIZE), strict=True))
        at, later, factor, share, rotor = (numbers[:, column] for column in range(len(bounds) + 1))
        latency = self._in_substeps(later) if changes.latency else latency
        thrust = factor if changes.thrust else thrust
        behind = rotor[:, np.newaxis] - np.arange(ACTION_SIZE)  # in [0, 1) for the rotor that changes
        own = np.where(behind >= 0.0, np.where(behind < 1.0, share[:, np.newaxis], 1.0), 1.0)
        step = np.ceil(at / self._simulation.period * (1.0 - 1e-9))
        return step, latency, thrust, thrust[:, np.newaxis] * own

    def _change(self, rows: Integers) -> None:
        self.drawn[:, rows], self.loops[_EFFICIENCY, rows] = np.split(self._changed[:, rows], 2)
        self._latency[rows] = self._in_substeps(self.drawn[_LATENCY, rows])

    def draw(self, streams: Streams) -> Floats:
        """Draw the constants of episodes in the order of `LOOP_NAMES`, shape (n, 4); the latency in substeps."""
        drawn = streams.between(0, self._lowest, self._highest)
        drawn[:, 0] = self._in_substeps(drawn[:, 0])
        return drawn

    def loops_of(self, rows: Integers) -> Floats:
        """Return the loops of some sub-environments, or that of all."""
        return self.loops if self.ranges is None else self.loops[:, rows]

    def advance(self, step: Integers) -> None:
        """Set the loops for the control steps `step` of the episodes, shape (n,)."""
        if self._changes:
            self._change(np.flatnonzero(step == self._change_step))
        if self._varies:
            _delay(step, self._latency, self.jitter, self._keys, self._arrival, self._acting, self.ages)

    def _in_substeps(self, latency: Any) -> Any:
        return np.rint(latency / self._simulation.period * self._simulation.substeps)

    def _ages(self, latency: Any) -> Any:
        """Return `ages` under constant latencies in substeps, shape (m,)."""
        substep, substeps = np.arange(self._simulation.substeps)[:, np.newaxis], self._simulation.substeps
        return -(-np.maximum(latency - substep, 0.0) // substeps)


@inlined
def lateness(key: Any, step: int, latency: float, jitter: float) -> float:
    """Return the delay Dₖ of the action of a control step, substeps; `jitter` is j."""
    if jitter == 0.0:
        return latency
    change = uniform_between(key, 2 * step, -jitter, jitter) + uniform(key, 2 * step + 1)
    return float(max(latency + np.floor(change), 0.0))


@compiled
def _delay(
    step: Integers, latency: Integers, jitter: float, keys: Keys, arrival: Integers, acting: Integers, ages: Floats
) -> None:
    slots, count = arrival.shape[0], ages.shape[0]
    for row in range(step.shape[0]):
        now, current = step[row], acting[row]
        late = int(lateness(keys[row], now, float(latency[row]), jitter))
        arrival[now % slots, row] = now * count + late
        if now > 0:
            arrival[now % slots, row] = max(now * count + late, arrival[(now - 1) % slots, row])
        for substep in range(count):
            while current < now and arrival[(current + 1) % slots, row] <= now * count + substep:
                current += 1
            ages[substep, row] = now - current
        acting[row] = current
