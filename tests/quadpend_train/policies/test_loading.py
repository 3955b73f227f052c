"""Policies are loaded by name and adapted to scenarios."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from quadpend_baselines import ADRC, RotorAllocation, controller
from quadpend_gym import OBSERVATION_FIELDS, Parameters, Simulation
from quadpend_gym.core.arrays import Floats32
from quadpend_gym.scenarios import Scenario
from quadpend_train.policies import loading
from quadpend_train.policies import mlp_policy as learned_module
from quadpend_train.policies.adaptation import adapt_policy
from quadpend_train.policies.finite_differences import FiniteDifferencePolicy
from quadpend_train.policies.loading import load_policies, load_policy, policy_fingerprints, policy_names
from quadpend_train.policies.mlp_policy import MlpPolicy, weight_difference
from tests.helpers.controllers import AVAILABLE_CONTROLLERS
from tests.helpers.policies import BANDWIDTH_SCHEDULING, ESTIMATE_ONLY, mlp_policy


class RecordingPolicy:
    """ADRC that needs the full observation, like a learned policy, and records its observations."""

    def __init__(self) -> None:
        self.adrc, self.observed = ADRC("matched"), [np.zeros((0, 36), np.float32)]

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, Any]:
        self.observed.append(observation)
        return self.adrc.predict(observation, state, episode_start)


def test_controllers_are_loaded_by_name() -> None:
    assert isinstance(load_policy("adrc-paper"), ADRC)
    assert len(load_policies("adrc-paper,adrc-matched")) == 2
    heavy = Simulation(Parameters(bob_mass=0.4))
    for name in AVAILABLE_CONTROLLERS:
        adapted: Any = controller(name).with_simulation(heavy)  # type: ignore[attr-defined]
        assert adapted.simulation == heavy
        assert type(adapted) is type(controller(name, heavy))
    with pytest.raises(ValueError, match="there is no controller 'nix'; there are adrc-paper"):
        controller("nix")


def test_controller_receives_the_simulation_of_the_scenario() -> None:
    light = Simulation(Parameters(inertia_roll=0.004, inertia_pitch=0.004, inertia_yaw=0.008))
    policy: Any = adapt_policy(ADRC("matched"), Scenario(simulation=light))
    assert policy.simulation == light
    assert policy.gains == ADRC("matched").gains
    assert isinstance(adapt_policy(ADRC(), Scenario(simulation=light, actuators="rotors")), RotorAllocation)


def test_unobserved_velocities_are_finite_differences() -> None:
    """They lag by half a step: at 50 rad/s² that is 0.25 rad/s, or 0.125 after scaling."""
    recording = RecordingPolicy()
    policy = FiniteDifferencePolicy(recording, Simulation().period)
    full = Scenario().make_vec(20, AutoresetMode.SAME_STEP)
    hidden = Scenario(output_feedback=True).make_vec(20, AutoresetMode.SAME_STEP)
    true, observation, memory = full.reset(seed=3)[0], hidden.reset(seed=3)[0], None
    rates = [OBSERVATION_FIELDS[name] for name in ("tracking_error_rate", "direction_rate", "euler_rate")]
    others = np.delete(np.arange(36), np.r_[tuple(rates)])
    for step in range(300):
        action, memory = policy.predict(observation, memory, np.full(20, step in (0, 150)))
        observed = recording.observed[-1]
        np.testing.assert_array_equal(observed[:, others], true[:, others])
        for rate in rates[:2] if step in (0, 150) else ():
            np.testing.assert_array_equal(observed[:, rate], 0.0)
        if step not in (0, 150):
            np.testing.assert_allclose(observed[:, np.r_[tuple(rates)]], true[:, np.r_[tuple(rates)]], atol=0.126)
        true, observation = full.step(action)[0], hidden.step(action)[0]


@pytest.fixture
def shipped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package with two learned policies, one of them with three seeds."""
    for module in (loading, learned_module):
        monkeypatch.setattr(module, "SHIPPED", tmp_path)
    for seed in range(3):
        mlp_policy(36, seed=seed).save(tmp_path / f"ppo-{seed}.npz")
    mlp_policy(45, hybrid=BANDWIDTH_SCHEDULING).save(tmp_path / "sac-gain-scheduling-0.npz")
    return tmp_path


def test_shipped_policies_are_loaded_by_name_one_seed_or_all(shipped: Path) -> None:
    for name in ("ppo-1", str(shipped / "ppo-1.npz")):
        policy: Any = load_policy(name)
        assert weight_difference(policy, mlp_policy(36, seed=1)) == 0.0
    assert policy_names("ppo") == ["ppo-0", "ppo-1", "ppo-2"]
    assert policy_names("sac-pace,adrc-paper") == ["sac-gain-scheduling-0", "adrc-paper"]
    assert [type(policy) for policy in load_policies("ppo")] == [MlpPolicy] * 3
    assert len(set(policy_fingerprints("ppo"))) == 3
    with pytest.raises(
        ValueError,
        match=r"there is no policy 'nix'; there are adrc-paper, .*, ppo, sac-gain-scheduling; or give the path of",
    ):
        load_policy("nix")


def test_run_folder_is_a_policy_after_the_run_is_finished(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="finished run or a policy file"):
        load_policy(str(tmp_path))
    mlp_policy(36).save(tmp_path / "policy.npz")
    assert isinstance(load_policy(str(tmp_path)), MlpPolicy)


def test_learned_policy_receives_finite_differences_only_if_it_needs_them() -> None:
    """A base controller with an estimator needs no finite differences."""
    hidden, rotors = Scenario(output_feedback=True), Scenario(actuators="rotors")
    whole, outputs = mlp_policy(36), mlp_policy(27)
    assert adapt_policy(whole, Scenario()) is whole
    assert isinstance(adapt_policy(whole, hidden), FiniteDifferencePolicy)
    assert adapt_policy(outputs, hidden) is outputs
    assert isinstance(adapt_policy(mlp_policy(72, history=2), hidden), FiniteDifferencePolicy)
    assert isinstance(adapt_policy(mlp_policy(45, hybrid=ESTIMATE_ONLY), hidden), MlpPolicy)
    assert isinstance(
        adapt_policy(mlp_policy(45, hybrid={**ESTIMATE_ONLY, "base_controller": "adrc-paper"}), hidden),
        FiniteDifferencePolicy,
    )
    assert adapt_policy(whole, rotors) is whole


def test_base_controller_of_a_learned_policy_receives_the_simulation_of_the_scenario() -> None:
    heavy = Simulation(Parameters(bob_mass=0.4))
    policy: Any = adapt_policy(mlp_policy(45, hybrid=ESTIMATE_ONLY), Scenario(simulation=heavy))
    assert policy.hybrid.base_controller.simulation == heavy
