"""The single environment: a world of one row behind `gymnasium.Env`."""

from typing import Any

import gymnasium as gym
import numpy as np

from quadpend_gym.core.arrays import Floats32
from quadpend_gym.core.validation import from_plain
from quadpend_gym.envs.outcome import DISTURBANCE, REWARD, TERMINATED
from quadpend_gym.envs.recorder import Recorder, check_render_mode, warn_without_render_mode
from quadpend_gym.envs.reset_options import check_reset_options
from quadpend_gym.envs.spaces import action_space, check_action, check_options, observation_space
from quadpend_gym.envs.world import World
from quadpend_gym.physics.parameters import Simulation
from quadpend_gym.physics.state import State
from quadpend_gym.tasks import as_task

_ROW = np.zeros(1, np.int64)
_REWARD, _TERMINATED, _NUMBERS = REWARD, TERMINATED, DISTURBANCE


class QuadPendulumEnv(gym.Env[Any, Any]):
    """A spherical inverted pendulum balanced on a quadrotor that tracks a reference in the wind.

    ## Description
    A bob of 0.2 kg stands on a massless rod of 0.3 m, free to swing in every direction, on the centre of a quadrotor of
    0.5 kg (Martinez-Vasquez et al., Machines 2023, 11(6), 578, Table 1). The bob's horizontal position, the quadrotor's
    height and its yaw are to follow a reference.

    ## Action Space
    `Box(-1, 1, (4,), float32)`; zero is hover. Out of range or not finite: ValueError.

    | action | command                       | unit | range at ±1    |
    |--------|-------------------------------|------|----------------|
    | 0      | thrust u = 6.86 (1 + a₀)      | N    | 0 … 13.72      |
    | 1      | torque τφ = 5 a₁ about roll   | N·m  | −5 … 5         |
    | 2      | torque τθ = 5 a₂ about pitch  | N·m  | −5 … 5         |
    | 3      | torque τψ = 1 a₃ about yaw    | N·m  | −1 … 1         |

    ## Observation Space
    `Box` of 36 finite numbers, float32, scaled by fixed constants to order one: tracking error and its rate, the
    pendulum's direction and its rate, attitude and rates, the reference's derivatives of order 2 to 6, and the yaw
    reference. The table is in `quadpend_gym.tasks.observation`; `read_observation(observation, name)` reads a field in
    physical units. The wind is not observed.

    ## Rewards
    Per step, in [0, 1]: 0.6 tracking + 0.15 upright + 0.1 yaw + 0.15 effort, see `quadpend_gym.tasks.rewards`. 1 only for
    perfect still tracking. The terms are in `info["reward_terms"]`.

    ## Starting State
    Flying a random reference (hover, circle, figure eight or helix) perfectly to first order in the tilt, but for a
    uniform deviation in each component: ±0.1 m, ±0.05 m/s; ±0.03 rad and ±0.05 rad/s of attitude and pendulum.

    `reset(options={"state": {"position": …}})` sets any of the state's fields (`quadpend_gym.physics.state`), leaving the
    others as drawn; `options={"reference": Reference.circle(1.0, 1.0)}` fixes the reference.

    ## Episode End
    Terminates when the pendulum is more than 60° from upright, the body tilts past 80°, the tracking error passes 3 m,
    quadrotor or bob touches the ground, or the state diverges. Truncates after 1000 steps (10 s).

    ## Arguments
    - `task`: `"track"` or `"hover"`, a `Task`, or a mapping of its fields.
    - `simulation`: a `Simulation` or a mapping of its fields: physical parameters, actuators, control period, substeps.
    - `wind`: a model of `quadpend_gym.wind`, a sum of them, a preset (``"windy"``), or a mapping with its kind. Calm
      without. Sensors, actuators and uncertain parameters come as wrappers, see `quadpend_gym.wrappers`.
    - `render_mode`: ``"human"``, a window in real time (H shows its keys); ``"rgb_array"``, an array of shape
      (480, 640, 3), uint8, from `render`; or None. Pictures need pygame-ce, the extra ``view``. Restarting from the
      window, or closing it, truncates the running episode; those after a closed window are not shown.

    ## Version History
    - v0: first version.
    """

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": 100}  # noqa: RUF012

    def __init__(
        self, task: Any = "track", simulation: Any = None, wind: Any = None, render_mode: str | None = None
    ) -> None:
        """Build the environment; see the class for the arguments.

        Raises:
            TypeError: an argument is of the wrong type.
            ValueError: an argument names or holds something unknown or out of range.
        """
        check_render_mode(render_mode, self.metadata["render_modes"])
        simulation = from_plain(Simulation, {} if simulation is None else simulation, "simulation")
        self.metadata = {**type(self).metadata, "render_fps": round(1.0 / simulation.period)}
        self.render_mode = render_mode
        self.world = World(1, as_task(task), simulation, wind)
        self.recorder = None if render_mode is None else Recorder(self.world, render_mode)
        self.observation_space = observation_space()
        self.action_space = action_space()
        self._seeded = False

    @property
    def state(self) -> State:
        """Named views of the state, each of shape (3,), see `quadpend_gym.physics.state`."""
        return State(self.world.state[0])

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats32, dict[str, Any]]:
        """Begin an episode: the first of `seed`, or the next one.

        Args:
            seed: non-negative integer.
            options: ``state`` and ``reference``, see the class.

        Raises:
            TypeError: an option is of the wrong type.
            ValueError: an option is unknown, or has a wrong shape or value.
        """
        options = check_options(options, ("state", "reference"))
        fixed = check_reset_options(options.get("state"), options.get("reference"), 1)
        super().reset(seed=seed)
        if seed is not None or not self._seeded:
            self.world.seed(_ROW, [self.np_random_seed])
            self._seeded = True
        self.world.begin(_ROW, fixed)
        observation, outcome = self.world.look(_ROW)
        if self.recorder is not None:
            self.recorder.begin(_ROW, outcome)
            self.recorder.show()
        return observation[0], self.world.info(outcome[:, 0], outcome[:, 0].tolist())

    def step(self, action: Any) -> tuple[Floats32, float, bool, bool, dict[str, Any]]:
        """Hold `action` for one control period.

        Args:
            action: shape (4,), components in [−1, 1].

        Raises:
            ResetNeeded: `reset` was never called, or wind was added since.
            TypeError: the action is not made of numbers.
            ValueError: it has the wrong shape, or is out of range or not finite.
        """
        action = check_action(action, (4,)).reshape(1, 4)
        observation, outcome = self.world.step(action)
        row = outcome[:, 0]
        numbers = row[:_NUMBERS].tolist()
        terminated, truncated = numbers[_TERMINATED] != 0.0, False
        if self.recorder is not None:
            self.recorder.step(action, outcome)
            self.recorder.show()
            truncated = self.recorder.pop_end_request()
        return observation[0], numbers[_REWARD], terminated, truncated, self.world.info(row, numbers)

    def render(self) -> Any:
        """The picture, see ``render_mode`` of the class; None where it is None or ``"human"``, which shows by itself.

        Raises:
            DependencyNotInstalled: there is no pygame-ce.
            ResetNeeded: `reset` was never called.
        """
        if self.recorder is None:
            warn_without_render_mode(self)
            return None
        pictures = self.recorder.render()
        return None if pictures is None else pictures[0]

    def close(self) -> None:
        """Close the window, if there is one."""
        if self.recorder is not None:
            self.recorder.close()
