"""Policies by name, and as they are seated in a scenario."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from quadpend_baselines import ADRC, CONTROLLERS, RotorAllocation, controller
from quadpend_gym import OBSERVATION_FIELDS, Parameters, Simulation
from quadpend_gym.core.arrays import Floats32
from quadpend_train.policies import loading
from quadpend_train.policies import mlp_policy as learned_module
from quadpend_train.policies.adaptation import adapt_policy
from quadpend_train.policies.finite_differences import FiniteDifferencePolicy
from quadpend_train.policies.loading import identities, load_policies, load_policy, members
from quadpend_train.policies.mlp_policy import MlpPolicy, difference
from quadpend_train.scenarios import Scenario
from tests.helpers.mlp_policies import learned


class Seeing:
    """ADRC that wants the whole observation, like a learned policy, and keeps what it saw."""

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
        told: Any = controller(name).with_simulation(heavy)  # type: ignore[attr-defined]
        assert told.simulation == heavy
        assert type(told) is type(controller(name, heavy))
    with pytest.raises(ValueError, match="there is no controller 'nix'; there are adrc-paper"):
        controller("nix")


def test_a_controller_is_told_what_the_scenario_is() -> None:
    light = Simulation(Parameters(inertia_roll=0.004, inertia_pitch=0.004, inertia_yaw=0.008))
    policy: Any = adapt_policy(ADRC("matched"), Scenario(simulation=light))
    assert policy.simulation == light
    assert policy.gains == ADRC("matched").gains
    assert isinstance(adapt_policy(ADRC(), Scenario(simulation=light, actuators="rotors")), RotorAllocation)


def test_hidden_velocities_are_differences() -> None:
    """What it sees is what it would have seen, half a step late: at 50 rad/s² by 0.25 rad/s, an eighth as scaled."""
    seeing = Seeing()
    policy = FiniteDifferencePolicy(seeing, Simulation().period)
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


@pytest.fixture
def shipped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package with two learners, one of them with three seeds."""
    for module in (loading, learned_module):
        monkeypatch.setattr(module, "SHIPPED", tmp_path)
    for seed in range(3):
        learned(36, seed=seed).save(tmp_path / f"ppo-{seed}.npz")
    learned(45, {"companion": "flatness", "steers": "pace"}).save(tmp_path / "sac-pace-0.npz")
    return tmp_path


def test_learned_policies_of_the_package_come_by_name_one_by_one_or_all_seeds(shipped: Path) -> None:
    for name in ("ppo-1", str(shipped / "ppo-1.npz")):
        policy: Any = load_policy(name)
        assert difference(policy, learned(36, seed=1)) == 0.0
    assert members("ppo") == ["ppo-0", "ppo-1", "ppo-2"]
    assert members("sac-pace,adrc-paper") == ["sac-pace-0", "adrc-paper"]
    assert [type(policy) for policy in load_policies("ppo")] == [MlpPolicy] * 3
    assert len(set(identities("ppo"))) == 3
    with pytest.raises(
        ValueError, match=r"no policy 'nix': it is neither adrc-paper, .*, ppo, sac-pace nor a finished"
    ):
        load_policy("nix")


def test_a_run_folder_stands_for_its_policy_once_it_is_finished(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="nor a finished run or a file"):
        load_policy(str(tmp_path))
    learned(36).save(tmp_path / "policy.npz")
    assert isinstance(load_policy(str(tmp_path)), MlpPolicy)


def test_a_learned_policy_sees_what_it_was_trained_to_see() -> None:
    """Velocities are differences where it wants them and they are hidden; what has an estimator needs none."""
    hidden, rotors = Scenario(output_feedback=True), Scenario(actuators="rotors")
    whole, outputs = learned(36), learned(27)
    assert adapt_policy(whole, Scenario()) is whole
    assert isinstance(adapt_policy(whole, hidden), FiniteDifferencePolicy)
    assert adapt_policy(outputs, hidden) is outputs
    assert isinstance(adapt_policy(learned(72, {"history": 2}), hidden), FiniteDifferencePolicy)
    assert isinstance(adapt_policy(learned(45, {"companion": "flatness"}), hidden), MlpPolicy)
    assert isinstance(adapt_policy(learned(45, {"companion": "adrc-paper"}), hidden), FiniteDifferencePolicy)
    assert adapt_policy(whole, rotors) is whole


def test_the_companion_of_a_learned_policy_is_told_what_the_scenario_is() -> None:
    heavy = Simulation(Parameters(bob_mass=0.4))
    policy: Any = adapt_policy(learned(45, {"companion": "flatness"}), Scenario(simulation=heavy))
    assert policy._companion.controller.simulation == heavy
