"""RLlib trains in the environment, and its checkpoint becomes a policy; skipped where RLlib is missing."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from quadpend_train.cli.main import main
from quadpend_train.policies.mlp_policy import MlpPolicy
from tests.helpers.sources import ROOT

pytest.importorskip("ray.rllib", reason="RLlib is not installed", exc_type=ImportError)
EXAMPLE = ROOT / "docs/examples/ppo_with_rllib.py"


@pytest.mark.parametrize("mode", ["vector_entry_point", "sync"])
def test_policy_of_rllib_flies_in_a_comparison(mode: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """RLlib's own network gives the same actions."""
    import torch
    from ray.rllib.core.columns import Columns
    from ray.rllib.core.rl_module import RLModule

    command = [sys.executable, str(EXAMPLE), "--iterations", "1", "--num-envs", "4", "--mode", mode, "--out", "run"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr[-3000:]
    assert "0: episodes of" in done.stdout
    folder = tmp_path / "run"
    policy = MlpPolicy.load(folder / "policy.npz")
    module = RLModule.from_checkpoint(str(folder / "checkpoint/learner_group/learner/rl_module/default_policy"))
    observations = np.random.default_rng(0).normal(size=(50, 36)).astype(np.float32)
    with torch.no_grad():
        outputs = module.forward_inference({Columns.OBS: torch.as_tensor(observations)})[Columns.ACTION_DIST_INPUTS]
    actions = np.clip(outputs[:, :4].numpy(), -1.0, 1.0)
    np.testing.assert_allclose(policy.predict(observations)[0], actions, atol=1e-6)
    main(
        [
            "evaluate",
            "lqr",
            f"rllib={folder / 'policy.npz'}",
            "--scenarios",
            "calm",
            "--episodes",
            "2",
            "--out",
            str(tmp_path / "out"),
        ]
    )
    assert "rllib" in capsys.readouterr().out
