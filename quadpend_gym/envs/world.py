"""The simulation of n sub-environments: arrays, models, random streams, and the sequence of a control step.

`QuadPendulumEnv` and `QuadPendulumVectorEnv` are thin adapters over a `World`, which does not handle spaces,
autoreset or time limits. `step_kernel` computes the equations of a step, and the models of wind, sensors and actuators
change its inputs and outputs in this order:

1. The actuators change the action.
2. The kernel advances every sub-environment under that action and the wind drawn for this control period.
3. The sensors change the state from which the observation is computed.
4. The wind models draw the wind over the next control period.
"""

from collections.abc import Sequence
from dataclasses import astuple
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector import VectorEnv

from quadpend_gym.core.arrays import Floats, Floats32, Integers
from quadpend_gym.core.models import ModelBatch
from quadpend_gym.core.packing import pack
from quadpend_gym.core.streams import (
    ACTUATOR_STREAM,
    JUMP_STREAM,
    PARAMETER_STREAM,
    SENSOR_STREAM,
    WIND_STREAM,
    Streams,
)
from quadpend_gym.envs.autopilot import AutopilotRows
from quadpend_gym.envs.inputs import NO_ERROR, clip_rounding, find_error, raise_step_error
from quadpend_gym.envs.kernel_layout import (
    MEMORY_PARAMETERS,
    MEMORY_POLE,
    MEMORY_REFERENCE,
    MEMORY_SIZE,
    MEMORY_STATE,
    MEMORY_TRAJECTORY,
    SENSED_AGE,
    SENSED_SIZE,
    SENSED_STATE,
    pack_settings,
)
from quadpend_gym.envs.loops import Schedule
from quadpend_gym.envs.outcome import LOOP, REWARD, StepInfo
from quadpend_gym.envs.reset_options import NO_OPTIONS, ResetOptions
from quadpend_gym.envs.step_kernel import KERNELS, MEASURE, STEP, observe_sensed
from quadpend_gym.envs.threads import run_in_threads
from quadpend_gym.physics.plants import plant_of
from quadpend_gym.physics.state import ACTION_SIZE, STATE_FIELDS, STATE_SIZE, State
from quadpend_gym.scenarios.scenario import Scenario
from quadpend_gym.tasks.observation import ALL, FULL
from quadpend_gym.tasks.references import CHANNELS, POINT_CHANNELS, REFERENCE_SIZE, draw_references
from quadpend_gym.tasks.rewards import steady_share
from quadpend_gym.tasks.starts import draw_starts, start_pole
from quadpend_gym.tasks.trajectories import Reference, Trajectory, TrajectoryTable
from quadpend_gym.vehicles import PARAMETER_NAMES
from quadpend_gym.vehicles.parameters import BOB_MASS, ROD_LENGTH
from quadpend_gym.wind import HAND, SAMPLE_SIZE, WIND_FIELDS, WIND_SIZE
from quadpend_gym.wind.base import can_hold

# Rows of `World._columns`: the sensed state, and what sensors change of it, with the age of the sample.
_SENSED_STATE = slice(SAMPLE_SIZE + SENSED_STATE.start, SAMPLE_SIZE + SENSED_STATE.stop)
_MEASUREMENT = slice(_SENSED_STATE.start, _SENSED_STATE.stop + 1)


