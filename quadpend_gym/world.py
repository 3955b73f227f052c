"""The simulation of a batch of sub-environments: arrays, random streams, `begin` and `step`.

Both environments are thin adapters over it. Nothing here knows of spaces, autoreset or time limits.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from gymnasium.error import ResetNeeded

from quadpend_gym import kernel
from quadpend_gym.arrays import Floats, Floats32, Integers
from quadpend_gym.observation import OBSERVATION_SIZE
from quadpend_gym.params import Simulation
from quadpend_gym.records import build, numbers
from quadpend_gym.references import Reference
from quadpend_gym.state import STATE_FIELDS, State
from quadpend_gym.streams import WIND_STREAM, Streams
from quadpend_gym.tasks import Task, flatten
from quadpend_gym.wind import DISTURBANCE_SIZE, Sum, WindProcess, as_wind

_MEASURED = kernel.MEASURED_SIZE


def named_info(columns: Any, tracking_error: Floats, disturbance: Floats) -> dict[str, Any]:
    """The `info` of one row or of many.

    Keys: ``tracking_error`` (m, flat outputs, world), ``tilt`` (rad, the pendulum's α), ``disturbance`` (force on
    the quadrotor, on the bob (N, world) and torque (N·m) during the step), ``reward_terms``.

    Args:
        columns: what is measured, column by column: a list of floats for one row, an array (10, n) for many.
        tracking_error: shape (..., 3).
        disturbance: shape (..., 9).
    """
    return {
        "tracking_error": tracking_error,
        "tilt": columns[kernel.TILT],
        "disturbance": disturbance,
        "reward_terms": {"tracking": columns[0], "upright": columns[1], "yaw": columns[2], "effort": columns[3]},
    }


def kernel_settings(task: Task, simulation: Simulation, substeps: int) -> Floats:
    """What `kernel.step` reads: period, command scale (4), limits (4, angles as cosines), weights (4), substeps."""
    limits, weights = flatten(task.limits), flatten(task.reward)
    limits[:2] = np.cos(limits[:2])
    return np.concatenate([[simulation.period], simulation.command_scale, limits, weights / weights.sum(), [substeps]])


class Fixed(NamedTuple):
    """What a reset fixes of new episodes; the rest is drawn.

    Attributes:
        state: fields of the state, each of shape (3,) or (m, 3).
        reference: shape (20,) or (m, 20), or None to draw it.
    """

    state: dict[str, Floats]
    reference: Floats | None


NOTHING_FIXED = Fixed({}, None)


def check_fixed(state: Any, reference: Any, rows: int) -> Fixed:
    """Check what the options of a reset fix, before anything changes.

    Args:
        state: a mapping from names in `STATE_FIELDS` to arrays of shape (3,) or (rows, 3), or None.
        reference: a `Reference`, a mapping of its fields, one of these for each row, or None.
        rows: number of rows that begin an episode.

    Raises:
        TypeError: `state` or `reference` is of the wrong type.
        ValueError: one of them has something unknown, a wrong shape or a value out of range.
    """
    return Fixed(_check_state(state, rows), _check_reference(reference, rows))


class World:
    """A batch of n sub-environments.

    Episode k of a row depends on the row's seed and on k alone: not on the other rows, the actions of earlier
    episodes, or (start and reference) the wind.

    Attributes:
        disturbance: what will act over the coming control period, shape (n, 9), see `quadpend_gym.wind`.
        clock: control steps since each episode began, shape (n,).
        episode: number of each row's episode since it was seeded, shape (n,); −1 before the first.
    """

    def __init__(self, rows: int, task: Task, simulation: Simulation, wind: Any = None) -> None:
        """Allocate the arrays; every row needs a seed and `begin` before `step`."""
        self.task = task
        self.simulation = simulation
        self._memory = np.zeros((rows, kernel.MEMORY_EDGES[3]))
        self.parameters[:] = simulation.parameters.as_array()
        self.clock = np.zeros(rows, np.int64)
        self.episode = np.full(rows, -1, np.int64)
        self._seeds = np.zeros(rows, np.uint64)
        self._wind: WindProcess | None = None
        self._settings = kernel_settings(task, simulation, simulation.substeps)
        self._looking = kernel_settings(task, simulation, 0)
        self._reference_ranges = flatten(task.references)
        self._start_ranges = flatten(task.start)
        self.add_wind(as_wind(wind))

    @property
    def state(self) -> Floats:
        """The states, shape (n, 18), see `quadpend_gym.state`; a view."""
        return self._memory[:, kernel.MEMORY_EDGES[0] : kernel.MEMORY_EDGES[1]]

    @property
    def parameters(self) -> Floats:
        """The physical parameters, shape (n, 7), see `Parameters.as_array`; a view."""
        return self._memory[:, kernel.MEMORY_EDGES[1] : kernel.MEMORY_EDGES[2]]

    @property
    def reference(self) -> Floats:
        """The references, shape (n, 20), see `Reference.as_array`; a view."""
        return self._memory[:, kernel.MEMORY_EDGES[2] : kernel.MEMORY_EDGES[3]]

    @property
    def rows(self) -> int:
        """Number of sub-environments."""
        return self.clock.size

    def add_wind(self, wind: Sum) -> None:
        """Let `wind` blow besides what blows already; every row must then begin a new episode."""
        models = self._wind.models if self._wind else ()
        self._wind = WindProcess((*models, *wind.models), self.rows) if (*models, *wind.models) else None
        self.disturbance = np.zeros((self.rows, DISTURBANCE_SIZE))
        self._waiting = np.ones(self.rows, np.bool_)
        self._ready = False

    def seed(self, rows: Integers, seeds: Sequence[int]) -> None:
        """Give `rows` new seeds, non-negative integers; their next episode is number 0."""
        self._seeds[rows] = Streams.from_seeds(list(seeds)).keys
        self.episode[rows] = -1

    def begin(self, rows: Integers, fixed: Fixed = NOTHING_FIXED) -> None:
        """Begin the next episode of the given rows, shape (m,), drawing all that is not `fixed`.

        A fixed direction is normalised, and the direction rate loses its component along it.
        """
        fields = fixed.state
        self.episode[rows] += 1
        if fixed.reference is None:
            kernel.draw_references(rows, self._seeds, self.episode, self._reference_ranges, self.reference)
        else:
            self.reference[rows] = fixed.reference
        kernel.draw_starts(
            rows, self._seeds, self.episode, self._start_ranges, self.parameters, self.reference, self.state
        )
        for name, value in fields.items():
            self.state[rows, STATE_FIELDS[name]] = value
        if "direction" in fields or "direction_rate" in fields:
            view = State(self.state[rows])
            view.direction[:] /= np.linalg.norm(view.direction, axis=-1, keepdims=True)
            along = np.sum(view.direction * view.direction_rate, axis=-1, keepdims=True)
            view.direction_rate[:] -= along * view.direction
            self.state[rows] = view.array
        self.clock[rows] = 0
        if self._wind:
            episodes = Streams(self._seeds[rows]).derive(self.episode[rows])
            self.disturbance[rows] = self._wind.begin(rows, episodes.derive(WIND_STREAM), self.simulation.period)
        if not self._ready:
            self._waiting[rows] = False
            self._ready = not self._waiting.any()

    def look(self, rows: Integers) -> tuple[Floats32, Floats]:
        """Observation and measurements of the given rows where they stand, as if hovering in calm air; see `step`."""
        observation, measured = np.empty((rows.size, OBSERVATION_SIZE), np.float32), np.empty((rows.size, _MEASURED))
        action = np.zeros((rows.size, kernel.ACTION_SIZE), np.float32)
        clock, calm = self.clock[rows], np.zeros((rows.size, DISTURBANCE_SIZE))
        kernel.step(self._memory[rows], clock, calm, action, self._looking, observation, measured)
        return observation, measured

    def step(self, action: Floats32) -> tuple[Floats32, Floats, Floats]:
        """Advance every row by one control period.

        Args:
            action: shape (n, 4), float32, components in [−1, 1].

        Returns:
            The observation, shape (n, 36); what was measured, shape (n, 10), with the columns that `kernel` names:
            reward terms, tracking error, tilt, reward, termination; and what disturbed, shape (n, 9).

        Raises:
            ResetNeeded: a row has not begun an episode.
            ValueError: an action is out of range or not finite, or the wind is. Nothing has changed then.
        """
        if not self._ready:
            raise ResetNeeded(f"row {self._waiting.argmax()} has no episode: call reset before step")
        rows = self.clock.size
        observation, measured = np.empty((rows, OBSERVATION_SIZE), np.float32), np.empty((rows, _MEASURED))
        disturbance = self.disturbance
        bad = kernel.step(self._memory, self.clock, disturbance, action, self._settings, observation, measured)
        if bad >= 0:
            raise ValueError(
                f"action of row {bad} must be four numbers in [-1, 1], not {action[bad].tolist()};"
                " gymnasium.wrappers.ClipAction clips"
            )
        if bad < -1:
            raise ValueError(f"wind must blow finite numbers, not {disturbance[-2 - bad].tolist()} in row {-2 - bad}")
        if self._wind is None:
            return observation, measured, np.zeros((rows, DISTURBANCE_SIZE))
        self.disturbance = self._wind.blow(self.clock, self.simulation.period)
        return observation, measured, disturbance


def _check_state(state: Any, rows: int) -> dict[str, Floats]:
    if state is None:
        return {}
    if not isinstance(state, Mapping):
        raise TypeError(f"options['state'] must be a mapping of state fields, not {state!r}")
    checked = {}
    for name, value in state.items():
        if name not in STATE_FIELDS:
            raise ValueError(f"options['state'] has no field {name!r}; the fields are {', '.join(STATE_FIELDS)}")
        array = numbers(value, f"options['state'][{name!r}]").astype(np.float64)
        if array.shape not in {(3,), (rows, 3)}:
            raise ValueError(f"options['state'][{name!r}] must have shape (3,) or ({rows}, 3), not {array.shape}")
        if not (np.abs(array) < kernel.DIVERGED).all():
            raise ValueError(
                f"options['state'][{name!r}] must be finite and below {kernel.DIVERGED:g}, not {array.tolist()}"
            )
        checked[name] = array
    if "direction" in checked and not np.linalg.norm(checked["direction"], axis=-1).all():
        raise ValueError("options['state']['direction'] must not be zero")
    return checked


def _check_reference(reference: Any, rows: int) -> Floats | None:
    if reference is None:
        return None
    if isinstance(reference, Sequence) and not isinstance(reference, str):
        if len(reference) != rows:
            raise ValueError(f"options['reference'] must be one reference or {rows}, not {len(reference)}")
        return np.array([build(Reference, item, "reference").as_array() for item in reference])
    return build(Reference, reference, "reference").as_array()
