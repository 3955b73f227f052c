"""Policies are loaded by name."""

from pathlib import Path
from typing import Any

import pytest

from quadpend_baselines import CONTROLLERS, controller
from quadpend_train.policies.loading import SHIPPED, load_policies, load_policy
from quadpend_train.policies.mlp_policy import MlpPolicy
from tests.helpers.policies import mlp_policy


def test_controllers_and_shipped_policies_are_loaded_by_name_one_or_several() -> None:
    assert load_policy("adrc-paper").fingerprint == "adrc-paper"
    seeds = load_policies("ppo-alone-0,apg-0")
    assert [type(policy) for policy in seeds] == [MlpPolicy] * 2
    assert len({policy.fingerprint for policy in [*seeds, load_policy("lqr")]}) == 3
    assert load_policy(str(SHIPPED / "apg-0.npz")).fingerprint == seeds[1].fingerprint


def test_gains_of_a_file_make_a_controller(tmp_path: Path) -> None:
    path = tmp_path / "gains.json"
    path.write_text('{"score": 30.0, "gains": {"effort": 0.03, "estimator": {"force_walk": 0.4}}}')
    policy: Any = load_policy(f"lqg:{path}")
    given: Any = load_policy("lqg")
    assert (policy.gains.effort, policy.gains.estimator.force_walk) == (0.03, 0.4)
    assert policy.gains.yaw == given.gains.yaw
    assert policy.fingerprint != given.fingerprint
    with pytest.raises(ValueError, match=r"there is no controller 'lqx' \(did you mean 'lq.'\?\)"):
        load_policy(f"lqx:{path}")
    path.write_text('{"efort": 0.03}')
    with pytest.raises(ValueError, match=r"gains.json: .* there is no gain 'efort' \(did you mean 'effort'\?\); there"):
        load_policy(f"lqg:{path}")
    path.write_text('{"controller": "lqr", "gains": {"effort": 0.03}}')
    with pytest.raises(ValueError, match=r"gains.json has the gains of lqr, not of lqg: give lqr:"):
        load_policy(f"lqg:{path}")
    with pytest.raises(ValueError, match=r"lqg:g.yaml: a file of gains must be a .json or .toml file"):
        load_policy("lqg:g.yaml")
    path.write_text('{"effort": -1}')
    with pytest.raises(ValueError, match=r"effort must be a finite number from 1e-12 to .*, not -1"):
        load_policy(f"lqg:{path}")


def test_run_folder_is_a_policy_after_the_run_is_finished(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="finished run or a policy file"):
        load_policy(str(tmp_path))
    mlp_policy(36).save(tmp_path / "policy.npz")
    assert isinstance(load_policy(str(tmp_path)), MlpPolicy)


def test_an_unknown_name_is_refused_with_the_known_ones() -> None:
    with pytest.raises(
        ValueError, match=r"there is no policy 'nix'; there are adrc-paper, .*, ppo-alone-0, .*; or give"
    ):
        load_policy("nix")
    with pytest.raises(ValueError, match=f"there is no controller 'nix'; there are {', '.join(CONTROLLERS)}"):
        controller("nix")


def test_only_c_files_are_supervised() -> None:
    with pytest.raises(ValueError, match=r"supervised: takes a C file of `quadpend export`.*, not 'lqg'"):
        load_policy("supervised:lqg")
