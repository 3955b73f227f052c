"""Numbers outside their declared range are refused with one sentence that names the field, its range and the value."""

from dataclasses import dataclass, fields
from typing import Annotated, Any

import numpy as np
import pytest

from quadpend_gym import Actuators, OrnsteinUhlenbeck, Parameters, Simulation
from quadpend_gym.actuators import KINDS as ACTUATORS
from quadpend_gym.core.ranges import Range, check_fields, declared_ranges
from quadpend_gym.sensors import KINDS as SENSORS
from quadpend_gym.sensors import Channel
from quadpend_gym.wind import KINDS as WINDS
from tests.helpers.bad_input import INF, NAN, assert_refused


@dataclass(frozen=True)
class Example:
    """A dataclass with a field of every kind of range."""

    length: Annotated[float, Range(0.5, 2.0, "m")] = 1.0
    count: Annotated[int, Range(1, 1000)] = 1
    pair: Annotated[tuple[float, float], Range(0.0, 10.0, "s")] = (0.0, 1.0)
    numbers: Annotated[float | tuple[float, ...], Range(-1.0, 1.0, "N")] = 0.0
    optional: Annotated[float | None, Range(0.0, 1.0)] = None
    named: Annotated[str | float, Range(0.0, 1.0)] = "light"
    nested: Annotated[Any, Range(0.0, 1.0)] = ((0.0, 0.5), (1.0, 1.0))
    free: float = 1e300

    def __post_init__(self) -> None:
        check_fields(self, "example.")


GOOD = [
    {},
    {"length": 0.5},
    {"length": 2},
    {"length": np.float32(1.5)},
    {"count": 1000},
    {"pair": (0.0, 10.0)},
    {"numbers": (-1.0, 0.0, 1.0)},
    {"numbers": -1.0},
    {"optional": 1.0},
    {"named": "anything"},
    {"named": 0.5},
    {"free": INF},
]
BAD = [
    ({"length": 0.4}, r"example.length must be a finite number in \[0.5, 2\] m, not 0.4"),
    ({"length": NAN}, r"example.length must be a finite number in \[0.5, 2\] m, not nan"),
    ({"length": 10**30}, r"example.length must be a finite number in \[0.5, 2\] m, not about 1e30"),
    ({"length": -(10**5000)}, "example.length must be .* not about -1e5000"),
    ({"length": "1"}, "example.length must be a number, not '1'"),
    ({"length": True}, "example.length must be a number, not True"),
    ({"length": None}, "example.length must be a number, not None"),
    ({"length": (1.0, 1.0)}, "example.length must be a number, not"),
    ({"count": 1001}, "example.count must be a whole number from 1 to 1000, not 1001"),
    ({"count": 10**30}, "example.count must be a whole number from 1 to 1000, not about 1e30"),
    ({"count": 2.0}, "example.count must be a whole number from 1 to 1000, not 2.0"),
    ({"pair": (0.0, 10.1)}, r"example.pair must be a finite number in \[0, 10\] s, not 10.1"),
    ({"pair": (2.0, 1.0)}, "example.pair must be in the order"),
    ({"pair": 1.0}, "example.pair must be a pair"),
    ({"numbers": (0.0, 1.1)}, r"example.numbers must be a finite number in \[-1, 1\] N, not 1.1"),
    ({"numbers": None}, "example.numbers must be a number, not None"),
    ({"optional": -0.1}, r"example.optional must be a finite number in \[0, 1\], not -0.1"),
    ({"named": 2.0}, r"example.named must be a finite number in \[0, 1\], not 2.0"),
    ({"nested": ((0.0, 2.0), 1.0)}, r"example.nested must be a finite number in \[0, 1\], not 2.0"),
]


@pytest.mark.parametrize("values", GOOD)
def test_values_in_their_range_are_accepted(values: dict[str, Any]) -> None:
    Example(**values)


@pytest.mark.parametrize(("values", "message"), BAD)
def test_values_outside_their_range_are_refused(values: dict[str, Any], message: str) -> None:
    assert_refused(lambda: Example(**values), message, (TypeError, ValueError))


def test_the_declared_ranges_are_those_of_the_fields_in_their_order() -> None:
    found = declared_ranges(Example)
    assert list(found) == ["length", "count", "pair", "numbers", "optional", "named", "nested"]
    assert found["length"] == Range(0.5, 2.0, "m")


NUMBERS = (int, float)
NOISELESS = [kind for name, kind in SENSORS.items() if name != "noise"]  # the fields of a noise are channels
KINDS = [*WINDS.values(), *NOISELESS, *ACTUATORS.values(), Parameters, Actuators, Simulation, Channel]


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_every_number_of_a_model_declares_its_range(kind: Any) -> None:
    """A field that a class redeclares without a range loses the range of its base class."""
    for item in fields(kind):
        numbers = item.default if isinstance(item.default, tuple) else (item.default,)
        if numbers and all(type(number) in NUMBERS for number in numbers):
            assert item.name in declared_ranges(kind), item.name


def test_a_redeclared_load_keeps_a_range() -> None:
    assert_refused(lambda: OrnsteinUhlenbeck(force=1e300), r"force must be a finite number in \[0, 1e\+12\] N, not 1e")
    assert_refused(lambda: OrnsteinUhlenbeck(torque=-0.1), r"torque must be a finite number in \[0, 1e\+12\] N·m")
