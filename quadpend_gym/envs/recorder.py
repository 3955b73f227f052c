"""Recorder: stores the recent history of a world and renders pictures from it.

An environment with a render mode reports every start of an episode and every step to its recorder. When a picture is
needed, the recorder makes `Snapshot`s from this history and draws them with `quadpend_gym.viewer`.
"""

from typing import Any

import numpy as np
from gymnasium import logger
from gymnasium.error import ResetNeeded

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.envs.outcome import DISTURBANCE, REWARD, TILT, TRACKING_ERROR
from quadpend_gym.envs.world import World
from quadpend_gym.physics.state import STATE_FIELDS, STATE_SIZE, State
from quadpend_gym.vehicles.parameters import ROD_LENGTH
from quadpend_gym.viewer import check_pygame
from quadpend_gym.viewer.snapshot import Snapshot, shape_of

HISTORY_STEPS = 200  # latest states that are stored for each sub-environment


class Recorder:
    """The latest step of every sub-environment, and the part of its history that a picture shows.

    Args:
        world: The simulation that is recorded.
        mode: Render mode: ``"rgb_array"``, or for a single environment ``"human"``.
    """

    def __init__(self, world: World, mode: str) -> None:
        n = world.num_envs
        self.world, self.mode = world, mode
        self._started = np.zeros(n, np.bool_)
        self._outcome = np.zeros((0, n))
        self._return = np.zeros(n)
        self._states, self._latest = np.zeros((HISTORY_STEPS, n, STATE_SIZE)), 0
        self._shape = shape_of(world.simulation.vehicle)
        self._picture: Any = None
        self._window: Any = None

    def __getstate__(self) -> dict[str, Any]:
        """Return the attributes without picture and window, which cannot be copied; a copy makes new ones."""
        return {**self.__dict__, "_picture": None, "_window": None}

    def start_episodes(self, rows: Integers, outcome: Floats) -> None:
        """Record that episodes have started in the sub-environments `rows`, shape (m,); `outcome` is that of all."""
        self._started[rows], self._return[rows], self._outcome = True, 0.0, outcome
        self._states[self._latest, rows] = self.world.state[rows]

    def record_step(self, outcome: Floats) -> None:
        """Record a step of all sub-environments, see `World.step`."""
        self._outcome = outcome
        self._return += outcome[REWARD, : self.world.num_envs]
        self._latest = (self._latest + 1) % HISTORY_STEPS
        self._states[self._latest] = self.world.state

    def snapshot(self, row: int = 0) -> Snapshot:
        """Return the snapshot of one sub-environment after its latest step."""
        if not self._started[row]:
            raise ResetNeeded("reset must be called before render")
        world, outcome, clock = self.world, self._outcome[:, row], int(self.world.clock[row])
        rod_length = float(world.parameters[row, ROD_LENGTH])
        steps = np.arange(self._latest - min(clock, HISTORY_STEPS - 1), self._latest + 1) % HISTORY_STEPS
        states = self._states[steps, row]
        return Snapshot(
            clock * world.simulation.period,
            State(states[-1].copy()),
            rod_length,
            world.trajectory(row),
            outcome[DISTURBANCE].copy(),
            float(np.linalg.norm(outcome[TRACKING_ERROR])),
            float(outcome[TILT]),
            float(self._return[row]),
            states[:, STATE_FIELDS["position"]] + rod_length * states[:, STATE_FIELDS["direction"]],
            self._shape,
            world.task.side,
        )

    def show(self) -> None:
        """With the render mode ``"human"``, show the snapshot, and wait until the next step is due."""
        if self.mode != "human":
            return
        if self._window is None:
            check_pygame()
            from quadpend_gym.viewer.window import Window

            self._window = Window(self.world.simulation.period)
        self._window.show(self.snapshot)

    def pop_end_request(self) -> bool:
        """Return whether the user has asked to end the running episode, and clear this request."""
        return self._window is not None and bool(self._window.pop_end_request())

    def render(self) -> Any:
        """Return the pictures of all sub-environments, a tuple; with ``"human"`` None."""
        snapshots = [self.snapshot(row) for row in range(self.world.num_envs)]  # ResetNeeded if any has not started
        if self.mode == "human":
            return None
        if self._picture is None:
            check_pygame()
            from quadpend_gym.viewer.picture import Picture

            self._picture = Picture()
        return tuple(self._picture.render(snapshot) for snapshot in snapshots)

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            self._window.close()
            self._window = None


def check_render_mode(mode: str | None, modes: list[str]) -> None:
    """Check that `mode` is None or one of `modes`."""
    if mode is not None and mode not in modes:
        raise ValueError(f"render_mode must be None or one of {', '.join(modes)}, not {mode!r}")


def warn_without_render_mode(env: Any) -> None:
    """Warn, as Gymnasium's environments do, that `render` was called without a render mode."""
    modes = ", ".join(repr(mode) for mode in env.metadata["render_modes"])
    logger.warn(f"{type(env).__name__} renders nothing without a render_mode: make it with one of {modes}")
