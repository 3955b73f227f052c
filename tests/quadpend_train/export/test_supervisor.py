"""The supervisor in exported C: every status, every limit, the kill, engaging, set points, and any input."""

import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from shutil import which
from typing import Any

import numpy as np
import pytest

from quadpend_gym.core.arrays import Floats
from quadpend_gym.scenarios import Scenario, find_scenarios
from quadpend_train.export.to_c import export_c
from quadpend_train.links.supervised import FLY, HOLD, KILL, OFF, Supervised
from quadpend_train.policies.compiled import CPolicy, SupervisedPolicy, samples_of
from quadpend_train.policies.loading import load_policy
from tests.helpers.policies import mlp_policy

pytestmark = pytest.mark.skipif(which("cc") is None, reason="there is no C compiler")
FUZZ = Path(__file__).with_name("fuzz.c")
PERIOD = 0.01


def scenario(name: str, **parts: Any) -> Scenario:
    """A scenario with the observation of a lab."""
    return replace(find_scenarios([name])[name], observation="lab", **parts)


@pytest.fixture(scope="module")
def lqg(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A policy with an observer, which judges samples."""
    source = tmp_path_factory.mktemp("lqg") / "policy.c"
    export_c(load_policy("lqg"), "lqg", scenario("flight_breeze"), source)
    return source


@pytest.fixture(scope="module")
def network(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A policy without an observer, whose samples the supervisor judges."""
    source = tmp_path_factory.mktemp("network") / "policy.c"
    export_c(mlp_policy(27), "network", scenario("flight_breeze"), source)
    return source


@pytest.fixture(params=["lqg", "network"])
def source(request: pytest.FixtureRequest) -> Path:
    found: Path = request.getfixturevalue(request.param)
    return found


class Flight:
    """A supervised policy, called as firmware calls it, whose statuses have names."""

    def __init__(self, source: Path) -> None:
        self.flown = Supervised(source)
        self.bits, self.public = self.flown.bits, self.flown.fields

    @property
    def command(self) -> Floats:
        return self.flown.command

    def step(self, sample: Floats | None = None, reference: Floats | None = None, request: int = FLY) -> set[str]:
        """Step, and return the names of the status."""
        self.command[:] = np.nan
        status = self.flown.step(sample, request, reference)
        assert status == self.public.status
        return set(self.flown.names(status))

    def hover(self, steps: int, request: int = FLY) -> None:
        """Go on for some steps with ordinary samples, without a status."""
        for _ in range(steps):
            assert not self.step(self.sample(), request=request) - {"INNOVATION", "SATURATED"}

    def sample(self, **parts: Any) -> Floats:
        """A sample at rest at a height of 2 m that differs from the one before by little."""
        self.moved = getattr(self, "moved", 0.0) + 1e-5
        place = parts.get("position", (0.0, 0.0, 2.0)) + np.array([self.moved, 0.0, 0.0])
        rest = parts.get("quaternion", (1, 0, 0, 0)), parts.get("direction", (0, 0, 1)), [parts.get("age", 0.0)]
        return np.concatenate([place, *rest]).astype(float)

    def go_to(self, *position: float, yaw: float = 0.0) -> None:
        self.flown.go_to(np.array(position), yaw)

    @property
    def derivatives(self) -> Floats:
        """The reference, shape (7, 3)."""
        return np.array(self.public.reference[:21]).reshape(7, 3)

    def applies_nothing(self) -> bool:
        return bool((self.command == 0.0).all())


def tilted(angle: float) -> tuple[float, float, float]:
    """The direction of a pole that leans by an angle."""
    return float(np.sin(angle)), 0.0, float(np.cos(angle))


NO_SAMPLE: dict[str, Callable[[Flight], Floats | None]] = {
    "missing": lambda _: None,
    "old": lambda flight: flight.sample(age=0.05),
}
IMPOSSIBLE: dict[str, dict[str, Any]] = {
    "not a number": {"position": (0.0, np.nan, 2.0)},
    "infinite": {"direction": (0.0, -np.inf, 1.0)},
    "huge": {"position": (1e30, 0.0, 2.0)},
    "no quaternion": {"quaternion": (0, 0, 0, 0)},
    "long quaternion": {"quaternion": (1.2, 0, 0, 0)},
    "no direction": {"direction": (0, 0, 0)},
    "negative age": {"age": -0.01},
    "age that is not a number": {"age": np.nan},
}


@pytest.mark.parametrize("case", [*NO_SAMPLE, *IMPOSSIBLE])
def test_what_is_no_sample_has_a_status_at_once_and_kills_after_the_limit_of_age(source: Path, case: str) -> None:
    flight = Flight(source)
    flight.hover(30)
    make = NO_SAMPLE.get(case, lambda flight: flight.sample(**IMPOSSIBLE[case]))
    for k in range(1, 31):
        found = flight.step(make(flight))
        assert {"BLIND", *(["INVALID"] if case in IMPOSSIBLE else [])} <= found
        assert flight.public.blind == pytest.approx(max(k * PERIOD, (0.04 + k * PERIOD) * (case == "old")))
        if flight.public.blind < 0.299:
            assert "KILLED" not in found
    assert {"AGE", "KILLED"} <= flight.step(make(flight))
    assert flight.applies_nothing()
    assert flight.step(flight.sample()) == {"KILLED"}  # for ever
    assert flight.step(flight.sample(), request=OFF) == {"KILLED"}
    assert flight.applies_nothing()
    assert flight.public.cause & flight.bits["AGE"]


def test_frozen_samples_and_outliers_have_a_status_at_once_and_are_not_flown(source: Path) -> None:
    flight, other = Flight(source), Flight(source)
    for one in (flight, other):
        one.hover(30)
    sample = flight.sample()
    flight.step(sample)
    assert {"BLIND", "FROZEN"} <= flight.step(sample)
    flight.step(flight.sample())
    for part in ({"position": (5.0, 0.0, 2.0)}, {"direction": tilted(2.0)}, {"quaternion": (0, 1, 0, 0)}):
        flight.hover(5)
        before = flight.command.copy()
        assert {"BLIND", "OUTLIER"} <= flight.step(flight.sample(**part))
        assert "KILLED" not in flight.step(flight.sample())
        assert np.abs(flight.command - before).max() < 0.5
    flight.hover(5)
    for _ in range(5):
        assert "OUTLIER" in flight.step(flight.sample(position=(1.0, 0.0, 2.0)))
    found = flight.step(flight.sample(position=(1.0, 0.0, 2.0)))
    assert "RESTARTED" in found
    assert not {"BLIND", "OUTLIER", "KILLED"} & found


@pytest.mark.parametrize(
    ("name", "limit", "sample"),
    [
        ("POLE_TILT", "pole_tilt", {"direction": tilted(0.04)}),
        ("BODY_TILT", "body_tilt", {"quaternion": (np.cos(0.05), 0, np.sin(0.05), 0)}),
        ("DISTANCE", "distance", {"position": (0.0, 0.04, 2.0)}),
        ("HEIGHT", "lowest", {"position": (0.0, 0.0, 1.96)}),
        ("HEIGHT", "highest", {"position": (0.0, 0.0, 2.04)}),
        ("SPEED", "speed", {"position": (0.0, 0.04, 2.0)}),
    ],
)
@pytest.mark.parametrize("is_number", [True, False], ids=["number", "nan"])
def test_each_limit_kills_at_once_also_one_that_is_not_a_number(
    source: Path, name: str, limit: str, sample: Any, is_number: bool
) -> None:
    flight = Flight(source)
    flight.hover(20)
    value = {"lowest": 1.97, "highest": 2.03}.get(limit, 0.02)
    setattr(flight.public, limit, value if is_number else np.nan)
    if is_number and limit != "speed":
        flight.hover(2)
    assert {name, "KILLED"} <= flight.step(flight.sample(**sample))
    assert flight.applies_nothing()
    assert flight.public.stage == KILL


@pytest.mark.parametrize("request_", [KILL, -1, 4])
def test_the_pilot_kills_by_request_and_an_unknown_request_kills(lqg: Path, request_: int) -> None:
    flight = Flight(lqg)
    flight.hover(5)
    assert {"REQUEST", "KILLED"} <= flight.step(flight.sample(), request=request_)
    assert flight.applies_nothing()


def test_what_a_hand_does_before_a_flight_and_after_it_winds_nothing_up(lqg: Path) -> None:
    flight, fresh, plain, hover = (Flight(lqg) for _ in range(4))
    hover.step(hover.sample(), request=HOLD)
    for _ in range(300):
        sample = flight.sample(direction=tilted(0.05))
        assert flight.step(sample, request=HOLD) <= {"INNOVATION"}
        assert (flight.command == hover.command).all()
        plain.step(sample)
    sample = flight.sample()
    for one in (flight, fresh, plain):
        one.step(sample)
    assert (flight.command == fresh.command).all()
    assert np.abs(plain.command - fresh.command).max() > 0.1  # what has been wound up
    assert flight.derivatives[0] == pytest.approx(sample[:3])
    flight.hover(20)
    assert "KILLED" not in flight.step(flight.sample(direction=tilted(0.05)), request=HOLD)  # released
    assert (flight.command == hover.command).all()
    assert flight.step(flight.sample(), request=OFF) <= {"INNOVATION"}
    assert flight.applies_nothing()


def test_a_flight_begins_only_with_a_sample_and_within_the_limits(source: Path) -> None:
    flight = Flight(source)
    for sample in (None, flight.sample(quaternion=(0, 0, 0, 0)), flight.sample(direction=tilted(1.2))):
        assert "KILLED" not in flight.step(sample)
        assert flight.public.stage == OFF
        assert flight.applies_nothing()
    flight.step(flight.sample(direction=tilted(1.2)), request=HOLD)
    assert {"POLE_TILT", "CAUTION"} <= flight.step(flight.sample(direction=tilted(1.2)))
    assert flight.public.stage == HOLD


def follow(flight: Flight, steps: int) -> Floats:
    """Fly with samples on the reference, and return the references, shape (n, 26)."""
    found = []
    for _ in range(steps):
        assert "KILLED" not in flight.step(flight.sample(position=flight.derivatives[0]))
        found.append(np.array(flight.public.reference))
    return np.array(found)


def test_the_profile_to_set_points_keeps_speed_and_acceleration_and_has_six_derivatives(lqg: Path) -> None:
    flight, rng = Flight(lqg), np.random.default_rng(0)
    flight.public.age = flight.public.distance = np.inf
    flight.hover(1)
    goals, way = rng.uniform([-3.0, -3.0, 1.0, -9.0], [3.0, 3.0, 3.0, 9.0], (12, 4)), []
    for k, goal in enumerate(goals):
        flight.go_to(*goal[:3], yaw=goal[3])
        way.append(follow(flight, 1500 if k == len(goals) - 1 else int(rng.integers(20, 400))))
    x = np.concatenate(way)
    derivatives, yaw = x[:, :21].reshape(-1, 7, 3), x[:, 21:24]
    for k, most in enumerate(flight.public.set_point, 1):
        assert 0.9 * most < np.linalg.norm(derivatives[:, k], axis=1).max() <= most * (1.0 + 1e-9)
    for k, most in enumerate(flight.public.yaw, 1):
        assert 0.9 * most < np.abs(yaw[:, k]).max() <= most * (1.0 + 1e-9)
    for k in range(5):  # the trapezoidal rule with the correction of Euler and Maclaurin
        higher = derivatives[:, k + 1], derivatives[:, k + 2]
        change = 0.5 * PERIOD * (higher[0][1:] + higher[0][:-1]) - PERIOD**2 / 12.0 * np.diff(higher[1], axis=0)
        assert np.diff(derivatives[:, k], axis=0) == pytest.approx(change, abs=1e-6 * 6.0**k)
    assert derivatives[-1, 0] == pytest.approx(goals[-1, :3], abs=1e-3)
    assert np.sin(0.5 * (yaw[-1, 0] - goals[-1, 3])) == pytest.approx(0.0, abs=1e-3)
    assert np.abs(np.diff(yaw[:, 0])).max() < 0.006  # the short way round
    assert np.abs(derivatives[-1, 1:]).max() < 0.01


def test_a_profile_begins_at_any_reference_and_bad_set_points_are_refused(lqg: Path) -> None:
    flight = Flight(lqg)
    flight.public.age = flight.public.distance = np.inf
    given = np.zeros(26)
    given[:24] = [
        np.sin(0.5 * np.pi * k) * 0.5 if i == 0 else 2.0 * (i == 2 and k == 0) for k in range(8) for i in range(3)
    ]
    given[24:] = 0.5, 0.05
    flight.step(flight.sample(), given)
    flight.step(flight.sample(), given)
    expected = given[:21].reshape(7, 3)
    following = [
        sum(expected[k + i] * PERIOD**i / [1, 1, 2, 6, 24, 120, 720][i] for i in range(7 - k)) for k in range(3)
    ]
    flight.step(flight.sample())
    assert flight.derivatives[:3] == pytest.approx(np.array(following), abs=1e-6)
    for bad in ((np.nan, 0.0, 2.0), (0.0, np.inf, 2.0), (0.0, 0.0, -1.0), (0.0, 0.0, 99.0)):
        flight.go_to(*bad)
        assert "REFERENCE" in flight.step(flight.sample())
        assert "REFERENCE" not in flight.step(flight.sample())
    flight.go_to(0.0, 0.0, 2.0, yaw=np.nan)
    assert "REFERENCE" in flight.step(flight.sample())
    assert np.abs(follow(flight, 2000)[-1, :3] - [0.0, 0.0, 2.0]).max() < 2.0


@pytest.mark.parametrize(
    "change", [{0: 0.3}, {21: 0.8}, {3: 1.5}, {6: 1.5}, {22: 1.0}, {24: 0.9}, {5: np.nan}, {25: -1}]
)
def test_doubtful_references_have_a_status(lqg: Path, change: dict[int, float]) -> None:
    flight, given = Flight(lqg), np.zeros(26)
    given[2], given[24:] = 2.0, np.array(flight.public.reference)[24:]
    for _ in range(20):
        assert "REFERENCE" not in flight.step(flight.sample(), given)
    given[list(change)] = list(change.values())
    assert "REFERENCE" in flight.step(flight.sample(), given)


EVENTS = {  # what each event leads to, and within which time (s) of its beginning at 2 s, where that is known
    "event_jump": "REFERENCE",
    "event_yaw_jump": "REFERENCE",
    "event_dropouts": "BLIND",
    "event_frozen": "FROZEN",
    "event_outliers": "OUTLIER",
    "event_pole_force": "INNOVATION",
    "event_wind_step": "INNOVATION",
    "event_catch": "INNOVATION",
    "event_pole_told": "REFERENCE",
    "event_thrust": "INNOVATION",
    "event_turning": "REFERENCE",
    "event_start": "CAUTION",
}


def fly(policy: CPolicy, flown: Scenario, rows: int = 4) -> tuple[Floats, Any]:
    """Return actions and, of supervised policies, statuses; shapes (steps, rows, …)."""
    adapted, envs, memory, actions, statuses = policy.adapt(flown), flown.make_vec(rows), None, [], []
    observation, _ = envs.reset(seed=1)
    for k in range(round(flown.duration / PERIOD) - 1):
        action, memory = adapted.predict(observation, memory, np.full(rows, k == 0))
        observation, *_ = envs.step(action)
        actions.append(action)
        statuses.append(adapted.status(memory) if isinstance(adapted, SupervisedPolicy) else 0)
    return np.array(actions), np.array(statuses)


@pytest.mark.parametrize("event", EVENTS)
def test_events_have_a_status_and_a_supervised_flight_is_the_same_flight(lqg: Path, event: str) -> None:
    flown, supervised = scenario(event, duration=6.0), load_policy(f"supervised:{lqg}")
    assert isinstance(supervised, SupervisedPolicy)
    actions, statuses = fly(supervised, flown)
    assert ((statuses & supervised.statuses[EVENTS[event]]) > 0).any(axis=0).all()
    assert not (statuses & supervised.statuses["KILLED"]).any()
    assert (actions == fly(CPolicy(lqg), flown)[0]).all()


@pytest.mark.parametrize(
    ("event", "within", "parts"),
    [
        ("event_wind_step", 0.2, {"wind": {"kind": "step", "velocity": [3.0, 0.0, 0.0], "at": 2.0, "rise": 0.1}}),
        ("event_thrust", 0.12, {"loop": {"changes": {"at": [2.0, 2.0], "thrust": [0.8, 0.8]}}}),
    ],
)
def test_forces_and_lost_thrust_are_told_after_a_while(lqg: Path, event: str, within: float, parts: Any) -> None:
    policy = SupervisedPolicy(lqg)
    _, statuses = fly(policy, scenario(event, duration=3.0, **parts), rows=8)
    told = (statuses & policy.statuses["INNOVATION"]) > 0
    assert not told[60:200].any()
    assert told[200 : 200 + round(within / PERIOD)].any(axis=0).all()


def test_a_flight_engages_held_catches_the_pole_flies_to_set_points_and_is_released(lqg: Path) -> None:
    flown, flight, errors = scenario("event_catch", duration=12.0), Flight(lqg), []
    envs, scale, goals = flown.make_vec(1), flown.simulation.command_scale, {5.0: (0.5, 0.0, 2.0), 8.0: (0.0, 0.5, 2.3)}
    observation, _ = envs.reset(seed=0)
    for k in range(1199):  # the hand holds the pole for 3 s
        if k * PERIOD in goals:
            flight.go_to(*goals[k * PERIOD], yaw=0.5)
        sample = samples_of(observation)[0, :11]
        assert not flight.step(sample, request=HOLD if k < 50 else FLY) & {"KILLED", "BLIND", "REFERENCE"}
        action = flight.command / scale - [1.0, 0.0, 0.0, 0.0]
        observation, _, fallen, _, _ = envs.step(np.clip(action, -1.0, 1.0)[np.newaxis].astype(np.float32))
        assert not fallen
        lever = flight.public.reference[24] * np.append(sample[7:9], 0.0)
        errors.append(np.linalg.norm(sample[:3] + lever - flight.derivatives[0]))
    assert np.sqrt(np.mean(np.square(errors[500:]))) < 0.01
    assert flight.derivatives[0] == pytest.approx(goals[8.0], abs=0.01)
    flight.step(sample, request=HOLD)
    assert flight.command.tolist() == pytest.approx([scale[0], 0.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("flags", "steps"), [(("-O2",), 1_000_000), (("-O1", "-fsanitize=address,undefined"), 50_000)], ids=["fast", "sane"]
)
def test_no_input_breaks_a_promise(lqg: Path, flags: tuple[str, ...], steps: int, tmp_path: Path) -> None:
    program = tmp_path / "fuzz"
    command = [
        "cc",
        "-std=c99",
        *flags,
        "-Wall",
        "-Wextra",
        "-Werror",
        "-I",
        lqg.parent,
        FUZZ,
        lqg,
        "-lm",
        "-o",
        program,
    ]
    subprocess.run(command, check=True)
    done = subprocess.run([program, str(steps)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
