"""What a scenario tells a policy."""

from dataclasses import replace

from quadpend_baselines import controller
from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.hybrid import ResidualAction
from quadpend_gym.actuators import ActionDelay, MotorLag
from quadpend_gym.sensors import Delay, Noise
from quadpend_train.policies.adaptation import adapt_policy
from quadpend_train.scenarios import Scenario

DELAYED = Scenario(sensors=[Noise(position=0.001), Delay(1)], actuators=[ActionDelay(2), MotorLag(0.02)])
LOOP = Loop(delay=2, actuators=(MotorLag(0.02),), sensor_delay=1)


def test_controllers_and_base_controllers_are_told_the_loop() -> None:
    assert adapt_policy(controller("flatness"), DELAYED).loop == LOOP  # type: ignore[attr-defined]
    hybrid = ResidualAction("flatness").with_simulation(DELAYED.simulation, LOOP)
    assert hybrid.base_controller.loop == LOOP


def test_scenario_can_keep_the_loop_unknown() -> None:
    unknown = replace(DELAYED, loop_known=False)
    assert adapt_policy(controller("flatness"), unknown).loop == Loop()  # type: ignore[attr-defined]
