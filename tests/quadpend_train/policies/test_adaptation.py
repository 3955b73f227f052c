"""What a policy is given by a scenario."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadpend_baselines import Policy, controller
from quadpend_baselines.estimation.feeding import fed_by_name
from quadpend_baselines.estimation.loop import Loop
from quadpend_gym.actuators import ActionDelay, MotorLag
from quadpend_gym.scenarios import Scenario
from quadpend_gym.sensors import Delay, Noise
from quadpend_gym.tasks.observation import FULL, OUTPUT_FEEDBACK, ObservationLayout
from quadpend_train.policies.loading import check_policy
from quadpend_train.policies.mlp_policy import MlpPolicy
from tests.helpers.bad_input import assert_refused
from tests.helpers.policies import ESTIMATE_ONLY, mlp_policy

DELAYED = Scenario(sensors=[Noise(position=0.001), Delay(1)], actuators=[ActionDelay(2), MotorLag(0.02)])
LOOP = Loop(delay=2, lags=(0.02,), sensor_delay=1, noise=(0.001, 0.0, 0.0))
BODY_RATES = Scenario(vehicle="hummingbird", interface="body_rates")


def test_controllers_and_base_controllers_are_designed_for_the_scenario_and_its_known_loop() -> None:
    slow = replace(DELAYED, period=0.02)
    flown: Any = controller("flatness").adapt(slow)
    assert (flown.loop, flown.simulation) == (LOOP, slow.simulation)
    unknown: Any = controller("flatness").adapt(replace(slow, loop_known=False))
    assert unknown.loop == Loop()
    learned: Any = mlp_policy(45, hybrid=ESTIMATE_ONLY).adapt(slow)
    assert (learned.hybrid.controller.loop, learned.hybrid.controller.simulation) == (LOOP, slow.simulation)


class Sum(Policy):
    """A policy that reads two fields."""

    layouts = (ObservationLayout(("attitude", "tracking_error")),)

    def predict(self, observation: Any, *_: Any, **__: Any) -> tuple[Any, Any]:
        return observation[:, :4], None


def test_policies_get_their_fields_by_name() -> None:
    whole = Scenario().make_vec(3).reset(seed=0)[0]
    for fields in (["tracking_error", "yaw_reference", "attitude"], ["attitude", "tracking_error"]):
        scenario = Scenario(observation=fields)  # type: ignore[arg-type]
        seen = scenario.make_vec(3).reset(seed=0)[0]
        for given, flown in ((seen, fed_by_name(Sum(), scenario)), (whole, fed_by_name(Sum(), Scenario()))):
            np.testing.assert_array_equal(flown.predict(given)[0], whole[:, [12, 13, 14, 0]])


def test_a_network_is_refused_where_a_field_is_not_observed(tmp_path: Path) -> None:
    few = Scenario(observation=["direction", "tracking_error"])  # type: ignore[arg-type]
    network = mlp_policy(6, observation=["attitude", "tracking_error"])
    network.save(tmp_path / "few.npz")
    for policy in (network, MlpPolicy.load(tmp_path / "few.npz")):
        assert_refused(lambda policy=policy: policy.adapt(few), "reads attitude, which the scenario does not observe")
        assert policy.adapt(Scenario(observation=policy.layouts[0])) is policy
    hidden = Scenario(observation="output_feedback")
    assert_refused(lambda: mlp_policy(36).adapt(hidden), "reads tracking_error_rate, .* does not observe", ValueError)
    for policy in (mlp_policy(27), controller("lqr"), mlp_policy(45, hybrid=ESTIMATE_ONLY)):
        message = "reads attitude, reference_2.*, which the scenario does not observe; it observes direction, track"
        assert_refused(lambda policy=policy: policy.adapt(few), message, ValueError)
    assert_refused(
        lambda: controller("swing-up").adapt(Scenario(observation=OUTPUT_FEEDBACK)), "reads .*_rate", ValueError
    )


def test_a_controller_reads_an_observation_in_any_order() -> None:
    mixed = Scenario(observation=FULL[::-1])  # type: ignore[arg-type]
    actions = [
        controller("lqr").adapt(scenario).predict(scenario.make_vec(3).reset(seed=0)[0])[0]
        for scenario in (Scenario(), mixed)
    ]
    np.testing.assert_array_equal(*actions)


def test_policy_is_refused_where_an_action_commands_something_else_and_warns_of_another_vehicle() -> None:
    rates, wrench = (mlp_policy(36, interface=name, vehicle="hummingbird") for name in ("body_rates", "wrench"))
    with pytest.raises(ValueError, match=r"interface 'body_rates'.* interface 'wrench'"):
        rates.adapt(Scenario())
    with pytest.raises(ValueError, match=r"'wrench'.*'body_rates'"):
        wrench.adapt(BODY_RATES)
    with pytest.warns(UserWarning, match="trained on the vehicle hummingbird flies the vehicle x500"):
        rates.adapt(Scenario(vehicle="x500", interface="body_rates"))
    with pytest.warns(UserWarning, match="what the actions of 100% command: they are taken as those of 'body_rates'"):
        check_policy("100%", mlp_policy(36), "calm", BODY_RATES)
