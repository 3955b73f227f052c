"""A network as ONNX returns the actions of the policy."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import onnxruntime
import pytest

from quadpend_train.export.to_onnx import export_onnx
from quadpend_train.policies.conversion import FunctionPolicy
from quadpend_train.policies.loading import load_policy
from quadpend_train.policies.mlp_policy import FORMAT, MlpPolicy


def network() -> MlpPolicy:
    """A network with all that a card can have."""
    rng, sizes = np.random.default_rng(0), (108, 8, 4)
    layers = [
        (rng.normal(size=shape).astype(np.float32), rng.normal(size=shape[1]).astype(np.float32))
        for shape in pairwise(sizes)
    ]
    normalization = {"mean": [0.1] * 36, "std": [2.0] * 36, "clip": 0.5}
    card = {"activation": "elu", "squashed": True, "bound": 2.0, "input_scales": [8.0, 64.0]}
    return MlpPolicy(layers, {"format": FORMAT, "hybrid": None, **card, "normalization": normalization})


@pytest.mark.parametrize("name", ["ppo-swing-up-0", ""])
def test_a_session_returns_the_actions_of_the_policy(name: str, tmp_path: Path) -> None:
    policy, path = load_policy(name) if name else network(), tmp_path / "policy.onnx"
    export_onnx(policy, path)
    session = onnxruntime.InferenceSession(path)
    again = FunctionPolicy(lambda seen: session.run(None, {"observation": seen})[0])
    observation = np.random.default_rng(0).normal(size=(5, 36)).astype(np.float32)
    np.testing.assert_allclose(again.predict(observation)[0], policy.predict(observation)[0], atol=1e-5)


def test_a_policy_with_an_observer_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="ONNX has the network alone"):
        export_onnx(load_policy("apg-0"), tmp_path / "policy.onnx")
    with pytest.raises(ValueError, match="ONNX has networks alone: --to c writes ADRC"):
        export_onnx(load_policy("lqg"), tmp_path / "policy.onnx")
