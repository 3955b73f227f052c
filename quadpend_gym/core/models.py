"""Wind, sensor and actuator models as data, and batches of them at run time.

A model is a frozen dataclass of settings with two methods: `initial_memory` draws the model's memory at the start of an
episode, and `sample` (wind), `sense` (sensors) or `act` (actuators) computes its effect at a control step. The JSON
specification of an environment contains a model as a mapping of its settings, with its name as ``kind``.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any, Protocol

import numpy as np

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.factories import is_factory
from quadpend_gym.core.streams import Streams
from quadpend_gym.core.validation import from_plain, suggest

MOST_NESTED = 16  # models within models


class Model(Protocol):
    """The interface that wind, sensor and actuator models share, for a batch of n sub-environments."""

    @property
    def memory_size(self) -> int:
        """Number of floats that the model stores for each sub-environment."""

    def initial_memory(self, streams: Streams) -> Floats:
        """Return the memory at the start of an episode, shape (n, memory_size).

        Args:
            streams: Random streams of the n sub-environments. This method may use their block 0, see
                `Streams.uniform`.
        """


class ZeroInitialized:
    """Mixin for models whose memory starts at zero."""

    memory_size: Any

    def initial_memory(self, streams: Streams) -> Floats:
        """Return zeros, shape (n, memory_size), columns contiguous."""
        return np.zeros((self.memory_size, streams.keys.size)).T


class Stateless(ZeroInitialized):
    """Mixin for models without memory."""

    @property
    def memory_size(self) -> int:
        """Zero."""
        return 0


@dataclass(frozen=True)
class Registry:
    """The kinds and presets of wind, sensor or actuator models.

    Attributes:
        name: Name of the registry in error messages, for example "wind".
        noun: Description of one model in error messages, for example "a wind model".
        protocol: Runtime-checkable protocol of the models.
        kinds: Model classes by their ``kind``.
        presets: Values that `parse` accepts, by name.
        from_factory: Model class that stands for a text ``"module:factory"``; None if such texts are not accepted.
    """

    name: str
    noun: str
    protocol: Any
    kinds: dict[str, type[Any]] = field(default_factory=dict)
    presets: dict[str, Any] = field(default_factory=dict)
    from_factory: type[Any] | None = None

    def __post_init__(self) -> None:
        _REGISTRIES.append(self)

    def parse(self, value: Any) -> tuple[Any, ...]:
        """Convert `value` to a tuple of models and keep their order.

        Args:
            value: A model, a mapping with its ``kind``, the name of a preset or kind, a sequence or sum of these, or
                None for no model.

        Raises:
            TypeError: If `value` is none of these.
            ValueError: If a name, kind or setting is unknown, or a setting is out of range.
        """
        _check_depth(value, self.name)
        if value is None:
            return ()
        if isinstance(value, str):
            if value in self.presets:
                return self.parse(self.presets[value])
            if self._class(value) is None:
                known = [*self.presets, *self.kinds]
                own = "; or give 'module:factory'" if self.from_factory else ""
                raise ValueError(
                    f"there is no {self.name} {value!r}{suggest(value, known)}; there are {', '.join(known)}{own}"
                )
            value = {"kind": value}
        if isinstance(value, Mapping):
            data = dict(value)
            if (kind := self._class(data.get("kind"))) is None:
                given = data.get("kind")
                raise ValueError(
                    f"{self.name} has no kind {given!r}{suggest(given, self.kinds)}; the kinds are"
                    f" {', '.join(self.kinds)}"
                )
            if kind is not self.from_factory:
                del data["kind"]
            value = from_plain(kind, data, self.name)
        if isinstance(value, list | tuple):
            return tuple(model for item in value for model in self.parse(item))
        if not isinstance(value, type):
            if isinstance(models := getattr(value, "models", None), tuple):  # a sum
                return self.parse(models)
            if isinstance(value, self.protocol):
                return (value,)
        raise TypeError(f"{self.name} must be {self.noun} or a mapping with its kind, not {value!r}")

    def _class(self, kind: Any) -> type[Any] | None:
        """Return the model class of a kind or of a text ``"module:factory"``; None if there is none."""
        if isinstance(kind, str) and kind in self.kinds:
            return self.kinds[kind]
        return self.from_factory if is_factory(kind) else None


_REGISTRIES: list[Registry] = []


def _check_depth(value: Any, name: str) -> None:
    """Refuse models that contain models that contain models more than `MOST_NESTED` deep."""
    level, depth = [value], 0
    while level := [part for item in level for part in _parts(item)]:
        depth += 1
        if depth > MOST_NESTED:
            raise ValueError(f"{name} must be models within models at most {MOST_NESTED} deep, not deeper")


def _parts(value: Any) -> list[Any]:
    """Return what a model, a mapping or a sequence contains that can contain models; a sum counts as its models."""
    if isinstance(value, Mapping):
        value = list(value.values())
    elif not isinstance(value, list | tuple):
        value = [getattr(value, "wind", None)]
    parts = [part for item in value for part in (getattr(item, "models", None) or (item,))]
    return [part for part in parts if isinstance(part, Mapping | list | tuple) or hasattr(part, "wind")]


def to_plain_data(value: Any, otherwise: Callable[[Any], Any]) -> Any:
    """Return models and settings as data that can be written as JSON and read again.

    Args:
        value: Dataclasses of this project, models of a registered class, mappings, sequences, texts and numbers, nested
            to any depth.
        otherwise: Converts each object that is none of these, such as a wind model whose class is in no registry.
    """
    if isinstance(value, Mapping):
        return {key: to_plain_data(item, otherwise) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_plain_data(item, otherwise) for item in value]
    if value is None or isinstance(value, str | int | float):
        return value
    kinds = [kind for registry in _REGISTRIES for kind in registry.kinds.values()]
    if is_dataclass(value) and (is_project_class(type(value)) or type(value) in kinds):
        return {item.name: to_plain_data(getattr(value, item.name), otherwise) for item in fields(value)}
    return otherwise(value)


def is_project_class(kind: type[Any]) -> bool:
    """Return whether a class is defined in one of the packages of this project."""
    return kind.__module__.partition(".")[0] in ("quadpend_gym", "quadpend_baselines", "quadpend_train")


class ModelBatch:
    """Models with their memories and random streams for n sub-environments.

    Args:
        models: Models in the order in which they are applied.
        rows: Number n of sub-environments.
        stream_numbers: Number of the random stream of each model; by default its position in `models`.
    """

    def __init__(self, models: tuple[Model, ...], rows: int, stream_numbers: Sequence[int] | None = None) -> None:
        """Allocate the memories; call `start_episodes` for every sub-environment before `apply`."""
        self.models = models
        self._stream_numbers = range(len(models)) if stream_numbers is None else stream_numbers
        self._memories = [np.zeros((model.memory_size, rows)).T for model in models]
        self._streams = [Streams(np.zeros(rows, np.uint64)) for _ in models]

    def start_episodes(
        self, rows: Integers, streams: Streams, function: Callable[[Any, Floats, Streams], None]
    ) -> None:
        """Start new episodes in some sub-environments and apply the models to them for the first time.

        Args:
            rows: Indices of the sub-environments, shape (m,).
            streams: Random streams of these m sub-environments for the new episodes.
            function: Called with each model, its memory of these sub-environments and their random streams.
        """
        for i, model in enumerate(self.models):
            own = streams.derive(self._stream_numbers[i])
            memory = np.asfortranarray(model.initial_memory(own))
            function(model, memory, own)
            self._memories[i][rows] = memory
            self._streams[i].keys[rows] = own.keys

    def apply(self, function: Callable[[Any, Floats, Streams], None]) -> None:
        """Call `function` with each model, its memory of all sub-environments and their random streams."""
        for model, memory, streams in zip(self.models, self._memories, self._streams, strict=True):
            function(model, memory, streams)
