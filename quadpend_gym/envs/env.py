"""The single environment: a `World` of one sub-environment behind the interface of `gymnasium.Env`."""

import math
import sys
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.envs import registration

from quadpend_gym.core.arrays import Floats32
from quadpend_gym.core.settings import plain
from quadpend_gym.envs.inputs import check_action
from quadpend_gym.envs.outcome import REWARD, SCALARS, TERMINATED
from quadpend_gym.envs.recorder import Recorder, check_render_mode, warn_without_render_mode
from quadpend_gym.envs.reset_options import NAMES, read_reset_options
from quadpend_gym.envs.spaces import spaces_of
from quadpend_gym.envs.world import World
from quadpend_gym.physics.state import ACTION_SIZE, State
from quadpend_gym.scenarios.library import as_scenario
from quadpend_gym.scenarios.scenario import Scenario
from quadpend_gym.vehicles import CONTROL_PERIOD

_METADATA = {"render_modes": ["human", "rgb_array"], "render_fps": round(1.0 / CONTROL_PERIOD)}


def frames_per_second(scenario: Scenario) -> int:
    """Return the number of control steps in a second, at least 1."""
    return max(round(1.0 / scenario.period), 1)


_ROW = np.zeros(1, np.int64)  # index of the only sub-environment
_MAKERS = registration.make.__code__, registration.make_vec.__code__


class _Spec(registration.EnvSpec):
    """A specification with the limit of steps that its scenario has, which is not a setting of its own.

    So `make` and `make_vec` do not see it: their arguments may replace the duration. They see the limit of a wrapper.
    """

    @property
    def max_episode_steps(self) -> int | None:
        steps: int = self.__dict__["max_episode_steps"]
        return None if sys._getframe(1).f_code in _MAKERS else steps

    @max_episode_steps.setter
    def max_episode_steps(self, steps: int | None) -> None:
        self.__class__ = registration.EnvSpec  # type: ignore[assignment]
        self.max_episode_steps = steps


