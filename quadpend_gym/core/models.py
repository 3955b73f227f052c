"""Models as data, in families, and models at work.

Wind, sensors and actuators are three families of models. A model is frozen data with two functions: `start` draws what
a new episode remembers, and one that is its family's own does its work at every control step. As plain data a model is
a mapping with its ``kind``, which is how it travels in an environment's JSON specification.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.streams import Streams
from quadpend_gym.core.validation import from_plain


class Model(Protocol):
    """What the models of every family have in common, for a batch of n rows."""

    @property
    def memory_size(self) -> int:
        """How many numbers a row has to remember."""

    def start(self, streams: Streams) -> Floats:
        """Memory of new episodes, shape (n, memory_size), drawn from block 0 of the rows' streams."""


class ZeroInitialized:
    """The part of a model whose memory begins with zeros."""

    memory_size: Any

    def start(self, streams: Streams) -> Floats:
        """Zeros, shape (n, memory_size)."""
        return np.zeros((streams.keys.size, self.memory_size))


class Stateless(ZeroInitialized):
    """The part of a model that has nothing to remember."""

    @property
    def memory_size(self) -> int:
        """Nothing to remember."""
        return 0


@dataclass(frozen=True)
class Registry:
    """Models of one sort.

    Attributes:
        name: what the sort is called in error messages.
        noun: what one of them is called.
        protocol: what its models can do; runtime checkable.
        kinds: its models by the names they have as data.
        presets: ready models by name.
    """

    name: str
    noun: str
    protocol: Any
    kinds: Mapping[str, type[Any]]
    presets: Mapping[str, Any] = field(default_factory=dict)

    def members(self, value: Any) -> tuple[Any, ...]:
        """The models that `value` is or describes, in order.

        Args:
            value: a model, a mapping with its kind, the name of a preset or kind, a sequence or sum of these, or None.

        Raises:
            TypeError: it is none of these.
            ValueError: a name or kind is unknown, or a setting is unknown or out of range.
        """
        if value is None:
            return ()
        if isinstance(value, str):
            if value in self.presets:
                return self.members(self.presets[value])
            if value not in self.kinds:
                known = ", ".join([*self.presets, *self.kinds])
                raise ValueError(f"there is no {self.name} {value!r}; there are {known}")
            value = {"kind": value}
        if isinstance(value, Mapping):
            data = dict(value)
            kind = data.pop("kind", None)
            if not isinstance(kind, str) or kind not in self.kinds:
                raise ValueError(f"{self.name} has no kind {kind!r}; the kinds are {', '.join(self.kinds)}")
            value = from_plain(self.kinds[kind], data, self.name)
        if isinstance(value, list | tuple):
            return tuple(member for item in value for member in self.members(item))
        if not isinstance(value, type):
            if isinstance(models := getattr(value, "models", None), tuple):  # a sum, or whatever looks like one
                return self.members(models)
            if isinstance(value, self.protocol):
                return (value,)
        raise TypeError(f"{self.name} must be {self.noun} or a mapping with its kind, not {value!r}")


class ModelBatch:
    """Models of one family at work on a batch of rows: their memories and random streams.

    Args:
        models: in the order in which they work.
        rows: number of rows.
        places: the number of each model's random stream; without, its place among the models.
    """

    def __init__(self, models: tuple[Model, ...], rows: int, places: Sequence[int] | None = None) -> None:
        """Allocate the memories; every row must `begin` before the models `work`."""
        self.models = models
        self._places = range(len(models)) if places is None else places
        self._memories = [np.zeros((model.memory_size, rows)).T for model in models]
        self._streams = [Streams(np.zeros(rows, np.uint64)) for _ in models]

    def begin(self, rows: Integers, streams: Streams, first: Callable[[Any, Floats, Streams], None]) -> None:
        """Begin new episodes in `rows`, shape (m,), with a random stream for each, and let the models do `first`.

        Args:
            rows: indices.
            streams: of the rows.
            first: called with each model, its memory of these rows and their streams.
        """
        for i, model in enumerate(self.models):
            random = streams.derive(self._places[i])
            memory = np.asfortranarray(model.start(random))
            first(model, memory, random)
            self._memories[i][rows] = memory
            self._streams[i].keys[rows] = random.keys

    def work(self, function: Callable[[Any, Floats, Streams], None]) -> None:
        """Call `function` with each model, its memory of all rows and their streams."""
        for model, memory, streams in zip(self.models, self._memories, self._streams, strict=True):
            function(model, memory, streams)
