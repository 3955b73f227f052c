"""Margins of the linear loop, compared with textbook values and with a search in time."""

import re
from dataclasses import replace

import control
import numpy as np
import pytest

from quadpend_baselines import controller
from quadpend_baselines.gains import tuning
from quadpend_baselines.modelling.linear_loop import close_loop, linear_policy, margins, vehicle_model
from quadpend_baselines.registry import controller_of
from quadpend_gym import Reference
from quadpend_gym.scenarios import Scenario
from quadpend_gym.tasks.observation import OBSERVATION_FIELDS
from quadpend_gym.tasks.task import Task
from quadpend_train.evaluation.linear_models import loop_margins
from quadpend_train.policies.conversion import as_policy
from tests.helpers.envs import AT_REST, NO_LIMITS
from tests.helpers.sources import ROOT


def test_margins_of_a_double_integrator() -> None:
    """L = (1 + √2 s)/s² has a phase margin of 65.5° and a delay margin of 0.736 s."""
    period = 1e-3
    vehicle = control.ss([[1.0, period], [0.0, 1.0]], [[period**2 / 2.0], [period]], np.eye(2), 0.0, period)
    found = margins(vehicle, control.ss([], [], [], [[-1.0, -np.sqrt(2.0)]], period))
    assert np.rad2deg(found.phase) == pytest.approx(65.5, abs=0.1)
    assert found.delay == pytest.approx(0.736, abs=1e-3)
    assert found.gain == (0.0, np.inf)


def test_delay_margin_is_that_of_a_search_in_time() -> None:
    """A start 1 mm off decays with half a millisecond, a substep, less than the margin, and grows with as much more."""
    scenario = Scenario(task=Task(limits=NO_LIMITS), vehicle="hummingbird", substeps=20, duration=60.0)
    policy = controller_of("lqi", tuning("lqi", "rigid").gains, scenario.simulation).adapt(scenario)
    substep = scenario.period / scenario.simulation.substeps
    margin = margins(vehicle_model(scenario), linear_policy(policy, scenario)).delay
    growth = []
    for substeps in (int(margin / substep), int(margin / substep) + 1):
        env = replace(scenario, latency=substeps * substep).make_vec(1)
        start = {**AT_REST, "position": (1e-3, 0.0, 2.0)}
        observation, _ = env.reset(seed=0, options={"state": start, "reference": Reference.hover()})
        memory, errors = None, []
        for step in range(scenario.steps - 1):
            action, memory = policy.predict(observation, memory, np.array([step == 0]))
            observation, *_, info = env.step(action)
            errors.append(np.linalg.norm(info["tracking_error"][0]))
        third = len(errors) // 3
        growth.append(max(errors[-third:]) / max(errors[third : 2 * third]))
    assert growth[0] < 0.5
    assert growth[1] > 1.5


def test_gain_margin_and_sensitivity_of_two_integrators() -> None:
    """L = k T/(z − 1) is stable for 0 < k T < 2, and |1 + L| is smallest at z = −1, where it is 1 − k T/2."""
    period, gains = 0.01, np.diag([40.0, 20.0])
    vehicle = control.ss(np.eye(2), period * np.eye(2), np.eye(2), 0.0, period)
    found = margins(vehicle, control.ss([], [], [], -gains, period))
    assert found.spectral_radius == pytest.approx(0.8)
    assert found.gain == pytest.approx((0.0, 5.0), abs=1e-5)
    assert found.sensitivity == pytest.approx(1.25)


class Proportional:
    """A policy of a user: the torques follow the measured pole; a constant thrust of `offset`."""

    def __init__(self, offset: float) -> None:
        self.offset = offset

    def predict(self, observation, state=None, episode_start=None, deterministic=True):  # type: ignore[no-untyped-def]
        action = np.zeros((len(observation), 4), np.float32)
        action[:, 0], action[:, 2] = self.offset, observation[:, OBSERVATION_FIELDS["direction"].start]
        return action, None


def test_a_policy_of_a_user_has_a_linear_model_if_it_stays_at_hover() -> None:
    scenario = Scenario()
    model = linear_policy(Proportional(0.0), scenario)
    assert (model.D != 0.0).sum() == 1
    assert linear_policy(as_policy(Proportional(0.1)).adapt(scenario), scenario) is None


def test_a_slower_sensor_has_no_linear_model() -> None:
    slow = Scenario(sensors=[{"kind": "sample_hold", "period": 0.03}])
    with pytest.raises(ValueError, match="slower than the control loop"):
        vehicle_model(slow)
    assert loop_margins({"lqr": [controller("lqr")]}, {"slow": slow}) == {}


def test_names_delays_and_outputs_of_the_model() -> None:
    late = {"latency": 0.015, "sensors": [{"kind": "delay", "steps": 2}], "observation": "output_feedback"}
    vehicle = vehicle_model(Scenario(vehicle="hummingbird", interface="body_rates", **late))
    assert vehicle.nstates == 16 + 4 + 2 * 4 + 2 * 8
    assert {"rotor_thrust[3]", "latency_2[0]", "sensor_delay_2_pendulum[1]"} < set(vehicle.state_labels)
    assert vehicle.output_labels[:4] == ["tracking_error[0]", "tracking_error[1]", "tracking_error[2]", "position[0]"]
    assert {"force[0]", "air_velocity[2]", "noise_attitude[1]", "action[3]"} < set(vehicle.input_labels)


def test_closed_loop_of_lqi_leaves_no_error_in_steady_wind() -> None:
    scenario = Scenario()
    policy = linear_policy(controller("lqi").adapt(scenario), scenario)
    closed = close_loop(vehicle_model(scenario), policy)
    force = closed.dcgain()[:, :3]
    assert np.abs(force).max() < 1e-4


def test_predictive_control_has_no_linear_model_and_an_unstable_loop_is_warned_about(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scenario = Scenario()
    assert linear_policy(controller("nmpc").adapt(scenario), scenario) is None
    lqi = controller("lqi").adapt(scenario)
    late = replace(scenario, latency=0.03, loop_known=False)
    monkeypatch.setattr(lqi, "adapt", lambda scenario: lqi)
    with pytest.warns(UserWarning, match="lqi is unstable on paper"):
        found = loop_margins({"lqi": [lqi]}, {"calm": scenario, "late": late})
    assert found["calm", "lqi"].delay > 0.02
    assert found["late", "lqi"].delay == 0.0


@pytest.mark.parametrize(("column", "vehicle"), [(0, "paper"), (1, "hummingbird")])
def test_the_page_has_the_margins_of_the_controllers(column: int, vehicle: str) -> None:
    page, scenario = (ROOT / "docs/linear-model.md").read_text(encoding="utf-8"), Scenario(vehicle=vehicle)
    rows = re.findall(r"^\| `([\w-]+)` \| ([\d.]+) ms, (\d+)° \| ([\d.]+) ms, (\d+)° \|$", page, re.MULTILINE)
    assert len(rows) == 5
    for name, *numbers in rows:
        found = margins(vehicle_model(scenario), linear_policy(controller(name).adapt(scenario), scenario))
        delay, phase = map(float, numbers[2 * column : 2 * column + 2])
        assert 1e3 * found.delay == pytest.approx(delay, abs=0.06)
        assert np.rad2deg(found.phase) == pytest.approx(phase, abs=0.51)
