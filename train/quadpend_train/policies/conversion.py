"""Conversion of objects of other libraries to policies."""

from typing import Any

from quadpend_baselines import Policy


def as_policy(value: Any) -> Policy:
    """Return an object as a policy.

    Args:
        value: One of

            - a model of Stable-Baselines3 or sb3-contrib, see `quadpend_train.policies.export.policy_from_model`;
            - a torch module, see `quadpend_train.policies.torch_policy.policy_from_torch`;
            - an object with the `predict` method of `quadpend_baselines.Policy`, which is returned.

    Raises:
        TypeError: If `value` is none of these.
        ValueError: If a model or module has other observations or actions than the environment.
    """
    policy: Policy = convert(value)
    if isinstance(policy, type) or not callable(getattr(policy, "predict", None)):
        raise TypeError(
            "a policy must be an object with predict(observation, state, episode_start, deterministic) -> (action,"
            f" state), a model of Stable-Baselines3 or a torch module, not {value!r}"
        )
    return policy


def convert(value: Any) -> Any:
    """Return the policy of a model of Stable-Baselines3 or of a torch module, and other objects as they are.

    Args:
        value: Any object; for models and modules, see `as_policy`.

    Raises:
        ValueError: If a model or module has other observations or actions than the environment.
    """
    kinds = {f"{kind.__module__}.{kind.__name__}" for kind in type(value).__mro__}  # without importing torch
    if "stable_baselines3.common.base_class.BaseAlgorithm" in kinds:
        from quadpend_train.policies.export import policy_from_model

        return policy_from_model(value)
    if "torch.nn.modules.module.Module" in kinds and not hasattr(value, "predict"):
        from quadpend_train.policies.torch_policy import policy_from_torch

        return policy_from_torch(value)
    return value
