"""Conversion of objects of other libraries to policies."""

from typing import Any

from quadpend_baselines import Policy


def as_policy(value: Any) -> Policy:
    """Return an object as a policy.

    Args:
        value: One of

            - a model of Stable-Baselines3 or sb3-contrib, see `quadpend_train.policies.export.policy_from_model`;
            - an object with the `predict` method of `quadpend_baselines.Policy`, which is returned;
            - a torch module, see `quadpend_train.policies.torch_policy.policy_from_torch`.

    Raises:
        TypeError: If `value` is none of these.
        ValueError: If a model or module has other observations or actions than the environment.
    """
    kinds = {f"{kind.__module__}.{kind.__name__}" for kind in type(value).__mro__}  # without importing torch
    if "stable_baselines3.common.base_class.BaseAlgorithm" in kinds:
        from quadpend_train.policies.export import policy_from_model

        return policy_from_model(value)
    if not isinstance(value, type) and callable(getattr(value, "predict", None)):
        policy: Policy = value
        return policy
    if "torch.nn.modules.module.Module" in kinds:
        from quadpend_train.policies.torch_policy import policy_from_torch

        return policy_from_torch(value)
    raise TypeError(
        "a policy must be an object with predict(observation, state, episode_start, deterministic) -> (action, state),"
        f" a model of Stable-Baselines3 or a torch module, not {value!r}"
    )
