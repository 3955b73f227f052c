"""Every setting of the environments has an effect: a change of one setting alone changes the results."""

from dataclasses import fields, replace
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
    VonKarman,
)
from quadpend_gym.vehicles import VEHICLES, Drag
from tests.helpers.envs import draw_actions, make_vec, run_actions

REFERENCES = {
    "hover": 5.0,
    "circle": 0.0,
    "figure_eight": 0.0,
    "helix": 0.0,
    "height": (1.0, 2.0),
    "radius": (2.0, 3.0),
    "acceleration": (1.0, 2.0),
    "climb": (0.2, 0.3),
    "yaw_offset": 1.0,
    "yaw_amplitude": 0.0,
    "yaw_frequency": 3.0,
    "slalom": 5.0,
}
STARTS = {field.name: 0.2 for field in fields(StartSettings)} | {"pendulum_angle": (0.2, 0.3)}
LIMITS = {"pendulum_angle": 0.1, "body_angle": 0.1, "tracking_error": 0.1, "ground": 2.4}
WEIGHTS = {field.name: 1.0 for field in fields(RewardWeights)}
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
LOADS = {"force": 0.5, "bob_force": 0.5, "torque": 0.5, "velocity": 5.0}
GUST = Gusts(velocity=(5.0, 0.0, 0.0), pause=(0.0, 0.1), length=(0.1, 0.2))
GUSTS = {"pause": (0.1, 0.1), "length": (0.2, 0.3), "heading": (0.0, 1.0)}
DRAWN = {"wind": "windy", "strength": (0.5, 2.0), "heading": (0.0, 1.0)}
TURBULENCE = {"intensity": "severe", "altitude": 100.0, "mean_wind": 9.0, "heading": 1.0}
# All settings but the speed of slaloms, which are not drawn by default, the torque of gusts, which is always zero, and
# the standard, which names the same turbulence twice.
WINDS = [
    (Constant(), LOADS),
    (Sinusoid(force=0.1), {**LOADS, "frequency": 5.0}),
    (OrnsteinUhlenbeck(), {**LOADS, "time_constant": 0.1}),
    (PaperGusts(onset=0.1), {"force": 0.5, "yaw_torque": 0.5, "onset": 0.2, "hold": 0.1}),
    (GUST, {**{name: LOADS[name] for name in LOADS if name != "torque"}, **GUSTS}),
    (Drawn(MOVING_AIR), DRAWN),
    (Dryden(), TURBULENCE),
    (VonKarman(), TURBULENCE),
]
WITHOUT_EFFECT = {ReferenceSettings: {"speed"}, Gusts: {"torque"}, Dryden: {"standard"}, VonKarman: {"standard"}}


def run(**kwargs: Any) -> bytes:
    """Everything that 40 sub-environments return in 30 steps."""
    env = make_vec(40, **kwargs)
    first, _ = env.reset(seed=0)
    results = run_actions(env, draw_actions(0, 30, 40))
    return first.tobytes() + b"".join(part.tobytes() for result in results for part in result[:4])


@pytest.fixture(scope="module")
def default() -> bytes:
    """Everything that the default settings return."""
    return run()


@pytest.mark.parametrize(
    ("part", "kind", "name", "value"),
    [("references", ReferenceSettings, name, value) for name, value in REFERENCES.items()]
    + [("start", StartSettings, name, value) for name, value in STARTS.items()]
    + [("limits", Limits, name, value) for name, value in LIMITS.items()]
    + [("reward", RewardWeights, name, value) for name, value in WEIGHTS.items()],
)
def test_every_setting_of_a_task_has_an_effect(default: bytes, part: str, kind: Any, name: str, value: Any) -> None:
    assert run(task=Task(**{part: kind(**{name: value})})) != default


@pytest.mark.parametrize(("name", "value"), VEHICLE.items())
def test_every_number_of_the_vehicle_has_an_effect(default: bytes, name: str, value: Any) -> None:
    assert run(vehicle=replace(PAPER, **{name.split()[0]: value})) != default


@pytest.mark.parametrize(("name", "value"), DRAG.items())
def test_drag_has_an_effect_in_moving_air_only(default: bytes, name: str, value: Any) -> None:
    vehicle = replace(PAPER, **{name: value})
    assert run(vehicle=vehicle) == default
    assert run(vehicle=vehicle, wind=MOVING_AIR) != run(wind=MOVING_AIR)


@pytest.mark.parametrize(
    ("model", "name", "value"), [(model, name, value) for model, changes in WINDS for name, value in changes.items()]
)
def test_every_setting_of_a_wind_has_an_effect(model: Any, name: str, value: Any) -> None:
    assert run(wind=replace(model, **{name: value})) != run(wind=model)


@pytest.mark.parametrize(
    ("table", "kind"),
    [
        (REFERENCES, ReferenceSettings),
        (STARTS, StartSettings),
        (LIMITS, Limits),
        (WEIGHTS, RewardWeights),
        *((changes, type(model)) for model, changes in WINDS),
    ],
)
def test_tables_of_settings_are_complete(table: dict[str, Any], kind: Any) -> None:
    assert table.keys() == {field.name for field in fields(kind) if field.name != "kind"} - WITHOUT_EFFECT.get(
        kind, set()
    )
