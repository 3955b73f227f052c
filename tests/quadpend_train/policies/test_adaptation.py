"""What a policy is given by a scenario."""

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from quadpend_baselines import controller
from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.hybrid import ResidualAction
from quadpend_gym import Simulation
from quadpend_gym.actuators import ActionDelay, MotorLag
from quadpend_gym.scenarios import Scenario
from quadpend_gym.sensors import Delay, Noise
from quadpend_train.policies.adaptation import adapt_policy, check_policy
from quadpend_train.policies.network_policy import NetworkPolicy
from tests.helpers.policies import mlp_policy

DELAYED = Scenario(sensors=[Noise(position=0.001), Delay(1)], actuators=[ActionDelay(2), MotorLag(0.02)])
LOOP = Loop(delay=2, actuators=(MotorLag(0.02),), sensor_delay=1)


def test_controllers_and_base_controllers_are_told_the_loop() -> None:
    assert adapt_policy(controller("flatness"), DELAYED).loop == LOOP  # type: ignore[attr-defined]
    hybrid = ResidualAction("flatness").with_simulation(DELAYED.simulation, LOOP)
    assert hybrid.base_controller.loop == LOOP


def test_scenario_can_keep_the_loop_unknown() -> None:
    unknown = replace(DELAYED, loop_known=False)
    assert adapt_policy(controller("flatness"), unknown).loop == Loop()  # type: ignore[attr-defined]


BODY_RATES = Scenario(simulation=Simulation(vehicle="hummingbird", interface="body_rates"))


@pytest.mark.parametrize(
    "policy", [mlp_policy(36), NetworkPolicy(lambda x: np.zeros((len(x), 4)), "a network")], ids=["zip", "network"]
)
def test_a_policy_from_elsewhere_is_warned_about_once_where_actions_are_not_a_wrench(policy: Any) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("default")
        for name in ("windy", "calm"):
            check_policy("100%", policy, name, BODY_RATES)
        check_policy("100%", policy, "paper", Scenario())
        check_policy("own", mlp_policy(36, interface="body_rates", vehicle="hummingbird"), "calm", BODY_RATES)
    found = [text for item in caught if "nothing says" in (text := str(item.message))]
    assert len(found) == 1
    assert "what the actions of 100% command: they are taken as those of 'body_rates'" in found[0]
