"""Wind, sensor and actuator models as data, and batches of them at run time.

A model is a settings class with two methods: `initial_memory` draws the model's memory at the start of an episode, and
`sample` (wind), `sense` (sensors) or `act` (actuators) computes its effect at a control step. Its field ``kind`` names
its class in files and specifications; the decorator `Registry.add` makes the name known.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from functools import cached_property
from typing import Annotated, Any, Literal, Protocol, TypeVar, Union

import numpy as np
from pydantic import Field

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.factories import call_factory, find_factory, is_factory
from quadpend_gym.core.settings import Parsed, parse, settings, suggest
from quadpend_gym.core.streams import Streams

Kind = TypeVar("Kind", bound=type[Any])


class Model(Protocol):
    """The interface that wind, sensor and actuator models share, for a batch of n sub-environments."""

    @property
    def memory_size(self) -> int:
        """Number of floats that the model stores for each sub-environment."""

    def initial_memory(self, streams: Streams) -> Floats:
        """Return the memory at the start of an episode, shape (n, memory_size); it may use block 0 of the streams."""


class ZeroInitialized:
    """Mixin for models whose memory starts at zero."""

    memory_size: Any

    def initial_memory(self, streams: Streams) -> Floats:
        """Return zeros, shape (n, memory_size)."""
        return np.zeros((self.memory_size, streams.keys.size)).T


class Stateless(ZeroInitialized):
    """Mixin for models without memory."""

    memory_size = 0


class Parts:
    """Base class of models that consist of other models.

    A single one has the random streams of the whole; each of several has its own.
    """

    parts: Any

    @property
    def memory_size(self) -> int:
        """Number of floats of all its models."""
        return sum(self._sizes)

    @cached_property
    def _sizes(self) -> Sequence[int]:
        return [model.memory_size for model in self.parts]

    def initial_memory(self, streams: Streams) -> Floats:
        """Return the initial memories of its models side by side."""
        memories = [model.initial_memory(self._streams(i, streams)) for i, model in enumerate(self.parts)]
        return np.hstack([np.zeros((streams.keys.size, 0)), *memories])

    def each(self, memory: Floats, streams: Streams, function: Callable[[Any, Floats, Streams], None]) -> None:
        """Call `function` with each model, its memory and its random streams."""
        first = 0
        for i, (model, size) in enumerate(zip(self.parts, self._sizes, strict=True)):
            function(model, memory[:, first : first + size], self._streams(i, streams))
            first += size

    def _streams(self, i: int, streams: Streams) -> Streams:
        return streams if len(self.parts) == 1 else streams.derive(i)


@settings
class FromFactory(Parts):
    """Base class of what a function or class of the user's own code returns.

    It acts like the returned models. Unlike those, it can be written as JSON and sent to other processes.
    """

    kind: str  # "module:factory"; the factory takes no arguments

    def __post_init__(self) -> None:
        _ = self.parts

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.kind,)


@dataclass(frozen=True)
class Registry:
    """The kinds and presets of wind, sensor or actuator models."""

    name: str  # in error messages, for example "wind"
    protocol: Any  # runtime-checkable protocol of the models
    from_factory: type[Any]  # class of a text ``"module:factory"``
    kinds: dict[str, type[Any]] = field(default_factory=dict)  # model classes by their ``kind``
    presets: dict[str, Any] = field(default_factory=dict)  # values that `parse` accepts, by name

    def add(self, kind: Kind) -> Kind:
        """Register a settings class under the default of its field ``kind``; a decorator."""
        self.kinds[kind.kind] = kind
        return kind

    def parse(self, value: Any) -> tuple[Any, ...]:
        """Return a tuple of models, in their order.

        The value is a model, a mapping with its ``kind``, the name of a preset or kind, a sequence or sum of these, or
        None for no model.
        """
        if value is None:
            return ()
        if isinstance(value, str):
            if value in self.presets:
                return self.parse(self.presets[value])
            value = {"kind": value}
        if isinstance(value, Mapping):
            if "kind" not in value:
                raise ValueError(f"{self.name} as a mapping needs its kind, one of {', '.join(self.kinds)}: {value!r}")
            value = parse(self._class(value.get("kind")), value, self.name)
        if isinstance(value, list | tuple):
            return tuple(model for item in value for model in self.parse(item))
        if isinstance(models := getattr(value, "models", None), tuple):  # a sum
            return self.parse(models)
        if isinstance(value, self.protocol) and not isinstance(value, type):
            return (value,)
        raise ValueError(f"{self.name} must be a model, a name, a mapping with its kind or a list, not {value!r}")

    def make(self, name: str) -> tuple[Any, ...]:
        """Return the models that the factory "module:factory" returns."""
        value = call_factory(name, find_factory(name))
        try:
            if value is None:  # a forgotten `return`
                raise ValueError("it returns None")
            return self.parse(value)
        except ValueError as error:
            raise ValueError(f"{name} must return {self.name} models: {error}") from error

    def make_own(self, name: str) -> tuple[Any, ...]:
        """Return those models. None may be of this package: what reads such models, like a controller, misses them."""
        models = self.make(name)
        if known := [type(model).__name__ for model in models if type(model) in self.kinds.values()]:
            raise ValueError(f"{name} must return models of your own classes, not {known[0]}: list that beside it")
        return models

    def _class(self, kind: Any) -> type[Any]:
        if is_factory(kind):
            return self.from_factory
        if isinstance(kind, str) and kind in self.kinds:
            return self.kinds[kind]
        known = dict.fromkeys([*self.presets, *self.kinds])
        raise ValueError(
            f"there is no {self.name} {kind!r}{suggest(kind, known)}; there are {', '.join(known)},"
            " or give 'module:factory'"
        )

    def field(self, function: Callable[[Any], Any] | None = None) -> Parsed:
        """Return the annotation of a field that takes what `parse` takes; `function` makes its value, else `parse`."""
        return Parsed(function or self.parse, self._accepted)

    def _accepted(self) -> Any:
        names: Any = Literal[tuple(dict.fromkeys([*self.presets, *self.kinds]))]
        one: Any = Union[(names, *self.kinds.values(), Annotated[str, Field(pattern=r"^[\w.]+:[\w.]+$")])]
        return one | list[one] | None


def kind_of(model: Any) -> str:
    """Return the kind of a model, or the name of a class of the user's own code."""
    return str(getattr(model, "kind", type(model).__name__))


