"""Training with Stable-Baselines3, policy files, comparison, searches, reports, and the command `quadpend`.

`evaluate` writes a whole report from Python:

    from quadpend_train import evaluate

    print(evaluate({"mine": MyController(), "lqr": "lqr"}, ["calm", "windy"], out="results/mine"))

`SB3VecEnv` adapts the native vector environment to Stable-Baselines3:

    from quadpend_train import SB3VecEnv

    envs = SB3VecEnv(gym.make_vec("quadpend_gym:QuadPendulum-v0", num_envs=256, autoreset_mode="SameStep"))

The names below are imported when they are first used, because some of them load torch or matplotlib.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from quadpend_gym.scenarios import Scenario
    from quadpend_train.envs.sb3_vec_env import SB3VecEnv
    from quadpend_train.evaluation.comparison import compare
    from quadpend_train.evaluation.episodes import run_episodes
    from quadpend_train.policies.conversion import as_policy
    from quadpend_train.policies.loading import load_policy
    from quadpend_train.policies.mlp_policy import MlpPolicy
    from quadpend_train.reports.report import evaluate

_MODULES = {
    "MlpPolicy": "quadpend_train.policies.mlp_policy",
    "SB3VecEnv": "quadpend_train.envs.sb3_vec_env",
    "Scenario": "quadpend_gym.scenarios",
    "as_policy": "quadpend_train.policies.conversion",
    "compare": "quadpend_train.evaluation.comparison",
    "evaluate": "quadpend_train.reports.report",
    "load_policy": "quadpend_train.policies.loading",
    "run_episodes": "quadpend_train.evaluation.episodes",
}
__all__ = ["MlpPolicy", "SB3VecEnv", "Scenario", "as_policy", "compare", "evaluate", "load_policy", "run_episodes"]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULES[name]), name)
