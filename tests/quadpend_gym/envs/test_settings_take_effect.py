"""Every setting of the environments has an effect: a change of one setting alone changes the results."""

import warnings
from dataclasses import replace
from functools import cache
from typing import Any

import pytest

from quadpend_gym import (
    Constant,
    Drawn,
    Dryden,
    Gusts,
    Limits,
    OrnsteinUhlenbeck,
    PaperGusts,
    ReferenceSettings,
    RewardWeights,
    Sinusoid,
    StartSettings,
    Task,
)
from quadpend_gym.core.settings import Range, declared
from quadpend_gym.vehicles import VEHICLES, Drag
from quadpend_gym.wind import Wind
from tests.helpers.envs import draw_actions, make_vec, run_actions
from tests.quadpend_gym.core.test_settings import shaped

PAPER = VEHICLES["paper"]
VEHICLE = {
    "mass": 0.7,
    "inertia": (0.15, 0.15, 0.15),
    "gravity": 9.0,
    "torque": (4.0, 0.5),
    "pole": replace(PAPER.pole, mass=0.3),
    "pole length": replace(PAPER.pole, length=0.4, extent=0.4),
}
DRAG = {"pole": replace(PAPER.pole, drag_area=0.01), "drag": Drag(0.1)}  # in moving air only
MOVING_AIR = Constant(velocity=(3.0, 2.0, 1.0))  # drag areas have no effect in still air
SLALOMS = ReferenceSettings(slalom=5.0)  # without them, their speed has no effect
TASKS = {"references": SLALOMS, "start": StartSettings(), "limits": Limits(), "reward": RewardWeights()}
WINDS: list[Any] = [
    *(Constant(), Sinusoid(force=0.1), OrnsteinUhlenbeck(), PaperGusts(onset=0.1), Drawn(MOVING_AIR)),
    *(Gusts(velocity=(5.0, 0.0, 0.0), pause=(0.0, 0.1), length=(0.1, 0.2)), Dryden()),
]
CASES = [
    pytest.param(part, item, *field, id=f"{type(item).__name__}.{field[0]}")
    for part, item in (*TASKS.items(), *(("wind", wind) for wind in WINDS))
    for field in declared(type(item))
    if (type(item), field[0]) != (Gusts, "torque")  # which must be zero
]


@cache
def run(**kwargs: Any) -> bytes:
    """Everything that 40 sub-environments return in 30 steps."""
    env = make_vec(40, **kwargs)
    first, _ = env.reset(seed=0)
    results = run_actions(env, draw_actions(0, 30, 40))
    return first.tobytes() + b"".join(part.tobytes() for result in results for part in result[:4])


def flown(part: str, item: Any) -> bytes:
    return run(wind=item) if isinstance(item, Wind) else run(task=Task(**{part: item}))


def has_effect(part: str, item: Any, name: str, value: Any) -> bool:
    try:
        with warnings.catch_warnings(action="ignore"):  # extreme values are meant
            return flown(part, replace(item, **{name: value})) != flown(part, item)
    except ValueError:  # a rule that joins several fields
        return False


@pytest.mark.parametrize(("part", "item", "name", "hint", "bounds"), CASES)
def test_every_number_of_a_task_or_a_wind_has_an_effect(
    part: str, item: Any, name: str, hint: Any, bounds: Range
) -> None:
    """One of the ends of its range or its middle changes the results."""
    numbers = bounds.low, bounds.high, 0.5 * (bounds.low + bounds.high)
    assert any(has_effect(part, item, name, shaped(hint, number)) for number in numbers)


@pytest.mark.parametrize(("name", "value"), VEHICLE.items())
def test_every_number_of_the_vehicle_has_an_effect(name: str, value: Any) -> None:
    assert run(vehicle=replace(PAPER, **{name.split()[0]: value})) != run()


@pytest.mark.parametrize(("name", "value"), DRAG.items())
def test_drag_has_an_effect_in_moving_air_only(name: str, value: Any) -> None:
    vehicle = replace(PAPER, **{name: value})
    assert run(vehicle=vehicle) == run()
    assert run(vehicle=vehicle, wind=MOVING_AIR) != run(wind=MOVING_AIR)
