"""Policies are loaded by name."""

from pathlib import Path
from typing import Any

import pytest

from quadpend_baselines import ADRC, controller
from quadpend_gym import Simulation
from quadpend_train.policies import loading
from quadpend_train.policies import mlp_policy as learned_module
from quadpend_train.policies.loading import load_policies, load_policy, policy_fingerprints, policy_names
from quadpend_train.policies.mlp_policy import MlpPolicy, weight_difference
from tests.helpers.controllers import AVAILABLE_CONTROLLERS
from tests.helpers.policies import BANDWIDTH_SCHEDULING, mlp_policy


def test_controllers_are_loaded_by_name() -> None:
    assert isinstance(load_policy("adrc-paper"), ADRC)
    assert len(load_policies("adrc-paper,adrc-matched")) == 2
    other = Simulation(period=0.02)
    for name in AVAILABLE_CONTROLLERS:
        adapted = controller(name).designed_for(other)
        assert adapted.simulation == other
        assert type(adapted) is type(controller(name, other))
    with pytest.raises(ValueError, match="there is no controller 'nix'; there are adrc-paper"):
        controller("nix")


def test_shipped_policies_are_loaded_by_name_one_seed_or_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (loading, learned_module):
        monkeypatch.setattr(module, "SHIPPED", tmp_path)
    for seed in range(3):
        mlp_policy(36, seed=seed).save(tmp_path / f"ppo-{seed}.npz")
    mlp_policy(45, hybrid=BANDWIDTH_SCHEDULING).save(tmp_path / "sac-gain-scheduling-0.npz")
    for name in ("ppo-1", str(tmp_path / "ppo-1.npz")):
        policy: Any = load_policy(name)
        assert weight_difference(policy, mlp_policy(36, seed=1)) == 0.0
    assert policy_names("ppo,adrc-paper") == ["ppo-0", "ppo-1", "ppo-2", "adrc-paper"]
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