def to_plain_data(value: Any, otherwise: Callable[[Any], Any], foreign: tuple[type[Any], ...] = ()) -> Any:
    """Return models and settings, nested to any depth, as data that can be written as JSON and read again.

    `otherwise` converts each object of another kind, such as a wind model of the user's own class.
    """
    if isinstance(value, Mapping):
        return {key: to_plain_data(item, otherwise, foreign) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_plain_data(item, otherwise, foreign) for item in value]
    if value is None or isinstance(value, str | int | float):
        return value
    package = type(value).__module__.partition(".")[0]
    is_ours = package in ("quadpend_gym", "quadpend_baselines", "quadpend_train")
    if is_dataclass(value) and is_ours and not isinstance(value, foreign):
        return {item.name: to_plain_data(getattr(value, item.name), otherwise, foreign) for item in fields(value)}
    return otherwise(value)


class ModelBatch:
    """Models with their memories and random streams for n sub-environments.

    Call `start_episodes` for every sub-environment before `apply`. The number of the random stream of each model is by
    default its position in `models`, in which order they are applied.
    """

    def __init__(self, models: tuple[Model, ...], rows: int, stream_numbers: Sequence[int] | None = None) -> None:
        self.models = models
        self._stream_numbers = range(len(models)) if stream_numbers is None else stream_numbers
        self.memories = [np.zeros((model.memory_size, rows)).T for model in models]
        self._streams = [Streams(np.zeros(rows, np.uint64)) for _ in models]

    def start_episodes(
        self, rows: Integers, streams: Streams, function: Callable[[Any, Floats, Streams], None]
    ) -> None:
        """Start new episodes in the sub-environments `rows`, shape (m,), with new random streams, one for each.

        `function` is called with each model, its memory of these sub-environments and their random streams.
        """
        for i, model in enumerate(self.models):
            own = streams.derive(self._stream_numbers[i])
            memory = np.asfortranarray(model.initial_memory(own))
            function(model, memory, own)
            self.memories[i][rows] = memory
            self._streams[i].keys[rows] = own.keys

    def apply(self, function: Callable[[Any, Floats, Streams], None]) -> None:
        """Call `function` with each model, its memory of all sub-environments and their random streams."""
        for model, memory, streams in zip(self.models, self.memories, self._streams, strict=True):
            function(model, memory, streams)
