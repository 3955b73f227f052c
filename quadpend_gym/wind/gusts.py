"""Single gusts: one-minus-cosine gusts that come at random, and the paper's random gusts."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.models import Stateless
from quadpend_gym.core.streams import Streams
from quadpend_gym.core.validation import as_vector, check_interval, check_number, check_positive, to_plain_fields
from quadpend_gym.wind.base import TURNED, WIND_FIELDS, Addable, Load, Loads, add_turned


@dataclass(frozen=True)
class Gusts(Loads):
    """One-minus-cosine gusts, one after the other, with pauses between them.

    A gust of length T that sets in at t₀ blows with load · ½ (1 − cos 2π (t − t₀)/T), turned about the vertical by its
    heading: the discrete gust of MIL-F-8785C, followed by its mirror image. Pause, length and heading of each gust are
    drawn anew; an episode begins with a pause. Loads are peaks.
    """

    pause: tuple[float, float] = (0.5, 3.0)  # s before a gust, uniform between the two
    length: tuple[float, float] = (0.5, 2.0)  # s, uniform between the two, at least 0.01
    heading: tuple[float, float] = (-np.pi, np.pi)  # rad from x towards y, uniform between the two
    kind: str = field(default="gusts", init=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, low in (("pause", 0.0), ("length", 0.01), ("heading", -np.inf)):
            check_interval(getattr(self, name), name, low)
        if self.load[WIND_FIELDS["torque"]].any():
            raise ValueError("a gust has no torque: headings turn winds, not the axes of the body")

    @property
    def memory_size(self) -> int:
        """When the present or next gust sets in (s), its length (s), its heading's cosine and sine, its number."""
        return 5

    def initial_memory(self, streams: Streams) -> Floats:
        """The first gust."""
        memory = np.zeros((5, streams.keys.size)).T
        memory[:, 4] = -1.0
        self._next(memory, np.full(streams.keys.size, True), streams)
        return memory

    def _next(self, memory: Floats, ended: Any, streams: Streams) -> None:
        """Follow the gusts of the rows `ended` by their next."""
        memory[ended, 4] += 1.0
        bounds = zip(self.pause, self.length, self.heading, strict=True)
        pause, length, heading = streams[ended].between(memory[ended, 4].astype(np.int64), *bounds).T
        memory[ended, 0] += memory[ended, 1] + pause
        memory[ended, 1] = length
        memory[ended, 2], memory[ended, 3] = np.cos(heading), np.sin(heading)

    def sample(self, out: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """The gust in the middle of the period, over which it is held."""
        time = (step + 0.5) * period
        while (ended := time > memory[:, 0] + memory[:, 1]).any():
            self._next(memory, ended, streams)
        onset, length, cosine, sine = memory[:, :4].T
        phase = np.maximum(time - onset, 0.0) / length
        swell = 0.5 - 0.5 * np.cos(2.0 * np.pi * phase)
        for axis in TURNED:
            if self.load[axis : axis + 3].any():
                add_turned(out, axis, self.load[axis : axis + 3], swell, cosine, sine)


@dataclass(frozen=True)
class PaperGusts(Stateless, Addable):
    """The paper's random gusts in x, y, z and yaw, calm until the onset (its Section 5).

    With the paper's onset of 10 s they never blow in an episode of 10 s: lower the onset, or raise the environment's
    `max_episode_steps`. The paper gives neither shape nor size. Here a new target is drawn every `hold` seconds,
    uniform in ± the amplitude, and approached along half a cosine: bounded and differentiable, as the paper's Theorem 1
    assumes.

    Raises:
        TypeError: a value is not a number, or the force neither a number nor three numbers.
        ValueError: a value is not finite, or out of its range.
    """

    force: Load = 0.3  # N, amplitude on the quadrotor
    yaw_torque: float = 0.05  # N·m, amplitude
    onset: float = 10.0  # s
    hold: float = 1.0  # s
    kind: str = field(default="paper_gusts", init=False)

    def __post_init__(self) -> None:
        to_plain_fields(self)
        if (self.amplitude < 0.0).any():
            raise ValueError(f"amplitudes must be at least 0, not {self.amplitude.tolist()}")
        check_number(self.onset, "onset", 0.0)
        check_positive(self.hold, "hold")

    @cached_property
    def amplitude(self) -> Floats:
        """Largest force in x, y, z (N) and yaw torque (N·m), shape (4,)."""
        return np.array([*as_vector(self.force, 3, "force"), check_number(self.yaw_torque, "yaw_torque")])

    @property
    def moves_air(self) -> bool:
        """It is a force."""
        return False

    def _target(self, gust: Integers, streams: Streams) -> Floats:
        drawn = 2.0 * streams.uniform(gust, 4) - 1.0
        return np.where(gust[:, np.newaxis] > 0, self.amplitude * drawn, 0.0)

    def sample(self, out: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """The gust in the middle of the period, over which it is held."""
        phase = np.maximum((step + 0.5) * period - self.onset, 0.0) / self.hold
        gust = np.floor(phase).astype(np.int64)
        blend = 0.5 - 0.5 * np.cos(np.pi * (phase - gust))[:, np.newaxis]
        strength = (1.0 - blend) * self._target(gust, streams) + blend * self._target(gust + 1, streams)
        yaw = WIND_FIELDS["torque"].stop - 1
        for column, axis in enumerate((0, 1, 2, yaw)):
            out[:, axis] += strength[:, column]
