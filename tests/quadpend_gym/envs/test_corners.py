"""Environments keep their promises at the ends of every declared range, and for random combinations of values.

Observations are finite and in their space, rewards are in [0, 1], nothing warns, and no step takes a second. A setting
may be refused, with one sentence, where it contradicts another one: rotors that cannot lift a pole of 1000 kg.
"""

import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from quadpend_gym import (
    Reference,
    Simulation,
)
from quadpend_gym.actuators import KINDS as ACTUATORS
from quadpend_gym.core.ranges import Range, declared_ranges
from quadpend_gym.physics.kernel import DIVERGENCE_LIMIT
from quadpend_gym.physics.state import STATE_FIELDS
from quadpend_gym.sensors import KINDS as SENSORS
from quadpend_gym.sensors import Channel, Noise
from quadpend_gym.vehicles import VEHICLES
from quadpend_gym.wind import KINDS as WINDS
from quadpend_gym.wrappers import ActuatorWrapper, SensorWrapper
from tests.helpers.envs import ENDLESS, draw_actions, make_unwrapped
from tests.helpers.random_settings import NEEDED, SIMULATION_PARTS, TASK_PARTS, extreme_env, value_of

STEPS = 60
EXPECTED = ".*(the wind pushes with up to|the trajectory (needs|reaches))"  # warnings about settings, not about steps
HUMMINGBIRD = VEHICLES["hummingbird"]


def lowest(bounds: Range) -> float:
    return bounds.low


def highest(bounds: Range) -> float:
    return bounds.high


def at_ends(kind: Any) -> Iterator[dict[str, Any]]:
    """Values with one field at one end of its range; an interval also from end to end."""
    for name, bounds in declared_ranges(kind).items():
        values = {value_of(kind, name, lowest), value_of(kind, name, highest)}
        if isinstance(next(iter(values)), tuple):
            values.add((bounds.low, bounds.high))
        yield from ({name: value} for value in sorted(values, key=str))


def assert_promises(env: Any, steps: int = STEPS, **options: Any) -> None:
    """Fly with random and with largest actions, and start a new episode after each that ends."""
    actions = draw_actions(0, steps)
    actions[steps // 2 :] = np.sign(actions[steps // 2 :])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=EXPECTED)
        observation, info = env.reset(seed=0, **options)
        for action in actions:
            assert env.observation_space.contains(observation)
            assert all(np.isfinite(value).all() for value in info.values() if isinstance(value, float | np.ndarray))
            begin = time.perf_counter()
            observation, reward, terminated, _, info = env.step(action)
            assert time.perf_counter() - begin < 1.0
            assert 0.0 <= reward <= 1.0
            if terminated:
                assert env.observation_space.contains(observation)
                observation, info = env.reset(**options)


def assert_promises_or_refused(build: Callable[[], Any]) -> None:
    """Fly in an environment unless its settings are refused with one sentence."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=EXPECTED)
        try:
            env, refusal = build(), ""
        except ValueError as error:
            env, refusal = None, str(error)
    assert "\n" not in refusal
    if env is not None:
        assert_promises(env)


SETTINGS = [
    *({"simulation": values} for values in at_ends(Simulation)),
    *({"simulation": {part: values}} for part, kind in SIMULATION_PARTS.items() for values in at_ends(kind)),
    *({"task": {part: values}} for part, kind in TASK_PARTS.items() for values in at_ends(kind)),
    *(
        {"wind": {"kind": name, **NEEDED.get(name, {}), **values}, "task": task}
        for name, kind in WINDS.items()
        for values in at_ends(kind)
        for task in ("track", ENDLESS)
    ),
]
VEHICLE_SETTINGS = [
    *(("", values) for values in at_ends(type(HUMMINGBIRD)) if "torque" not in values),
    *((part, values) for part in ("pole", "drag", "rate_loop") for values in at_ends(type(getattr(HUMMINGBIRD, part)))),
]
MODELS: list[tuple[Any, Any]] = [
    *(
        (SensorWrapper, Noise(**{name: values}))
        for name in STATE_FIELDS
        for values in at_ends(Channel)
        if any(values.values())
    ),
    *((SensorWrapper, kind(**values)) for kind in SENSORS.values() for values in at_ends(kind)),
    *((ActuatorWrapper, kind(**values)) for kind in ACTUATORS.values() for values in at_ends(kind)),
]


@pytest.mark.parametrize("arguments", SETTINGS, ids=str)
def test_every_setting_keeps_the_promises_at_the_ends_of_its_range(arguments: dict[str, Any]) -> None:
    assert_promises_or_refused(lambda: make_unwrapped(**arguments))


@pytest.mark.parametrize(("part", "values"), VEHICLE_SETTINGS, ids=str)
@pytest.mark.parametrize("interface", ["wrench", "rotors", "body_rates"])
def test_every_vehicle_keeps_the_promises_at_the_ends_of_its_ranges(
    part: str, values: dict[str, Any], interface: str
) -> None:
    def build() -> Any:
        changed = {part: replace(getattr(HUMMINGBIRD, part), **values)} if part else values
        return make_unwrapped(vehicle=replace(HUMMINGBIRD, **changed), interface=interface)

    assert_promises_or_refused(build)


@pytest.mark.parametrize(("wrapper", "model"), MODELS, ids=str)
def test_every_sensor_and_actuator_keeps_the_promises_at_the_ends_of_its_ranges(wrapper: Any, model: Any) -> None:
    def build() -> Any:
        vehicle = {"vehicle": "hummingbird", "interface": "body_rates"} if model.kind == "gyro_bias" else {}
        with_rotors = [model, ACTUATORS["rotors"]()] if model.kind == "rotor_fault" else model
        return wrapper(make_unwrapped(wind="windy", **vehicle), with_rotors)

    assert_promises_or_refused(build)


@pytest.mark.parametrize("end", [-1.0, 1.0])
@pytest.mark.parametrize("name", STATE_FIELDS)
@pytest.mark.parametrize("task", ["track", ENDLESS])
def test_every_start_keeps_the_promises(task: Any, name: str, end: float) -> None:
    values = np.full(3, end * 0.999 * DIVERGENCE_LIMIT)
    assert_promises(make_unwrapped(task=task, wind="windy"), options={"state": {name: values}})


@pytest.mark.parametrize("values", [*at_ends(Reference)], ids=str)
def test_every_reference_keeps_the_promises(values: dict[str, Any]) -> None:
    reference = replace(Reference.circle(1000.0, 1000.0), **values)
    assert_promises(make_unwrapped(task=ENDLESS), options={"reference": reference})


@settings(deadline=None, max_examples=300)
@given(seed=st.integers(0, 2**32))
def test_random_settings_keep_the_promises(seed: int) -> None:
    assert_promises_or_refused(lambda: extreme_env(np.random.default_rng(seed), make_unwrapped))
