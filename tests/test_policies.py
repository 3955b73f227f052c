"""Policies by name, and as they are seated in a scenario."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from baselines import ADRC, CONTROLLERS, ThroughRotors, controller
from quadpend_gym import OBSERVATION_FIELDS, Parameters, Simulation
from quadpend_gym.arrays import Floats32
from train.policies import load_policies, load_policy, seated
from train.scenarios import Scenario
from train.velocities import WithVelocities


class Seeing:
    """ADRC that wants the whole observation, like a learned policy, and keeps what it saw."""

    observation_space = SimpleNamespace(shape=(36,))

    def __init__(self) -> None:
        self.adrc, self.seen = ADRC("matched"), [np.zeros((0, 36), np.float32)]

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, Any]:
        self.seen.append(observation)
        return self.adrc.predict(observation, state, episode_start)


def test_controllers_come_by_name() -> None:
    assert isinstance(load_policy("adrc-paper"), ADRC)
    assert len(load_policies("adrc-paper,adrc-matched")) == 2
    heavy = Simulation(Parameters(bob_mass=0.4))
    for name in CONTROLLERS:
        told: Any = controller(name).told(heavy)  # type: ignore[attr-defined]
        assert told.simulation == heavy
        assert type(told) is type(controller(name, heavy))
    with pytest.raises(ValueError, match="there is no controller 'nix'; there are adrc-paper"):
        controller("nix")


def test_a_controller_is_told_what_the_scenario_is() -> None:
    light = Simulation(Parameters(inertia_roll=0.004, inertia_pitch=0.004, inertia_yaw=0.008))
    policy: Any = seated(ADRC("matched"), Scenario(simulation=light))
    assert policy.simulation == light
    assert policy.gains == ADRC("matched").gains
    assert isinstance(seated(ADRC(), Scenario(simulation=light, actuators="rotors")), ThroughRotors)


def test_hidden_velocities_are_differences() -> None:
    """What it sees is what it would have seen, half a step late: at 50 rad/s² by 0.25 rad/s, an eighth as scaled."""
    seeing = Seeing()
    assert seated(seeing, Scenario()) is seeing
    policy = seated(seeing, Scenario(output_feedback=True))
    assert isinstance(policy, WithVelocities)
    whole = Scenario().make_vec(20, AutoresetMode.SAME_STEP)
    hidden = Scenario(output_feedback=True).make_vec(20, AutoresetMode.SAME_STEP)
    true, observation, memory = whole.reset(seed=3)[0], hidden.reset(seed=3)[0], None
    rates = [OBSERVATION_FIELDS[name] for name in ("tracking_error_rate", "direction_rate", "euler_rate")]
    others = np.delete(np.arange(36), np.r_[tuple(rates)])
    for step in range(300):
        action, memory = policy.predict(observation, memory, np.full(20, step in (0, 150)))
        seen = seeing.seen[-1]
        np.testing.assert_array_equal(seen[:, others], true[:, others])
        for rate in rates[:2] if step in (0, 150) else ():
            np.testing.assert_array_equal(seen[:, rate], 0.0)
        if step not in (0, 150):
            np.testing.assert_allclose(seen[:, np.r_[tuple(rates)]], true[:, np.r_[tuple(rates)]], atol=0.126)
        true, observation = whole.step(action)[0], hidden.step(action)[0]
