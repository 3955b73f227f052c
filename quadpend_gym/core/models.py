"""Wind, sensor and actuator models as data, and batches of them at run time.

A model is a settings class with two methods: `initial_memory` draws the model's memory at the start of an episode, and
`sample` (wind), `sense` (sensors) or `act` (actuators) computes its effect at a control step. Its field ``kind`` names
its class in files and specifications; the decorator `Registry.add` makes the name known.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Annotated, Any, Literal, Protocol, TypeVar, Union

import numpy as np
from pydantic import Field

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.factories import is_factory
from quadpend_gym.core.settings import Parsed, parse, suggest
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


@dataclass(frozen=True)
class Registry:
    """The kinds and presets of wind, sensor or actuator models."""

    name: str  # in error messages, for example "wind"
    protocol: Any  # runtime-checkable protocol of the models
    from_factory: type[Any] | None = None  # class of a text ``"module:factory"``; None: such texts are not accepted
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

    def _class(self, kind: Any) -> type[Any]:
        if self.from_factory and is_factory(kind):
            return self.from_factory
        if isinstance(kind, str) and kind in self.kinds:
            return self.kinds[kind]
        known = dict.fromkeys([*self.presets, *self.kinds])
        own = ", or give 'module:factory'" if self.from_factory else ""
        raise ValueError(f"there is no {self.name} {kind!r}{suggest(kind, known)}; there are {', '.join(known)}{own}")

    def field(self, function: Callable[[Any], Any] | None = None) -> Parsed:
        """Return the annotation of a field that takes what `parse` takes; `function` makes its value, else `parse`."""
        return Parsed(function or self.parse, self._accepted)

    def _accepted(self) -> Any:
        names: Any = Literal[tuple(dict.fromkeys([*self.presets, *self.kinds]))]
        one: Any = Union[(names, *self.kinds.values())]
        if self.from_factory:
            one = one | Annotated[str, Field(pattern=r"^[\w.]+:[\w.]+$")]
        return one | list[one] | None


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