class QuadPendulumEnv(gym.Env[Any, Any]):
    """A spherical inverted pendulum on a quadrotor that tracks a reference in the wind.

    ## Description
    A bob of 0.2 kg sits at the upper end of a massless rod of 0.3 m. The rod's lower end is attached to the centre of a
    quadrotor of 0.5 kg by a spherical joint (Martinez-Vasquez et al., Machines 2023, 11(6), 578, Table 1). The task is
    to keep the pendulum upright while the bob's horizontal position, the quadrotor's height and its yaw follow a
    reference.

    ## Action Space
    `Box(-1, 1, (4,), float32)`; the zero action is hover. An action that is out of range or not finite raises
    ValueError. A component that is outside [−1, 1] by at most 10⁻⁶, the rounding of float32, counts as −1 or 1.

    | action | command                       | unit | range at ±1    |
    |--------|-------------------------------|------|----------------|
    | 0      | thrust u = 6.86 (1 + a₀)      | N    | 0 … 13.72      |
    | 1      | torque τφ = 5 a₁ about roll   | N·m  | −5 … 5         |
    | 2      | torque τθ = 5 a₂ about pitch  | N·m  | −5 … 5         |
    | 3      | torque τψ = 1 a₃ about yaw    | N·m  | −1 … 1         |

    ## Observation Space
    `Box` of 36 finite numbers, float32, scaled by fixed constants to order one: tracking error and its rate, direction
    of the pendulum and its rate, attitude and its rates, the derivatives of order 2 to 6 of the reference, and the yaw
    reference. The box is unbounded, because no bounds are certain for every wind and start; wrappers that need bounds
    refuse it. `quadpend_gym.tasks.observation` has the table; `read_observation(observation, name)`
    returns one field in physical units. The observation does not contain the wind.

    ## Rewards
    The reward of a step is 0.6 tracking + 0.15 upright + 0.1 yaw + 0.15 effort, with four terms in [0, 1], see
    `quadpend_gym.tasks.rewards`. It is 1 only for exact tracking with zero action. `info["reward_terms"]` has the
    terms.

    ## Starting State
    An episode draws a random reference (hover, circle, figure eight or helix). It starts in the state that tracks this
    reference exactly to first order in the tilt, plus a uniform deviation of each component: ±0.1 m and ±0.05 m/s of
    the quadrotor, ±0.03 rad and ±0.05 rad/s of attitude and pendulum.

    `reset(options={"state": {"position": …}})` sets any field of the state (`quadpend_gym.physics.state`); fields that
    are not given are drawn. `reset(options={"reference": Reference.circle(1.0, 1.0)})` sets the reference, which may
    also be `Waypoints`. `Task(trajectory=…)` sets the reference of every episode.
    `reset(options={"parameters": {"bob_mass": 0.25}})` sets physical parameters of the episode, with the names and
    units of `Parameters`; the others are drawn or nominal.

    ## Episode End
    The episode terminates if the pendulum is more than 60° from upright, the body tilts by more than 80°, the tracking
    error exceeds 3 m, the quadrotor or the tip of the pole touches the ground, or the state diverges. An early
    termination is also called a fall. The episode is truncated after `duration`, 10 s by default, at any control
    period. As with Gymnasium's own environments, ``max_episode_steps`` of `gymnasium.make` replaces this limit, and −1
    removes it.

    ## Arguments
    - `scenario`: a `quadpend_gym.Scenario`, its name (``"windy"``), a TOML file, or a mapping of its fields. The other
      arguments are its fields and replace those that are given, for example ``gym.make("QuadPendulum-v0",
      scenario="gusts", vehicle="hummingbird", interface="body_rates")``. A mapping changes the fields that it names of
      the scenario's own part: ``task={"reward": {"effort": 0.3}}`` keeps its references and starts, while a `Task`
      replaces its task. Another vehicle scales the forces of the scenario's wind. The ids other than
      ``QuadPendulum-v0`` replace the scenario's task by their own.
    - `task`, `wind`, `vehicle`, `interface`, `latency`, `sensors`, `actuators`, `parameters`, `loop`, `autopilot`,
      `period`, `substeps`, `duration`, `wind_rise`, `unscored`, `observation`, `pole_told`: see `Scenario`.
      ``wind=None`` is no wind.
    - `render_mode`: ``"human"`` opens a window that runs in real time; with ``"rgb_array"`` the method `render`
      returns an array of shape (480, 640, 3), uint8; None renders nothing. Rendering needs pygame-ce, the extra
      ``view``. Closing the window truncates the running episode; later episodes run without one.

    ## Version History
    - v0: first version.
    """

    metadata: dict[str, Any] = _METADATA
    _spec: registration.EnvSpec | None = None

    def __init__(self, scenario: Any = None, render_mode: str | None = None, **parts: Any) -> None:
        """Build the environment; the class documents the arguments."""
        check_render_mode(render_mode, self.metadata["render_modes"])
        self.scenario = as_scenario(scenario, **parts)
        self.metadata = {**type(self).metadata, "render_fps": frames_per_second(self.scenario)}
        self.render_mode = render_mode
        self.world = World(1, self.scenario)
        self.recorder = None if render_mode is None else Recorder(self.world, render_mode)
        self.observation_space, self.action_space = spaces_of(self.scenario)
        self._observed = 0, self.world.observed.select(self.scenario.observation)
        self._steps: float = self.scenario.steps  # after which the environment truncates an episode
        self._seeded = False

    @property
    def spec(self) -> registration.EnvSpec | None:
        """The specification; its ``max_episode_steps`` is the limit of steps that the environment itself sets."""
        return self._spec

    @spec.setter
    def spec(self, spec: registration.EnvSpec | None) -> None:
        # `gymnasium.make` sets the specification and then adds a TimeLimit. A longer limit than `duration`, or none,
        # is possible only if the environment sets no limit, but `make` does not pass its argument on: read it there.
        caller = sys._getframe(1)
        if caller.f_code is registration.make.__code__:
            limit = caller.f_locals["max_episode_steps"]
            if limit is None:
                env_spec = caller.f_locals.get("env_spec")
                limit = None if isinstance(env_spec, _Spec) else getattr(env_spec, "max_episode_steps", None)
            if limit is not None:
                self._steps = math.inf
            elif spec is not None:
                spec.max_episode_steps = self.scenario.steps
                spec.__class__ = _Spec
        self._spec = spec

    @property
    def state(self) -> State:
        """Named views of the true state, each of shape (3,), see `quadpend_gym.physics.state`."""
        return State(self.world.state[0])

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats32, dict[str, Any]]:
        """Start an episode: the first episode of `seed`, or without a seed the next one.

        Args:
            seed: Non-negative integer, or None.
            options: ``state``, ``reference`` and ``parameters``, see the class.

        Returns:
            The first observation and the info.
        """
        checked = read_reset_options(options, NAMES, 1, self.scenario)
        super().reset(seed=plain(seed))
        if seed is not None or not self._seeded:
            self.world.seed(_ROW, [self.np_random_seed])
            self._seeded = True
        self.world.start_episodes(_ROW, checked)
        observation, outcome = self.world.observe(_ROW)
        if self.recorder is not None:
            self.recorder.start_episodes(_ROW, outcome)
            self.recorder.show()
        return observation[self._observed], self.world.step_info.read(outcome[:, 0], outcome[SCALARS, 0].tolist())

    def step(self, action: Any) -> tuple[Floats32, float, bool, bool, dict[str, Any]]:
        """Apply `action` for one control period.

        Args:
            action: Shape (4,), components in [−1, 1].

        Returns:
            Observation, reward, terminated, truncated and info.

        Raises:
            ResetNeeded: If `reset` has not been called yet, or a wrapper has changed the simulation since then.
        """
        action = check_action(action, (ACTION_SIZE,))[None]
        observation, outcome = self.world.step(action)
        column = outcome.ravel()
        scalars = column[SCALARS].tolist()
        terminated, truncated = scalars[TERMINATED] != 0.0, self.world.clock.item(0) >= self._steps
        if self.recorder is not None:
            self.recorder.record_step(outcome)
            self.recorder.show()
            truncated = self.recorder.pop_end_request() or truncated
        return (
            observation[self._observed],
            scalars[REWARD],
            terminated,
            truncated,
            self.world.step_info.read(column, scalars),
        )

    def render(self) -> Any:
        """Return an array of shape (480, 640, 3), uint8, with the render mode ``"rgb_array"``; otherwise None."""
        if self.recorder is None:
            warn_without_render_mode(self)
            return None
        pictures = self.recorder.render()
        return None if pictures is None else pictures[0]

    def close(self) -> None:
        """Close the window, if there is one, and end the processes of an autopilot."""
        self.world.close()
        if self.recorder is not None:
            self.recorder.close()
