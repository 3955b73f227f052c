"""RLlib trains in the environment, and its checkpoint becomes a policy; skipped where RLlib is missing.

RLlib pins an older Gymnasium, so it needs a virtual environment of its own: ``pip install 'ray[rllib]'``.
"""

import subprocess
import sys
from pathlib import Path

import pytest

from quadpend_train.cli.main import main
from tests.helpers.sources import ROOT

pytest.importorskip("ray.rllib", reason="RLlib is not installed", exc_type=ImportError)
pytestmark = pytest.mark.extras


def test_policy_of_rllib_flies_in_a_comparison(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    example = ROOT / "docs/examples/ppo_with_rllib.py"
    command = [sys.executable, str(example), "--iterations", "1", "--num-envs", "4", "--out", "run"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr[-3000:]
    out = str(tmp_path / "out")
    policy = f"rllib={tmp_path / 'run/policy.npz'}"
    main(["evaluate", "lqr", policy, "--scenarios", "calm", "--episodes", "2", "--out", out])
    assert "rllib" in capsys.readouterr().out
