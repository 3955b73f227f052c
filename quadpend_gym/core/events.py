"""Events at random times, such as gusts: a pause, an event, a pause and so on.

What is drawn for an event is a function of its number alone. The memory of a row begins with onset (s) and length (s)
of the present or next event, and ends with its number.
"""

from collections.abc import Callable
from typing import Annotated, Any

import numpy as np

from quadpend_gym.core.arrays import Booleans, Floats, Integers
from quadpend_gym.core.settings import Interval, Range, settings
from quadpend_gym.core.streams import Streams

Draw = Callable[[Floats, Any, Streams], None]  # draws the next events of the rows of a mask: (memory, rows, streams)


def first_events(memory_size: int, streams: Streams, draw: Draw) -> Floats:
    """Return the memory with the first event of each episode, shape (n, memory_size)."""
    memory = np.zeros((memory_size, streams.keys.size)).T
    memory[:, -1] = -1.0
    draw(memory, np.full(streams.keys.size, True), streams)
    return memory


def next_events(memory: Floats, rows: Any, streams: Streams, pause: Any, length: Any, *bounds: Any) -> list[Floats]:
    """Draw pause and length of the next events of the rows of a mask; return further numbers uniform in `bounds`."""
    memory[rows, -1] += 1.0
    pairs = zip(pause, length, *bounds, strict=True)
    waited, lasts, *drawn = streams[rows].between(memory[rows, -1].astype(np.int64), *pairs).T
    memory[rows, 0] += memory[rows, 1] + waited
    memory[rows, 1] = lasts
    return drawn


def present_events(memory: Floats, time: Any, streams: Streams, draw: Draw) -> Booleans:
    """Draw events until none has ended before `time` (s), shape (n,); return which ones have begun."""
    while (ended := time > memory[:, 0] + memory[:, 1]).any():
        draw(memory, ended, streams)
    return np.asarray(time > memory[:, 0])


def take_due(memory: Floats, time: Any, streams: Streams, draw: Draw, otherwise: Any) -> Floats:
    """Return what an event without a length has drawn, if its time has come, else another value, and draw the next."""
    found = np.where((time > memory[:, 0])[:, np.newaxis], memory[:, 2:-1], otherwise)
    present_events(memory, time, streams, draw)
    return found


class Events:
    """Mixin for models whose memory begins with the first event."""

    memory_size: Any
    _draw_next: Any

    def initial_memory(self, streams: Streams) -> Floats:
        """Draw the first event of each episode."""
        return first_events(self.memory_size, streams, self._draw_next)


@settings
class Interruptions(Events):
    """Base class of models that hold their last values for a time, again and again; an episode begins with a pause.

    Values are held if the middle of their control period lies in an interruption.
    """

    # duration of each interruption, uniform in this interval, at least 0.001
    length: Annotated[Interval, Range(0.001, 1e6, "s")] = (0.1, 0.1)
    pause: Annotated[Interval, Range(0.0, 1e6, "s")] = (0.9, 0.9)  # time before each of them, uniform in this interval
    kind: str = ""
    memory_size = 3  # of an event, around the last values

    def _draw_next(self, memory: Floats, ended: Any, streams: Streams) -> None:
        next_events(memory, ended, streams, self.pause, self.length)

    def _held(self, memory: Floats, step: Integers, period: float, streams: Streams) -> Booleans:
        """Return of which rows the values are held."""
        return present_events(memory, (step + 0.5) * period, streams, self._draw_next)
