"""What there is to see of a world: kept while an environment with a render mode steps, shown by `viewer` when asked."""

from typing import Any, NamedTuple

import numpy as np
from gymnasium import logger
from gymnasium.error import ResetNeeded

from quadpend_gym import kernel
from quadpend_gym.arrays import Floats, Floats32, Integers
from quadpend_gym.params import ROD_LENGTH
from quadpend_gym.references import Reference
from quadpend_gym.state import State
from quadpend_gym.world import World

TRAIL = 200  # steps of the bob's way that are kept
_FOLLOW = 0.3  # s, in which the camera catches up
_DRIFT = 6.0  # m/s per N, how fast streaks drift in the wind
_SPIN = 40.0  # rad/s, of a rotor that carries its share of the weight: slow enough to be seen
_LAYOUT = np.array([[0.0, -1.0, 1.0], [1.0, 0.0, -1.0], [0.0, 1.0, 1.0], [-1.0, 0.0, -1.0]])  # see `actuators.Rotors`


class Snapshot(NamedTuple):
    """One sub-environment at one instant; all vectors are in the world frame.

    Attributes:
        time: since the episode began, s.
        state: see `quadpend_gym.state`.
        rod_length: m.
        reference: see `quadpend_gym.references`.
        disturbance: force on the quadrotor and on the bob, N, and torque, N·m, of the last step, shape (9,).
        command: thrust over the weight, and the torques as the action had them, shape (4,).
        error: norm of the tracking error, m.
        tilt: of the pendulum from upright, rad.
        tilt_limit: where an episode ends, rad.
        episode_return: the sum of the rewards.
        focus: where the camera looks, m, shape (3,).
        trail: where the bob was, the latest last, m, shape (k, 3).
        drift: how far the wind has carried the air's streaks, m, shape (3,).
        spin: angles of the four rotors, rad, shape (4,).
    """

    time: float
    state: State
    rod_length: float
    reference: Reference
    disturbance: Floats
    command: Floats
    error: float
    tilt: float
    tilt_limit: float
    episode_return: float
    focus: Floats
    trail: Floats
    drift: Floats
    spin: Floats

    @property
    def bob(self) -> Floats:
        """The bob's position, m, shape (3,)."""
        return np.asarray(self.state.position + self.rod_length * self.state.direction)


class Film:
    """The latest of every row, and as much of its past as a picture shows.

    Args:
        world: of n rows.
        mode: ``human``, ``rgb_array``, or, of vector environments, ``mosaic``.
    """

    def __init__(self, world: World, mode: str) -> None:
        """Nothing is to be seen yet."""
        n = world.rows
        self.world, self.mode = world, mode
        self._seen = np.zeros(n, np.bool_)
        self._disturbance, self._command, self._spin = np.zeros((n, 9)), np.zeros((n, 4)), np.zeros((n, 4))
        self._error, self._tilt, self._return = np.zeros(n), np.zeros(n), np.zeros(n)
        self._focus, self._drift, self._trail = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, TRAIL, 3))
        self._viewer: Any = None

    def begin(self, rows: Integers, outcome: Floats) -> None:
        """Episodes have begun in some rows, shape (m,); `outcome` is that of all rows, see `World.step`."""
        self._seen[rows] = True
        for kept in (self._command, self._return, self._drift, self._spin):
            kept[rows] = 0.0
        self._command[rows, 0] = 1.0
        self._look(rows, outcome)
        self._focus[rows] = self.world.state[rows, :3]

    def step(self, action: Floats32, outcome: Floats) -> None:
        """Every row has made a step."""
        if outcome.shape[0] == kernel.OUTCOME_SIZE:  # behind actuators it is told what acted
            self._command[:] = outcome[kernel.COMMAND :].T / self.world.simulation.command_scale
        else:
            self._command[:] = action
            self._command[:, 0] += 1.0
        self._return += outcome[kernel.REWARD]
        self._look(np.arange(self.world.rows), outcome)
        period = self.world.simulation.period
        self._focus += (self.world.state[:, :3] - self._focus) * -np.expm1(-period / _FOLLOW)
        self._drift += period * _DRIFT * self._disturbance[:, :3]
        shares = self._command[:, :1] + self._command[:, 1:] @ _LAYOUT.T
        self._spin += period * _SPIN * np.sqrt(np.clip(shares, 0.2, 3.0))

    def show(self) -> None:
        """In the mode ``human``, show what there is; return when it is time for the next step."""
        if self.mode == "human" and not (self._viewer is not None and self._viewer.closed):
            self._draw()

    def asked(self) -> bool:
        """Whether whoever watches wants the episodes to end."""
        return self._viewer is not None and bool(self._viewer.over)

    def snapshot(self, row: int = 0) -> Snapshot:
        """One row as it is.

        Raises:
            ResetNeeded: the row has not begun an episode.
        """
        if not self._seen[row]:
            raise ResetNeeded("reset must be called before render")
        world, clock = self.world, int(self.world.clock[row])
        trail = self._trail[row, np.arange(max(clock - TRAIL + 1, 0), clock + 1) % TRAIL]
        return Snapshot(
            clock * world.simulation.period,
            State(world.state[row].copy()),
            float(world.parameters[row, ROD_LENGTH]),
            Reference.from_array(world.reference[row]),
            self._disturbance[row].copy(),
            self._command[row].copy(),
            float(self._error[row]),
            float(self._tilt[row]),
            world.task.limits.pendulum_angle,
            float(self._return[row]),
            self._focus[row].copy(),
            trail,
            self._drift[row].copy(),
            self._spin[row].copy(),
        )

    def render(self) -> Any:
        """What `render` of an environment returns.

        Raises:
            DependencyNotInstalled: there is no pygame-ce.
            ResetNeeded: a row has not begun an episode.
        """
        if self.mode == "human":
            self.snapshot()
            return None
        return self._draw()

    def _draw(self) -> Any:
        from quadpend_gym import viewer

        snapshots = [self.snapshot(row) for row in range(self.world.rows)]
        if self._viewer is None:
            self._viewer = viewer.Viewer(self.mode, self.world.simulation.period)
        return self._viewer.show(snapshots)

    def __getstate__(self) -> dict[str, Any]:
        """Without the viewer, which cannot be copied; a copy gets its own."""
        return {**self.__dict__, "_viewer": None}

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._viewer is not None:
            self._viewer.close()
            self._viewer = None

    def _look(self, rows: Integers, outcome: Floats) -> None:
        self._disturbance[rows] = outcome[kernel.DISTURBANCE : kernel.AIR_VELOCITY, rows].T
        self._error[rows] = np.linalg.norm(outcome[kernel.TRACKING_ERROR : kernel.TILT, rows], axis=0)
        self._tilt[rows] = outcome[kernel.TILT, rows]
        state = State(self.world.state[rows])
        bob = state.position + self.world.parameters[rows, ROD_LENGTH : ROD_LENGTH + 1] * state.direction
        self._trail[rows, self.world.clock[rows] % TRAIL] = bob


def check_mode(mode: str | None, modes: list[str]) -> None:
    """Raise ValueError unless `mode` is None or one of `modes`."""
    if mode is not None and mode not in modes:
        raise ValueError(f"render_mode must be None or one of {', '.join(modes)}, not {mode!r}")


def tell_no_mode(env: Any) -> None:
    """Warn, as Gymnasium's environments do, that one without a render mode is asked for a picture."""
    logger.warn(
        f"{type(env).__name__} shows nothing without a render mode: "
        "gymnasium.make(…, render_mode='human') or 'rgb_array'"
    )
