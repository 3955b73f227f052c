"""The simulation of a batch of sub-environments: arrays, random streams, `begin` and `step`.

Both environments are thin adapters over it. Nothing here knows of spaces, autoreset or time limits.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded

from quadpend_gym.actuators import check_chain
from quadpend_gym.core.arrays import Floats, Floats32, Integers
from quadpend_gym.core.models import ModelBatch
from quadpend_gym.core.streams import ACTUATOR_STREAM, PARAMETER_STREAM, SENSOR_STREAM, WIND_STREAM, Streams
from quadpend_gym.envs import step_kernel
from quadpend_gym.envs.outcome import (
    AIR_VELOCITY,
    COMMAND,
    DISTURBANCE,
    OUTCOME_SIZE,
    PARAMETERS,
    SEEN_STATE,
    SENSED_SIZE,
    TILT,
    TRACKING_ERROR,
)
from quadpend_gym.envs.reset_options import NO_OPTIONS, ResetOptions
from quadpend_gym.physics.parameters import Simulation
from quadpend_gym.physics.state import ACTION_SIZE, STATE_FIELDS, State
from quadpend_gym.randomization import Around, ParameterRanges
from quadpend_gym.tasks import Task, flatten
from quadpend_gym.tasks.observation import OBSERVATION_SIZE
from quadpend_gym.tasks.references import draw_references
from quadpend_gym.tasks.starts import draw_starts
from quadpend_gym.wind import WIND_FIELDS, WIND_SIZE, as_wind

# Parts of the outcome of a step
_TRACKING_ERROR = slice(TRACKING_ERROR, TILT)
_DISTURBANCE = slice(DISTURBANCE, AIR_VELOCITY)
_AIR_VELOCITY = slice(AIR_VELOCITY, PARAMETERS)
_PARAMETERS = slice(PARAMETERS, COMMAND)
_COMMAND = slice(COMMAND, OUTCOME_SIZE)
_TILT = TILT


def kernel_settings(task: Task, simulation: Simulation, air: bool, substeps: int) -> Floats:
    """What `kernel.step` reads as its settings; of the limits, the angles as cosines."""
    limits, weights = flatten(task.limits), flatten(task.reward)
    limits[:2] = np.cos(limits[:2])
    weights[:-1] /= weights[:-1].sum()  # the last is no weight, but the tip's share
    parts = [simulation.period], simulation.command_scale, limits, weights, [air, substeps]
    return np.concatenate(parts)


class World:
    """A batch of n sub-environments.

    Episode k of a row depends on the row's seed and on k alone: not on the other rows, the actions of earlier
    episodes, or (start and reference) the wind, the sensors and the actuators.

    Attributes:
        clock: control steps since each episode began, shape (n,).
        episode: number of each row's episode since it was seeded, shape (n,); −1 before the first.
    """

    def __init__(self, rows: int, task: Task, simulation: Simulation, wind: Any = None) -> None:
        """Allocate the arrays; every row needs a seed and `begin` before `step`."""
        self.task = task
        self.simulation = simulation
        self._memory = np.zeros((rows, step_kernel.MEMORY_EDGES[3]))
        self.parameters[:] = simulation.parameters.as_array()
        self._observation_like = (rows, OBSERVATION_SIZE), np.dtype(np.float32)
        self._sensed = np.zeros((SENSED_SIZE, 0))
        self.clock = np.zeros(rows, np.int64)
        self.episode = np.full(rows, -1, np.int64)
        self._seeds = np.zeros(rows, np.uint64)
        self._looking = kernel_settings(task, simulation, False, 0)
        self._reference_ranges = flatten(task.references)
        self._start_ranges = flatten(task.start)
        self._ranges: ParameterRanges | None = None
        self._wind, self._sensors, self._actuators = (ModelBatch((), rows) for _ in range(3))
        self.add_wind(as_wind(wind))

    @property
    def state(self) -> Floats:
        """The states, shape (n, 18), see `quadpend_gym.physics.state`; a view."""
        return self._memory[:, step_kernel.MEMORY_EDGES[0] : step_kernel.MEMORY_EDGES[1]]

    @property
    def parameters(self) -> Floats:
        """The true parameters of each row's episode, shape (n, 9), see `Parameters.as_array`; a view."""
        return self._memory[:, step_kernel.MEMORY_EDGES[1] : step_kernel.MEMORY_EDGES[2]]

    @property
    def reference(self) -> Floats:
        """The references, shape (n, 20), see `Reference.as_array`; a view."""
        return self._memory[:, step_kernel.MEMORY_EDGES[2] : step_kernel.MEMORY_EDGES[3]]

    @property
    def wind(self) -> Floats:
        """What will blow over the coming control period, shape (n, 12), see `quadpend_gym.wind`; a view."""
        return self._blown.T

    @property
    def rows(self) -> int:
        """Number of sub-environments."""
        return self.clock.size

    def info(self, outcome: Floats, numbers: Any) -> dict[str, Any]:
        """The `info` of one row or of many: all of it true, whatever the sensors say.

        Keys: ``tracking_error`` (m, flat outputs, world), ``tilt`` (rad, the pendulum's α), ``disturbance`` (force on
        the quadrotor, on the bob (N, world) and torque (N·m) during the step), ``reward_terms``; where a wind moves the
        air ``air_velocity`` (m/s, world); behind actuators ``command``, thrust (N) and torques (N·m); where they are
        drawn ``parameters``, in the order of `PARAMETER_NAMES`.

        Args:
            outcome: of a step, as `kernel` lays it out, shape (k,) or (k, n); so are the parts of it in the info.
            numbers: its first rows again, from which the scalars are taken.
        """
        info = {
            "tracking_error": outcome[_TRACKING_ERROR],
            "tilt": numbers[_TILT],
            "disturbance": outcome[_DISTURBANCE],
            "reward_terms": {
                "tracking": numbers[0],
                "upright": numbers[1],
                "yaw": numbers[2],
                "effort": numbers[3],
            },
        }
        if self._tells_more:
            if self._moves_air:
                info["air_velocity"] = outcome[_AIR_VELOCITY]
            if self._actuators.models:
                info["command"] = outcome[_COMMAND]
            if self._ranges is not None:
                info["parameters"] = outcome[_PARAMETERS]
        return info

    def _wait(self) -> None:
        """Every row must begin a new episode; what is told of a step may have changed."""
        end = AIR_VELOCITY
        for there, told in (
            (self._moves_air, PARAMETERS),
            (self._ranges is not None, COMMAND),
            (self._actuators.models, OUTCOME_SIZE),
        ):
            end = told if there else end
        self._tells_more = end > AIR_VELOCITY
        # A little wider than it need be: caches dislike rows that lie a power of two apart.
        self._padded = self.rows >= 512
        width = self.rows + 8 if self._padded else self.rows
        self._outcome_shape = end, width
        self._waiting = np.ones(self.rows, np.bool_)
        self._ready = False

    def add_wind(self, models: tuple[Any, ...]) -> None:
        """Let these blow besides what blows already; every row must then begin a new episode."""
        self._wind = ModelBatch((*self._wind.models, *models), self.rows)
        moving: tuple[Any, ...] = self._wind.models
        self._moves_air = any(model.moves_air for model in moving)
        self._settings = kernel_settings(self.task, self.simulation, self._moves_air, self.simulation.substeps)
        self._blown = np.zeros((WIND_SIZE, self.rows))
        self._wait()

    def add_sensors(self, models: tuple[Any, ...]) -> None:
        """Put these sensors behind those there are; every row must then begin a new episode."""
        self._sensors = ModelBatch((*self._sensors.models, *models), self.rows)
        if models:
            self._sensed = np.zeros((SENSED_SIZE, self.rows))
            self.measured[:] = self.state
        self._wait()

    def add_actuators(self, models: tuple[Any, ...]) -> None:
        """Put these actuators before those there are; every row must then begin a new episode.

        Raises:
            ValueError: they do not make sense there.
        """
        models = (*models, *self._actuators.models)
        check_chain(models, self.simulation)
        # Numbered from the last, so that one put before it leaves a model's random numbers alone.
        self._actuators = ModelBatch(models, self.rows, range(len(models))[::-1])
        self._wait()

    def draw_parameters(self, ranges: ParameterRanges | Around) -> None:
        """Draw the parameters of every episode; every row must then begin a new one.

        Raises:
            ValueError: they are drawn already.
        """
        if self._ranges is not None:
            raise ValueError("the parameters are drawn already: give all ranges at once")
        self._ranges = ranges.ranges(self.simulation.parameters) if isinstance(ranges, Around) else ranges
        self._wait()

    def seed(self, rows: Integers, seeds: Sequence[int]) -> None:
        """Give `rows` new seeds, non-negative integers; their next episode is number 0."""
        self._seeds[rows] = Streams.from_seeds(list(seeds)).keys
        self.episode[rows] = -1

    def begin(self, rows: Integers, fixed: ResetOptions = NO_OPTIONS) -> None:
        """Begin the next episode of the given rows, shape (m,), drawing all that is not `fixed`.

        A fixed direction is normalised, and the direction rate loses its component along it.
        """
        self.episode[rows] += 1
        self.clock[rows] = 0
        streams = Streams(self._seeds[rows]).derive(self.episode[rows])
        if self._ranges is not None:
            self.parameters[rows] = self._ranges.draw(self.simulation.parameters, streams.derive(PARAMETER_STREAM))
        self._place(rows, fixed)
        self._begin_wind(rows, streams.derive(WIND_STREAM))
        if self._actuators.models:
            self._actuators.start_episodes(rows, streams.derive(ACTUATOR_STREAM), lambda *_: None)
        if self._sensors.models:
            self._begin_sensors(rows, streams.derive(SENSOR_STREAM))
        if not self._ready:
            self._waiting[rows] = False
            self._ready = not self._waiting.any()

    def follow(self, other: "World", rows: Integers) -> None:
        """Begin in `rows`, shape (m,), the episodes that the same rows of another world have begun."""
        self._seeds[rows] = other._seeds[rows]
        self.episode[rows] = other.episode[rows] - 1
        self.begin(rows)

    def _place(self, rows: Integers, fixed: ResetOptions) -> None:
        """Reference and state of new episodes."""
        fields = fixed.state
        if fixed.reference is None:
            draw_references(rows, self._seeds, self.episode, self._reference_ranges, self.reference)
        else:
            self.reference[rows] = fixed.reference
        draw_starts(rows, self._seeds, self.episode, self._start_ranges, self.parameters, self.reference, self.state)
        for name, value in fields.items():
            self.state[rows, STATE_FIELDS[name]] = value
        if "direction" in fields or "direction_rate" in fields:
            view = State(self.state[rows])
            view.direction[:] /= np.linalg.norm(view.direction, axis=-1, keepdims=True)
            along = np.sum(view.direction * view.direction_rate, axis=-1, keepdims=True)
            view.direction_rate[:] -= along * view.direction
            self.state[rows] = view.array

    def _begin_wind(self, rows: Integers, streams: Streams) -> None:
        if not self._wind.models:
            return
        period, step, blown = self.simulation.period, self.clock[rows], np.zeros((WIND_SIZE, rows.size)).T
        self._wind.start_episodes(
            rows, streams, lambda model, memory, random: model.sample(blown, memory, step, period, random)
        )
        if not self._moves_air and blown[:, WIND_FIELDS["velocity"]].any():
            raise ValueError("a wind with velocities must say so: its moves_air is False")
        self.wind[rows] = blown

    def _blow(self) -> None:
        """What blows over the coming control period."""
        period, blown = self.simulation.period, self.wind
        blown[:] = 0.0
        self._wind.apply(lambda model, memory, random: model.sample(blown, memory, self.clock, period, random))

    @property
    def measured(self) -> Floats:
        """The states as the sensors last saw them, shape (n, 18); the true ones without sensors."""
        return self._sensed[SEEN_STATE:].T if self._sensors.models else self.state

    def _begin_sensors(self, rows: Integers, streams: Streams) -> None:
        period, step, measured = self.simulation.period, self.clock[rows], np.asfortranarray(self.state[rows])
        self._sensors.start_episodes(
            rows, streams, lambda model, memory, random: model.sense(measured, memory, step, period, random)
        )
        self.measured[rows] = measured

    def _sense(self) -> None:
        """Let the sensors change what `kernel.step` has let them see."""
        period, measured = self.simulation.period, self.measured
        self._sensors.apply(lambda model, memory, random: model.sense(measured, memory, self.clock, period, random))

    def _act(self, action: Floats32) -> Floats32:
        """What the actuators make of an action."""
        out = np.asfortranarray(action, np.float64)
        self._actuators.apply(lambda model, memory, random: model.act(out, memory, self.clock, self.simulation, random))
        return out.astype(np.float32, order="C")

    def look(self, rows: Integers) -> tuple[Floats32, Floats]:
        """Observation and outcome of the given rows where they stand, as if hovering in calm air; see `step`."""
        observation = np.empty((rows.size, OBSERVATION_SIZE), np.float32)
        outcome = np.empty((self._outcome_shape[0], rows.size))
        action = np.zeros((rows.size, ACTION_SIZE), np.float32)
        memory, clock, still = self._memory[rows], self.clock[rows], np.zeros((WIND_SIZE, rows.size))
        seen = memory, clock, still, action, self._looking, observation, outcome
        if not self._sensors.models:
            step_kernel.step(*seen)
        else:
            sensed = np.empty((SENSED_SIZE, rows.size))
            step_kernel.step_sensed(*seen, sensed)
            sensed[SEEN_STATE:] = self._sensed[SEEN_STATE:, rows]
            step_kernel.observe_sensed(sensed, observation)
        return observation, outcome

    def step(self, action: Floats32) -> tuple[Floats32, Floats]:
        """Advance every row by one control period.

        Args:
            action: shape (n, 4), float32, components in [−1, 1].

        Returns:
            The observation, shape (n, 36), and the outcome, shape (k, n), with the rows that `kernel` names.

        Raises:
            ResetNeeded: a row has not begun an episode.
            ValueError: an action is out of range or not finite, or the wind is. Nothing has moved then.
        """
        if not self._ready:
            raise ResetNeeded(f"row {self._waiting.argmax()} has no episode: call reset before step")
        observation, outcome = np.empty(*self._observation_like), np.empty(self._outcome_shape)
        name = "action"
        if self._actuators.models:
            self._refuse(step_kernel.first_bad(action, self._blown), action, name)
            action, name = self._act(action), "what the actuators make of the action"
        memory, clock, wind, settings = self._memory, self.clock, self._blown, self._settings
        if self._sensors.models:
            bad = step_kernel.step_sensed(memory, clock, wind, action, settings, observation, outcome, self._sensed)
        else:
            bad = step_kernel.step(memory, clock, wind, action, settings, observation, outcome)
        if bad != -1:
            self._refuse(bad, action, name)
        if self._sensors.models:
            self._sense()
            step_kernel.observe_sensed(self._sensed, observation)
        if self._wind.models:
            self._blow()
        return observation, outcome[:, : self.rows] if self._padded else outcome

    def _refuse(self, bad: int, action: Floats32, name: str) -> None:
        """Raise what `kernel.first_bad` has found; `name` is what the action is called."""
        if bad >= 0:
            raise ValueError(
                f"{name} of row {bad} must be four numbers in [-1, 1], not {action[bad].tolist()};"
                " gymnasium.wrappers.ClipAction clips"
            )
        if bad < -1:
            row = -2 - bad
            raise ValueError(f"wind must blow finite numbers, not {self.wind[row].tolist()} in row {row}")
