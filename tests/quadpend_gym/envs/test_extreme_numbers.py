"""Numbers of absurd size are refused at once with one sentence, where they once led to hangs, nan or overflows."""

from dataclasses import replace
from functools import reduce
from typing import Any

import numpy as np
import pytest

from quadpend_gym import (
    Constant,
    Drawn,
    Dryden,
    Gusts,
    OrnsteinUhlenbeck,
    PaperGusts,
    Parameters,
    Reference,
    ReferenceSettings,
    RewardWeights,
    Simulation,
    StartSettings,
)
from quadpend_gym.actuators import GyroBias, MotorLag, RotorFault
from quadpend_gym.core.models import MOST_NESTED, Stateless
from quadpend_gym.physics.state import State
from quadpend_gym.sensors import Channel, SampleHold
from quadpend_gym.vehicles import VEHICLES, Drag
from quadpend_gym.wind import Rescaled
from quadpend_gym.wind.base import WIND_FIELDS
from tests.helpers.bad_input import assert_refused
from tests.helpers.envs import ENDLESS, draw_actions, make, make_unwrapped, run_actions

HUGE, TINY = 1e300, 1e-300


def nested(depth: int) -> Any:
    """A drawn wind within a drawn wind, and so on, as plain data."""
    wind: Any = {"kind": "constant"}
    for _ in range(depth):
        wind = {"kind": "drawn", "wind": wind}
    return wind


def rescaled(*scales: float) -> Any:
    """A wind within rescaled winds, the first scale innermost."""
    return reduce(Rescaled, scales, Constant(force=1.0))


def dragging(**drag: float) -> Any:
    """A vehicle with this drag, the same about or along all axes."""
    return replace(VEHICLES["hummingbird"], drag=Drag(**{name: (value,) * 3 for name, value in drag.items()}))