class World:
    """The simulation of n sub-environments.

    Episode k of a sub-environment depends on its seed and on k only: not on the other sub-environments, and not on the
    actions of earlier episodes. Its start and its reference do not depend on wind, sensors and actuators either.

    Args:
        num_envs: Number n of sub-environments.
        scenario: Task, vehicle, wind, sensors, actuators and parameters, the same for all.
        num_threads: Number of threads that share the sub-environments. The numbers do not depend on it.

    Attributes:
        clock: Control steps since each episode began, shape (n,).
        episode: Number of the current episode of each sub-environment since it was seeded, shape (n,); −1 before the
            first.
        schedule: Which action acts when, and the loops of the episodes.
        observed: The fields of the observations that `observe` and `step` return: `FULL`, or `ALL` where the scenario
            observes another one.
        step_info: Reads `info` from an outcome.
    """

    def __init__(self, num_envs: int, scenario: Scenario, num_threads: int = 1) -> None:
        self.num_envs, self.scenario = num_envs, scenario
        task, simulation = self.task, self.simulation = scenario.task, scenario.simulation
        if scenario.autopilot is None:
            self.schedule: Schedule | AutopilotRows = Schedule(scenario.loop, simulation, num_envs)
            self._plant = plant_of(simulation)
            self._plant_steps = 1  # of the kernel in a control period
        else:
            self.schedule = autopilot = AutopilotRows(scenario.autopilot, scenario.loop, simulation, num_envs)
            self._plant, self._plant_steps = plant_of(autopilot.plant_simulation), autopilot.steps
        under_way = ACTION_SIZE * (self.schedule.slots - 1)
        self._memory = np.zeros((num_envs, MEMORY_SIZE + self._plant.memory_size + under_way))
        self.parameters[:] = simulation.parameters.as_array()
        self.observed = FULL if set(scenario.observation) <= set(FULL) else ALL
        self._observation_like = (num_envs, self.observed.size), np.dtype(np.float32)
        self.clock = np.zeros(num_envs, np.int64)
        self.episode = np.full(num_envs, -1, np.int64)
        self._seeds = np.zeros(num_envs, np.uint64)
        self._reference_ranges = pack(astuple(task.references))
        self._start_settings = pack(astuple(task.start)), start_pole(simulation, task.side)
        self._trajectories = TrajectoryTable(num_envs)
        self._last_action = np.zeros((num_envs, ACTION_SIZE))  # that the reward with `action_rate` compares
        self._jumps = ModelBatch(() if task.jumps is None else (task.jumps,), num_envs)
        # Values of the channels (F_x, F_y, z, ψ) without jumps of a `Reference`, and how far they jumped.
        self._without_jumps, self._jumped = np.zeros((2, CHANNELS, num_envs)).swapaxes(1, 2)
        ranges, actuators = scenario.parameters, scenario.actuators
        self._parameter_ranges = None if ranges is None else ranges.ranges(simulation.parameters)
        self._sensors = ModelBatch(scenario.sensors, num_envs)
        self._actuators = ModelBatch(actuators, num_envs, range(len(actuators))[::-1])  # the last one has stream 0
        winds = scenario.wind_models
        self._wind_models = ModelBatch(winds, num_envs)
        self._moves_air, self._holds = any(model.moves_air for model in winds), can_hold(winds)
        self._sample_size = SAMPLE_SIZE if self._holds else WIND_SIZE
        self._kernel: Any = KERNELS[self._plant.held_kernel if self._holds else self._plant.kernel]
        self._run: Any = self._kernel if num_threads == 1 else partial(run_in_threads, num_threads, self._kernel)
        if isinstance(self.schedule, AutopilotRows):
            self._run = partial(self.schedule.run, self._kernel)
        self._settings = pack_settings(task, self._plant, self._moves_air, bool(self._sensors.models))
        self._needs_reset = np.ones(num_envs, np.bool_)
        self._can_step = False
        self._columns_size = SAMPLE_SIZE + (SENSED_SIZE if self._sensors.models else 0)
        self._columns = np.zeros((self._columns_size, num_envs))  # wind and sensed values of the kernel
        changes_first = actuators, scenario.loop, scenario.autopilot, task.jumps  # before the kernel checks the action
        self._checks_first = any(changes_first) or num_threads > 1 or self._holds
        drawn = self._parameter_ranges is not None, scenario.loop is not None
        self.step_info = StepInfo(self._moves_air, bool(actuators), *drawn)
        # Memory access is slow if the rows of a large array start a power of two apart: add 8 columns to large arrays.
        self._padded = num_envs >= 512
        self._outcome_shape = self.step_info.outcome_size, num_envs + (8 if self._padded else 0)

    def close(self) -> None:
        """End the processes of an autopilot, if there is one."""
        if isinstance(self.schedule, AutopilotRows):
            self.schedule.close()

    @property
    def state(self) -> Floats:
        """View of the true states, shape (n, 18), see `quadpend_gym.physics.state`."""
        return self._memory[:, MEMORY_STATE]

    @property
    def parameters(self) -> Floats:
        """View of the true physical parameters of the episodes, shape (n, 9), see `Parameters.as_array`."""
        return self._memory[:, MEMORY_PARAMETERS]

    @property
    def reference(self) -> Floats:
        """View of the references, shape (n, 20), see `Reference.as_array`; zero where `trajectory` is another one."""
        return self._memory[:, MEMORY_REFERENCE]

    @property
    def plant_memory(self) -> Floats:
        """View of what the vehicles have besides the state, shape (n, k), see `physics.plants`."""
        return self._memory[:, MEMORY_SIZE : MEMORY_SIZE + self._plant.memory_size]

    @property
    def actuator_memories(self) -> list[Floats]:
        """What each actuator remembers, each of shape (n, k)."""
        return self._actuators.memories

    def trajectory(self, row: int) -> Trajectory:
        """Return the reference of a sub-environment."""
        return self._trajectories.find(row) or Reference.from_array(self.reference[row])

    @property
    def wind(self) -> Floats:
        """View of the wind over the next control period without hands, shape (n, 12), see `quadpend_gym.wind`."""
        return self._columns[:WIND_SIZE].T

    @property
    def _sampled(self) -> Floats:
        """View of the wind over the next control period, shape (n, 12), or (n, 16) if there can be hands."""
        return self._columns[: self._sample_size].T

    @property
    def measured(self) -> Floats:
        """View of the states that the sensors reported last, shape (n, 18); without sensors the true states."""
        return self._columns[_SENSED_STATE].T if self._sensors.models else self.state

    def seed(self, rows: Integers, seeds: Sequence[int]) -> None:
        """Seed the sub-environments `rows`, shape (m,), with non-negative integers; their next episode is number 0."""
        self._seeds[rows] = Streams.from_seeds(list(seeds)).keys
        self.episode[rows] = -1

    def start_episodes(self, rows: Integers, options: ResetOptions = NO_OPTIONS) -> None:
        """Start the next episode of the sub-environments `rows`, and draw everything that `options` do not fix.

        A fixed direction is normalised, and the direction rate loses its component along the direction.
        """
        self.episode[rows] += 1
        self.clock[rows] = 0
        streams = Streams(self._seeds[rows]).derive(self.episode[rows])
        nominal, ranges = self.simulation.parameters, self._parameter_ranges
        self.parameters[rows] = nominal if ranges is None else ranges.draw(nominal, streams.derive(PARAMETER_STREAM))
        for name, numbers in options.parameters.items():
            self.parameters[rows, PARAMETER_NAMES.index(name)] = numbers
        believed = self.parameters[rows] if self.scenario.pole_told else nominal.as_array()
        self._memory[rows, MEMORY_POLE] = believed[..., [ROD_LENGTH, BOB_MASS]]
        self.schedule.start_episodes(rows, streams)
        self._set_start(rows, options)
        if self._jumps.models:
            self._without_jumps[rows], self._jumped[rows] = self.reference[rows, :CHANNELS], 0.0
            self._jumps.start_episodes(rows, streams.derive(JUMP_STREAM), lambda *_: None)
        if self._wind_models.models:
            self._start_wind(rows, streams.derive(WIND_STREAM))
        if self._actuators.models:
            self._actuators.start_episodes(rows, streams.derive(ACTUATOR_STREAM), lambda *_: None)
        if self._sensors.models:
            self._start_sensors(rows, streams.derive(SENSOR_STREAM))
        if not self._can_step:
            self._needs_reset[rows] = False
            self._can_step = not self._needs_reset.any()

    def copy_episodes(self, other: "World", rows: Integers) -> None:
        """Start the current episodes of another world in the sub-environments `rows`, shape (m,), of this world."""
        self._seeds[rows] = other._seeds[rows]
        self.episode[rows] = other.episode[rows] - 1
        self.start_episodes(rows)

    def _set_start(self, rows: Integers, options: ResetOptions) -> None:
        self._set_reference(rows, options.references)
        keys, table = (self._seeds, self.episode), self._trajectories
        arguments = rows, *keys, *self._start_settings, self.parameters, self.reference, self.state
        draw_starts(*arguments, table.points(rows, self.clock[rows], self.simulation.period), table.first)
        for name, value in options.state.items():
            self.state[rows, STATE_FIELDS[name]] = value
        if "direction" in options.state or "direction_rate" in options.state:
            view = State(self.state[rows])
            view.direction[:] /= np.linalg.norm(view.direction, axis=-1, keepdims=True)
            along = np.sum(view.direction * view.direction_rate, axis=-1, keepdims=True)
            view.direction_rate[:] -= along * view.direction
            self.state[rows] = view.array
        self._memory[rows, MEMORY_SIZE:] = 0.0  # also the actions under way, which are hover
        self._last_action[rows] = 0.0
        self.plant_memory[rows] = self._plant.initial_memory(self.state[rows])

    def _set_reference(self, rows: Integers, fixed: tuple[Trajectory, ...]) -> None:
        """Set the references of new episodes: one for all, one for each, or, if `fixed` is empty, those of the task."""
        if not fixed and self.task.trajectory is not None:
            fixed = (self.task.trajectory,)
        if fixed:
            arrays = [item.as_array() if isinstance(item, Reference) else np.zeros(REFERENCE_SIZE) for item in fixed]
            self.reference[rows] = arrays
        else:
            draw_references(rows, self._seeds, self.episode, self._reference_ranges, self.reference)
        followed = [None if isinstance(item, Reference) else item for item in fixed or (None,)]
        if self._trajectories.assign(rows, followed):
            self._memory[:, MEMORY_TRAJECTORY] = self._trajectories.first

    def _start_wind(self, rows: Integers, streams: Streams) -> None:
        period, step, wind = self.simulation.period, self.clock[rows], np.zeros((SAMPLE_SIZE, rows.size)).T
        self._wind_models.start_episodes(
            rows, streams, lambda model, memory, random: model.sample(wind, memory, step, period, random)
        )
        if not self._moves_air and wind[:, WIND_FIELDS["velocity"]].any():
            raise ValueError("a wind model whose moves_air is False must not give an air velocity")
        if not self._holds and wind[:, HAND].any():
            raise ValueError("a wind model without a true attribute `holds` must not give a hand")
        self._sampled[rows] = wind[:, : self._sample_size]

    def _sample_wind(self) -> None:
        period, wind = self.simulation.period, self._sampled
        wind[:] = 0.0
        self._wind_models.apply(lambda model, memory, random: model.sample(wind, memory, self.clock, period, random))

    def _start_sensors(self, rows: Integers, streams: Streams) -> None:
        period, step, measured = self.simulation.period, self.clock[rows], np.zeros((STATE_SIZE + 1, rows.size)).T
        measured[:, :STATE_SIZE] = self.state[rows]
        self._sensors.start_episodes(
            rows, streams, lambda model, memory, random: model.sense(measured, memory, step, period, random)
        )
        self._columns[_MEASUREMENT, rows] = measured.T

    def _sense(self) -> None:
        """Let the sensors change the states that the kernel wrote, and their ages."""
        period, measured = self.simulation.period, self._columns[_MEASUREMENT].T
        self._columns[SAMPLE_SIZE + SENSED_AGE] = 0.0
        self._sensors.apply(lambda model, memory, random: model.sense(measured, memory, self.clock, period, random))

    def _actuate(self, action: Floats32) -> Floats32:
        """Return the action after the actuators, shape (n, 4)."""
        out, simulation = np.asfortranarray(action, np.float64), self.simulation
        self._actuators.apply(lambda model, memory, random: model.act(out, memory, self.clock, simulation, random))
        return out.astype(np.float32, order="C")

    def _jump(self) -> None:
        """Let the references jump at which the next step looks."""
        period, step, jumped = self.simulation.period, self.clock + 1, self._jumped
        self._jumps.apply(lambda model, memory, random: model.jump(jumped, memory, step, period, random))
        self.reference[:, :CHANNELS] = self._without_jumps + jumped

    def _points(self, rows: Any, clock: Integers, later: int = 0) -> Floats:
        """Return the points of the trajectories, see `TrajectoryTable.points`, with the jumps."""
        points = self._trajectories.points(rows, clock, self.simulation.period, later)
        if self._jumps.models and points.shape[1]:
            points[POINT_CHANNELS] += self._jumped[rows].T
        return points

    def observe(self, rows: Integers) -> tuple[Floats32, Floats]:
        """Return observation and outcome of the sub-environments `rows`, shapes (m, j) and (k, m), before a step.

        The observation has the fields `observed`. The outcome is that of a zero action in calm air, since no action or
        wind has led to the first state of an episode.
        """
        observation = np.empty((rows.size, self.observed.size), np.float32)
        outcome = np.empty((self._outcome_shape[0], rows.size))
        action = np.zeros((rows.size, ACTION_SIZE), np.float32)
        memory, clock = self._memory[rows], self.clock[rows] * self._plant_steps
        columns, schedule = np.zeros((self._columns_size, rows.size)), self.schedule
        inputs = memory, clock, columns, action, schedule.loops_of(rows)
        points = self._points(rows, self.clock[rows])
        self._kernel(MEASURE, *inputs, points, self._settings, observation, outcome, 0, rows.size)
        if self.scenario.loop is not None:
            outcome[LOOP] = schedule.drawn[:, rows]
        if self._sensors.models:
            columns[_MEASUREMENT] = self._columns[_MEASUREMENT, rows]
            observe_sensed(columns, observation)
        return observation, outcome

    def step(self, action: Floats32) -> tuple[Floats32, Floats]:
        """Advance every sub-environment by one control period.

        Args:
            action: Shape (n, 4), float32, components in [−1, 1]. A component that is outside by at most 10⁻⁶, the
                rounding of float32, is clipped.

        Returns:
            The observation with the fields `observed`, shape (n, j), and the outcome, shape (k, n), whose rows
            `quadpend_gym.envs.outcome` names.

        Raises:
            ResetNeeded: If a sub-environment has no episode.
            ValueError: If an action or the wind is wrong. Nothing has changed then.
        """
        if not self._can_step:
            where = "" if self.num_envs == 1 else f"sub-environment {self._needs_reset.argmax()} has no episode: "
            raise ResetNeeded(f"{where}call reset before step")
        observation, outcome = np.empty(*self._observation_like), np.empty(self._outcome_shape)
        if self._checks_first:
            error = find_error(action, self._sampled.T)
            if error != NO_ERROR:
                return self._step_clipped(error, action)
            if self._actuators.models:
                action = self._actuate(action)
        columns, schedule = self._columns, self.schedule
        if is_drawn := self.scenario.loop is not None:
            schedule.advance(self.clock)
        if self._jumps.models:
            self._jump()
        inputs = self._memory, self.clock, columns, action, schedule.loops
        points = self._points(slice(None), self.clock, 1)
        error = self._run(STEP, *inputs, points, self._settings, observation, outcome, 0, self.num_envs)
        if error != NO_ERROR:
            if self._actuators.models:
                raise_step_error(error, action, self._sampled, "action after the actuators")
            return self._step_clipped(error, action)
        if share := self.task.reward.action_rate:
            outcome[REWARD, : self.num_envs] *= steady_share(
                (action - self._last_action).T, self.simulation.period, share
            )
            self._last_action[:] = action
        if is_drawn:
            outcome[LOOP, : self.num_envs] = schedule.drawn
        if self._sensors.models:
            self._sense()
            observe_sensed(columns, observation)
        if self._wind_models.models:
            self._sample_wind()
        return observation, outcome[:, : self.num_envs] if self._padded else outcome

    def _step_clipped(self, error: int, action: Floats32) -> tuple[Floats32, Floats]:
        """Repeat a refused step with the action clipped if the action exceeds ±1 by rounding only; else raise."""
        clipped = clip_rounding(action)
        if clipped is action:
            raise_step_error(error, action, self._sampled, "action")
        return self.step(clipped)


def world_of(env: gym.Env[Any, Any] | VectorEnv[Any, Any, Any]) -> World:
    """Return the simulation of the innermost environment."""
    world = getattr(env.unwrapped, "world", None)
    if not isinstance(world, World):
        raise TypeError(f"env must be a QuadPendulum environment, wrapped or not, not {env}")
    return world
