"""What there is to see of a world: kept while an environment with a render mode steps, shown when it is asked for."""

from typing import Any

import numpy as np
from gymnasium import logger
from gymnasium.error import ResetNeeded

from quadpend_gym.core.arrays import Floats, Floats32, Integers
from quadpend_gym.envs.outcome import AIR_VELOCITY, COMMAND, DISTURBANCE, OUTCOME_SIZE, REWARD, TILT, TRACKING_ERROR
from quadpend_gym.envs.world import World
from quadpend_gym.physics.parameters import ROD_LENGTH
from quadpend_gym.physics.state import ACTION_SIZE, STATE_FIELDS, STATE_SIZE, State
from quadpend_gym.tasks.references import Reference
from quadpend_gym.viewer import check_pygame
from quadpend_gym.viewer.snapshot import Snapshot

PAST = 200  # steps that are kept
TILES = 64  # of a mosaic or a window, at most
_FOLLOW = 0.3  # s, in which the camera catches up
_DRIFT = 6.0  # m/s per N, how fast streaks drift in the wind
_SPIN = 40.0  # rad/s, of the rotors: slow enough to be seen


class Recorder:
    """The latest of every row that is shown, and as much of its past as a picture needs.

    Args:
        world: of n rows.
        mode: ``human``, ``rgb_array``, or, of vector environments, ``mosaic``.
    """

    def __init__(self, world: World, mode: str) -> None:
        """Nothing is to be seen yet."""
        n = world.rows if mode == "rgb_array" else min(world.rows, TILES)
        self.world, self.mode, self._rows = world, mode, n
        self._seen = np.zeros(n, np.bool_)
        self._outcome = np.zeros((0, n))
        self._action = np.zeros((n, ACTION_SIZE), np.float32)
        self._return, self._drift = np.zeros(n), np.zeros((3, n))
        self._states, self._latest = np.zeros((PAST, n, STATE_SIZE)), 0
        self._picture: Any = None
        self._window: Any = None

    def __getstate__(self) -> dict[str, Any]:
        """Without picture and window, which cannot be copied; a copy makes its own."""
        return {**self.__dict__, "_picture": None, "_window": None}

    def begin(self, rows: Integers, outcome: Floats) -> None:
        """Episodes have begun in some rows, shape (m,); `outcome` is that of all rows, see `World.step`."""
        rows = rows[rows < self._rows]
        self._seen[rows], self._outcome = True, outcome
        self._action[rows], self._return[rows], self._drift[:, rows] = 0.0, 0.0, 0.0
        self._states[self._latest, rows] = self.world.state[rows]

    def step(self, action: Floats32, outcome: Floats) -> None:
        """Every row has made a step."""
        n, self._outcome = self._rows, outcome
        self._action[:] = action[:n]
        self._return += outcome[REWARD, :n]
        self._drift += outcome[DISTURBANCE : DISTURBANCE + 3, :n]
        self._latest = (self._latest + 1) % PAST
        self._states[self._latest] = self.world.state[:n]

    def snapshot(self, row: int = 0) -> Snapshot:
        """One row as it is.

        Raises:
            ResetNeeded: the row has not begun an episode.
        """
        if not self._seen[row]:
            raise ResetNeeded("reset must be called before render")
        world, outcome, clock = self.world, self._outcome[:, row], int(self.world.clock[row])
        period, rod_length = world.simulation.period, float(world.parameters[row, ROD_LENGTH])
        past = self._states[np.arange(self._latest - min(clock, PAST - 1), self._latest + 1) % PAST, row]
        positions = past[:, STATE_FIELDS["position"]]
        # A first-order lag behind the quadrotor, over the past that is kept.
        fading = np.exp(-period / _FOLLOW * np.arange(len(past) - 1, -1, -1))
        fading[1:] *= -np.expm1(-period / _FOLLOW)
        thrust = 1.0 + float(self._action[row, 0])
        if len(outcome) == OUTCOME_SIZE:  # behind actuators it is told what acted
            thrust = float(outcome[COMMAND]) / world.simulation.command_scale[0]
        return Snapshot(
            clock * period,
            State(past[-1].copy()),
            rod_length,
            Reference.from_array(world.reference[row]),
            outcome[DISTURBANCE:AIR_VELOCITY].copy(),
            thrust,
            float(np.linalg.norm(outcome[TRACKING_ERROR:TILT])),
            float(outcome[TILT]),
            world.task.limits.pendulum_angle,
            float(self._return[row]),
            fading @ positions,
            positions + rod_length * past[:, STATE_FIELDS["direction"]],
            period * _DRIFT * self._drift[:, row],
            _SPIN * clock * period,
        )

    def snapshots(self) -> list[Snapshot]:
        """All rows that are shown, as they are."""
        return [self.snapshot(row) for row in range(self._rows)]

    def show(self) -> None:
        """In the mode ``human``, show what there is; return when it is time for the next step."""
        if self.mode != "human":
            return
        if self._window is None:
            check_pygame()
            from quadpend_gym.viewer.window import Window

            self._window = Window(self.world.simulation.period)
        self._window.show(self.snapshots)

    def pop_end_request(self) -> bool:
        """Return whether the user has asked to end the running episodes, and clear this request."""
        return self._window is not None and bool(self._window.pop_end_request())

    def render(self) -> Any:
        """For each row an array of shape (480, 640, 3), uint8; ``mosaic``: one array; ``human``: None.

        Raises:
            DependencyNotInstalled: there is no pygame-ce.
            ResetNeeded: a row has not begun an episode.
        """
        if self.mode == "human":  # which shows by itself
            self.snapshot(int(self._seen.argmin()))  # raises if this row has not begun
            return None
        snapshots = self.snapshots()
        if self._picture is None:
            check_pygame()
            from quadpend_gym.viewer.picture import Picture

            self._picture = Picture()
        if self.mode == "mosaic":
            return self._picture.render(snapshots)
        return tuple(self._picture.render([seen]) for seen in snapshots)

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            self._window.close()
            self._window = None


def check_render_mode(mode: str | None, modes: list[str]) -> None:
    """Raise ValueError unless `mode` is None or one of `modes`."""
    if mode is not None and mode not in modes:
        raise ValueError(f"render_mode must be None or one of {', '.join(modes)}, not {mode!r}")


def warn_without_render_mode(env: Any) -> None:
    """Warn, as Gymnasium's environments do, that one without a render mode is asked for a picture."""
    modes = ", ".join(repr(mode) for mode in env.metadata["render_modes"])
    logger.warn(f"{type(env).__name__} shows nothing without a render_mode: make it with one of {modes}")