CASES: dict[str, tuple[Any, str]] = {
    "substeps of a silent hang": (lambda: Simulation(substeps=10**9), "substeps must be .* from 1 to 10000, not 10000"),
    "substeps beyond int64": (lambda: Simulation(substeps=10**30), "substeps must be .* not about 1e30"),
    "gusts with a long period": (
        lambda: make(wind="gusts", simulation={"period": 1e4}),
        "period must be .* s, not 10000",
    ),
    "long latency": (
        lambda: make(vehicle="hummingbird", simulation={"period": 1e-6, "latency": 0.01}),
        "latency must be at most 1000 control periods of 1e-06 s, not 0.01 s",
    ),
    "weak gravity": (lambda: Parameters(gravity=1e-308), "gravity must be .* m/s², not 1e-308"),
    "long rod": (lambda: Parameters(rod_length=HUGE), "rod_length must be .* m, not 1e.300"),
    "small circle": (
        lambda: ReferenceSettings(radius=(1e-10, 1.0), acceleration=(0.0, 1e10)),
        "radius must be .* not 1e-10",
    ),
    "strong acceleration": (lambda: ReferenceSettings(acceleration=(0.0, 1e10)), "acceleration must be .* not 1"),
    "large reference": (lambda: Reference(amplitude=HUGE), "amplitude must be .* not 1e.300"),
    "far start": (lambda: StartSettings(position=HUGE), "position must be .* m, not 1e.300"),
    "large angle": (lambda: StartSettings(angle=HUGE), "angle must be .* rad, not 1e.300"),
    "fast start": (lambda: StartSettings(angle_rate=HUGE), "angle_rate must be .* rad/s, not 1e.300"),
    "large yaw": (lambda: ReferenceSettings(yaw_offset=HUGE), "yaw_offset must be .* rad, not 1e.300"),
    "fast yaw": (lambda: ReferenceSettings(yaw_frequency=HUGE), "yaw_frequency must be .* rad/s, not 1e.300"),
    "fast wind": (lambda: Constant(velocity=(0.0, 1e200, 0.0)), "velocity must be .* m/s, not 1e.200"),
    "strong wind": (lambda: Constant(force=HUGE), "force must be .* N, not 1e.300"),
    "heavy weights": (lambda: RewardWeights(tracking=1e308, yaw=1e308), "tracking must be .* not 1e.308"),
    "fine quantum": (lambda: Channel(quantum=5e-324), "quantum must be 0 or at least 1e-12, not 5e-324"),
    "sample hold": (lambda: SampleHold(TINY), "period must be .* s, not 1e-300"),
    "slow turbulence": (lambda: Dryden(mean_wind=TINY), "mean_wind must be .* m/s, not 1e-300"),
    "strong turbulence": (lambda: Dryden(intensity=HUGE), "intensity must be .* m/s, not 1e.300"),
    "heading of turbulence": (lambda: Dryden(heading=HUGE), "heading must be .* rad, not 1e.300"),
    "short noise": (lambda: OrnsteinUhlenbeck(time_constant=TINY), "time_constant must be .* s, not 1e-300"),
    "long noise": (lambda: OrnsteinUhlenbeck(time_constant=HUGE), "time_constant must be .* s, not 1e.300"),
    "short hold": (lambda: PaperGusts(hold=TINY), "hold must be .* s, not 1e-300"),
    "late gusts": (lambda: PaperGusts(onset=HUGE), "onset must be .* s, not 1e.300"),
    "long pause": (lambda: Gusts(pause=(0.0, HUGE)), "pause must be .* s, not 1e.300"),
    "heading of gusts": (lambda: Gusts(heading=(-HUGE, HUGE)), "heading must be .* rad, not -1e.300"),
    "drawn strength": (lambda: Drawn("windy", strength=(0.0, HUGE)), "strength must be .* not 1e.300"),
    "slow motor": (lambda: MotorLag(HUGE), "time_constant must be .* s, not 1e.300"),
    "gyro": (lambda: GyroBias(HUGE), "deviation must be .* rad/s, not 1e.300"),
    "late fault": (lambda: RotorFault(onset=HUGE), "onset must be .* s, not 1e.300"),
    "nested winds": (lambda: make(wind=nested(500)), f"wind must .* at most {MOST_NESTED} deep"),
    "rescaled winds": (lambda: rescaled(1e4, 1e4), r"scale and .* multiply to at most 1e\+06, not 1e\+08"),
    "rescaled torques": (
        lambda: Rescaled(rescaled(1e4), torque_scale=(1.0, 1e4, 1.0)),
        "torque_scale and .* multiply to at most",
    ),
    "drawn rescaled winds": (
        lambda: Drawn(rescaled(1e4), strength=(-1000.0, 1.0)),
        r"strength and .* multiply to at most 1e\+06, not 1e\+07",
    ),
    "drag of the body rates": (
        lambda: Simulation(vehicle=dragging(angular=2.0)),
        r"substeps must be at least 7, not 2: drag.angular = \(2.0, 2.0, 2.0\) slows the vehicle within 0.0016 s",
    ),
    "drag of the rotors": (
        lambda: Simulation(vehicle=dragging(rotor=80.0), period=0.1),
        "substeps must be at least 32, not 2: drag.rotor = .* a substep may last at most 0.5 times as long",
    ),
    "drag in a long period": (
        lambda: Simulation(vehicle=dragging(angular=90.0), period=10.0),
        "period must be at most 0.35 s with 10000 substeps, not 10 s: drag.angular = ",
    ),
    "nested lists of winds": (
        lambda: make(wind=reduce(lambda wind, _: [wind], range(2000), "calm")),
        "wind must .* deep",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_an_absurd_number_is_refused_with_one_sentence(case: str) -> None:
    call, message = CASES[case]
    assert_refused(call, message, ValueError)


def test_the_longest_period_with_drag_is_the_one_that_the_sentence_says() -> None:
    Simulation(vehicle=dragging(angular=90.0), period=0.35, substeps=10_000)


def test_winds_may_be_nested_as_deep_as_the_sentence_says() -> None:
    env = make_unwrapped(wind=nested(MOST_NESTED))
    env.reset(seed=0)
    run_actions(env, draw_actions(0, 5))


@pytest.mark.parametrize(("name", "slowed", "size"), [("rotor", "velocity", 0.25), ("angular", "euler_rate", 0.0032)])
def test_the_strongest_permitted_drag_slows_the_body(name: str, slowed: str, size: float) -> None:
    substep = 0.5 * Simulation().period
    env = make_unwrapped(vehicle=dragging(**{name: size / substep}), task=ENDLESS)
    env.reset(seed=0, options={"state": {slowed: (3.0, 3.0, 3.0)}})
    run_actions(env, np.zeros((20, 4)))
    assert np.abs(getattr(State(env.world.state), slowed)).max() < 0.5


def test_winds_within_winds_may_shrink_and_grow() -> None:
    assert rescaled(1e4, 1e-4, 1e4).scale == 1e4


@pytest.mark.parametrize("name", ["position", "velocity", "euler", "euler_rate", "direction", "direction_rate"])
def test_an_absurd_start_is_refused(name: str) -> None:
    options = {"state": {name: (0.0, 0.0, HUGE)}}
    assert_refused(lambda: make_unwrapped().reset(options=options), f"'{name}'.* between ±1e.06, not", ValueError)


def test_a_direction_that_cannot_be_normalised_is_refused() -> None:
    options = {"state": {"direction": (0.0, 0.0, 1e-160)}}
    assert_refused(lambda: make_unwrapped().reset(options=options), "'direction'.* shorter than 1e-09", ValueError)


class Storm(Stateless):
    """A wind of one's own with the velocity of a bad unit."""

    moves_air = True

    def sample(self, out: Any, *_: Any) -> None:
        out[:, WIND_FIELDS["velocity"]] = 1e200


def test_an_absurd_wind_of_the_users_own_model_ends_in_one_sentence() -> None:
    env = make_unwrapped(wind=Storm())
    env.reset(seed=0)
    assert_refused(
        lambda: env.step(np.zeros(4)), r"wind must be at most 1e\+20 N, N·m and m/s, not .*1e\+200", ValueError
    )
