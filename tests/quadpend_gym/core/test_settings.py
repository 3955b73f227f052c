"""Every field of every settings class takes both ends of its range, and refuses what is beyond with one sentence."""

import re
import sys
from collections.abc import Callable
from dataclasses import replace
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import numpy as np
import pytest

import quadpend_train.training.settings  # noqa: F401, so that all settings are imported
from quadpend_gym import Constant, Waypoints
from quadpend_gym.core.models import FromFactory
from quadpend_gym.core.settings import Interval, Range, declared, parse, settings
from quadpend_gym.randomization import Around, LoopChanges, LoopRanges, ParameterRanges
from quadpend_gym.sensors import Noise
from quadpend_gym.tasks.jumps import Jumps
from quadpend_gym.vehicles import VEHICLES
from quadpend_gym.wind import Drawn, Rescaled
from quadpend_gym.wind.steady import Rising

HUMMINGBIRD = VEHICLES["hummingbird"]
EXAMPLES = (  # of classes with fields that have no default
    *(Drawn(Constant()), Rescaled(Constant()), Rising(Constant(), 1.0), Noise(position=0.1)),
    *(Around(0.1), ParameterRanges(bob_mass=(0.1, 0.2)), LoopRanges(jitter=0.1)),
    LoopChanges((0.0, 1.0), latency=(0.0, 0.1)),
    Jumps((0.1, 0.2)),
    Waypoints((0.0, 1.0), ((0.0, 0.0, 1.0), (1.0, 0.0, 1.0))),
    *(HUMMINGBIRD, HUMMINGBIRD.rotors, HUMMINGBIRD.pole, HUMMINGBIRD.drag, HUMMINGBIRD.rate_loop),
)
BY_CLASS = {type(item): item for item in EXAMPLES}
KINDS = {
    item.__qualname__: item
    for name, module in sorted(sys.modules.items())
    for item in (vars(module).values() if name.startswith(("quadpend_gym.", "quadpend_train.training.")) else ())
    if isinstance(item, type) and hasattr(item, "__pydantic_fields__") and item.__module__ == name
    if not issubclass(item, FromFactory)
}
FIELDS = [
    pytest.param(kind, name, hint, bounds, id=f"{kind.__name__}.{name}")
    for kind in KINDS.values()
    for name, hint, bounds in declared(kind)
]


def shaped(hint: Any, number: float) -> Any:
    """Return a value of a type that consists of this number."""
    if get_origin(hint) in (Union, UnionType):
        return shaped(next(item for item in get_args(hint) if get_origin(item) is not Literal), number)
    if get_origin(hint) is Annotated:
        return shaped(get_args(hint)[0], number)
    if get_origin(hint) is tuple:
        return tuple(shaped(item, number) for item in get_args(hint) if item is not Ellipsis)
    return number


def refusal(change: Callable[[], Any]) -> str:
    """Return the sentence with which a change is refused, or "" if it is not."""
    try:
        change()
    except ValueError as error:
        return str(error)
    return ""


@pytest.mark.parametrize(("kind", "name", "hint", "bounds"), FIELDS)
def test_a_field_takes_the_ends_of_its_range_and_nothing_beyond(kind: Any, name: str, hint: Any, bounds: Range) -> None:
    example = BY_CLASS.get(kind) or kind()
    step = 1 if hint is int else 1e-9 * max(abs(bounds.low), abs(bounds.high), 1.0)

    def sentence(value: Any) -> str:
        return refusal(lambda: replace(example, **{name: shaped(hint, value)}))

    start = f"{kind.__name__}.{name} must be "
    for number in (bounds.low, bounds.high):  # a rule that joins several fields may refuse them
        assert not sentence(int(number) if hint is int else number).startswith(start)
    for value in (bounds.low - step, bounds.high + step, np.nan, "text", True):
        said = sentence(value)
        assert said.startswith(start), said
        assert f"{bounds}, not " in said
        assert "\n" not in said


@settings
class Pole:
    """An example."""

    mass: Annotated[float, Range(0.1, 1.0, "kg")]
    thrust: Annotated[Interval | None, Range(0.0, 9.0)] = None
    force: Annotated[float | tuple[float, float, float], Range(0.0, 1.0, "N")] = 0.0


def test_a_sentence_says_what_is_wrong() -> None:
    force = "pole.force must be a finite number or 3 finite numbers from 0 to 1 N, not (1, 2)"
    for data, sentence in (
        ({"mas": 1}, "pole has no field 'mas' (did you mean 'mass'?); its fields are mass, thrust, force"),
        ({}, "pole lacks the field 'mass'"),
        ({"mass": 2}, "pole.mass must be a finite number from 0.1 to 1 kg, not 2"),
        ({"mass": 1, "force": [1, 2]}, force),
        ({"mass": 1, "thrust": (2, 1)}, "pole.thrust: the numbers must be in the order (lowest, highest), not (2"),
        ({"mass": 1, "thrust": (2, 10)}, "must be None or 2 finite numbers from 0 to 9, not (2, 10)"),
        (3, "pole must be a Pole or a mapping of its fields, not 3"),
    ):
        with pytest.raises(ValueError, match=re.escape(sentence)):
            parse(Pole, data, "pole")


def test_numpy_values_become_plain_data() -> None:
    assert repr(Pole(np.float32(0.5), force=np.ones(3))) == "Pole(mass=0.5, thrust=None, force=(1.0, 1.0, 1.0))"
