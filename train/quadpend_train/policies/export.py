"""From a model of Stable-Baselines3 to a `LearnedPolicy`: the network of the policy, and a card."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from quadpend_gym.core.arrays import Floats32
from quadpend_train.policies.mlp_policy import FORMAT, MlpPolicy
from quadpend_train.policies.sb3_models import ACTIVATION_MODULES, output_layer, read_zip

PLAIN_VIEW = {
    "companion": "",
    "steers": "alone",
    "authority": 1.0,
    "caution": 0.0,
    "hold": 1,
    "history": 1,
    "history_actions": 0,
}
_TOLERANCE = 1e-5  # of an action's component: float32 sums in another order


def export(model: Any, view: dict[str, Any] | None = None, **card: Any) -> MlpPolicy:
    """The policy of a model, without what only training needs.

    Args:
        model: PPO, SAC or TQC with an `MlpPolicy`.
        view: what the policy sees, see `LearnedPolicy`; None: the observation alone.
        card: what else to remember.

    Raises:
        ValueError: its policy is more than a feedforward network of what it sees.
    """
    layers, activation = _network(model)
    squashed = not hasattr(model.policy, "action_net")
    about = {"format": FORMAT, "activation": activation, "squashed": squashed, "view": dict(view or PLAIN_VIEW)}
    last = output_layer(model)
    if isinstance(last, torch.nn.Sequential):  # of a state-dependent exploration
        limit: Any = last[1]
        about["bound"] = float(limit.max_val)
    policy = MlpPolicy(layers, {**about, **card})
    seen = np.random.default_rng(0).normal(size=(64, layers[0][0].shape[0])).astype(np.float32)
    expected, _ = model.predict(seen, deterministic=True)
    if not np.allclose(policy.act(seen), expected, atol=_TOLERANCE):
        raise ValueError("the model's policy does more than its network: it cannot be exported")
    return policy


def export_zip(path: Path, **card: Any) -> MlpPolicy:
    """The policy in a file that PPO, SAC or TQC has saved, which sees the observation alone.

    Loading such a file executes code that is in it: export only files whose origin you trust.

    Raises:
        ValueError: it is no such file, or its policy is no feedforward network of an observation.
    """
    return export(read_zip(path), **card)


def _network(model: Any) -> tuple[Sequence[tuple[Floats32, Floats32]], str]:
    policy = model.policy
    inner = policy.mlp_extractor.policy_net if hasattr(policy, "mlp_extractor") else policy.actor.latent_pi
    last = output_layer(model)
    modules = [*inner, *(last if isinstance(last, torch.nn.Sequential) else [last])]
    linear = [module for module in modules if isinstance(module, torch.nn.Linear)]
    bends = [module for module in modules if not isinstance(module, torch.nn.Linear | torch.nn.Hardtanh)]
    names = [name for name, kind in ACTIVATION_MODULES.items() if all(type(module) is kind for module in bends)]
    if not names or len(bends) != len(linear) - 1:
        raise ValueError("only networks of linear layers with relu, tanh or elu between them can be exported")
    layers = [
        (layer.weight.detach().numpy().T.astype(np.float32).copy(), layer.bias.detach().numpy().astype(np.float32))
        for layer in linear
    ]
    return layers, names[0]
