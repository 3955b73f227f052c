"""No setting without effect: each of them, alone, changes what happens."""

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quadpend_gym import (
    Actuators,
    Constant,
    Drawn,
    Dryden,
    Gusts,
    Limits,
    OrnsteinUhlenbeck,
    PaperGusts,
    Parameters,
    Reference,
    ReferenceSettings,
    RewardWeights,
    Simulation,
    Sinusoid,
    StartSettings,
    Task,
    VonKarman,
)
from tests.helpers.envs import AT_REST, draw_actions, make_unwrapped, make_vec, run_actions

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
}
STARTS = {field.name: 0.2 for field in fields(StartSettings)}
LIMITS = {"pendulum_angle": 0.1, "body_angle": 0.1, "tracking_error": 0.1, "ground": 2.4}
WEIGHTS = {field.name: 1.0 for field in fields(RewardWeights)}
PARAMETERS = {field.name: 1.5 * getattr(Parameters(), field.name) for field in fields(Parameters)}
ACTUATORS = {field.name: 0.5 * getattr(Actuators(), field.name) for field in fields(Actuators)}
MOVING_AIR = Constant(velocity=(3.0, 2.0, 1.0))  # the drag areas count in no other
LOADS = {"force": 0.5, "bob_force": 0.5, "torque": 0.5, "velocity": 5.0}
GUST = Gusts(velocity=(5.0, 0.0, 0.0), pause=(0.0, 0.1), length=(0.1, 0.2))
GUSTS = {"pause": (0.1, 0.1), "length": (0.2, 0.3), "heading": (0.0, 1.0)}
DRAWN = {"wind": "windy", "strength": (0.5, 2.0), "heading": (0.0, 1.0)}
TURBULENCE = {"intensity": "severe", "altitude": 100.0, "mean_wind": 9.0, "heading": 1.0}
# But for the torque, which gusts have not, and the standard, which is another name for the same turbulence.
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
COUNTLESS = {Gusts: {"torque"}, Dryden: {"standard"}, VonKarman: {"standard"}}


def happenings(**kwargs: Any) -> bytes:
    """All that 40 rows return in 30 steps."""
    env = make_vec(40, **kwargs)
    first, _ = env.reset(seed=0)
    returned = run_actions(env, draw_actions(0, 30, 40))
    return first.tobytes() + b"".join(part.tobytes() for step in returned for part in step[:4])


@pytest.fixture(scope="module")
def usual() -> bytes:
    """What happens with the default settings."""
    return happenings()


@pytest.mark.parametrize(
    ("part", "kind", "name", "value"),
    [("references", ReferenceSettings, name, value) for name, value in REFERENCES.items()]
    + [("start", StartSettings, name, value) for name, value in STARTS.items()]
    + [("limits", Limits, name, value) for name, value in LIMITS.items()]
    + [("reward", RewardWeights, name, value) for name, value in WEIGHTS.items()],
)
def test_every_setting_of_a_task_counts(usual: bytes, part: str, kind: Any, name: str, value: Any) -> None:
    assert happenings(task=Task(**{part: kind(**{name: value})})) != usual


@pytest.mark.parametrize(("name", "value"), PARAMETERS.items())
def test_every_physical_parameter_counts(usual: bytes, name: str, value: float) -> None:
    simulation = Simulation(Parameters(**{name: value}))
    counts_in_the_calm = happenings(simulation=simulation) != usual
    assert counts_in_the_calm != name.endswith("drag_area")
    assert happenings(simulation=simulation, wind=MOVING_AIR) != happenings(wind=MOVING_AIR)


@pytest.mark.parametrize(("name", "value"), ACTUATORS.items())
def test_every_actuator_limit_counts(usual: bytes, name: str, value: float) -> None:
    assert happenings(simulation=Simulation(actuators=Actuators(**{name: value}))) != usual


@pytest.mark.parametrize(
    ("model", "name", "value"), [(model, name, value) for model, changes in WINDS for name, value in changes.items()]
)
def test_every_setting_of_a_wind_counts(model: Any, name: str, value: Any) -> None:
    assert happenings(wind=replace(model, **{name: value})) != happenings(wind=model)


@pytest.mark.parametrize(
    ("table", "kind"),
    [
        (REFERENCES, ReferenceSettings),
        (STARTS, StartSettings),
        (LIMITS, Limits),
        (WEIGHTS, RewardWeights),
        (PARAMETERS, Parameters),
        (ACTUATORS, Actuators),
        *((changes, type(model)) for model, changes in WINDS),
    ],
)
def test_the_tables_above_are_complete(table: dict[str, Any], kind: Any) -> None:
    assert table.keys() == {field.name for field in fields(kind) if field.init} - COUNTLESS.get(kind, set())


def test_the_period_is_how_long_an_action_is_held() -> None:
    for period in (0.005, 0.01, 0.02):
        env = make_unwrapped(simulation={"period": period})
        env.reset(seed=0, options={"state": AT_REST})
        env.step((1.0, 0.0, 0.0, 0.0))
        assert_allclose(env.state.velocity[2], 9.8 * period, rtol=1e-12)


def test_references_run_in_seconds_whatever_the_period() -> None:
    circle = Reference.circle(1.0, 2.0)
    for period, steps in ((0.005, 40), (0.02, 10)):
        env = make_unwrapped(simulation={"period": period})
        env.reset(seed=0, options={"reference": circle})
        info = run_actions(env, np.zeros((steps, 4)))[-1][4]
        bob = env.state.position + 0.3 * env.state.direction
        assert_allclose(info["tracking_error"][:2], (bob - circle.derivatives(0.2)[0, :3])[:2], atol=1e-12)


def test_more_substeps_converge() -> None:
    """The error falls by 2⁴ = 16 each time, as that of RK4 should."""
    ends = {}
    for substeps in (1, 2, 4, 32):
        env = make_unwrapped(simulation={"substeps": substeps})
        env.reset(seed=0, options={"state": {"direction_rate": (5.0, 5.0, 0.0)}})
        run_actions(env, draw_actions(0, 10))
        ends[substeps] = env.state.array.copy()
    errors = [np.abs(ends[substeps] - ends[32]).max() for substeps in (1, 2, 4)]
    assert 10.0 < errors[0] / errors[1] < 25.0
    assert 10.0 < errors[1] / errors[2] < 25.0


def test_reward_weights_are_relative() -> None:
    def reward(**weights: float) -> Any:
        env = make_unwrapped(task={"reward": weights})
        env.reset(seed=0)
        return env.step(np.full(4, 0.1))[1]

    assert_allclose(
        reward(tracking=2.0, upright=1.0, yaw=1.0, effort=0.0),
        (2.0 * reward(upright=0, yaw=0, effort=0) + reward(tracking=0, yaw=0, effort=0)
         + reward(tracking=0, upright=0, effort=0)) / 4.0,
        rtol=1e-12,
    )  # fmt: skip
