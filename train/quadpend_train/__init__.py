"""Training with Stable-Baselines3, policy files, comparison, studies, reports, and the command `quadpend`.

`evaluate` writes a whole report from Python:

    from quadpend_train import evaluate

    print(evaluate({"mine": MyController(), "lqr": "lqr"}, ["calm", "windy"], out="results/mine"))

The names below are imported when they are first used, because some of them load matplotlib.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from quadpend_train.evaluation.comparison import compare
    from quadpend_train.evaluation.episodes import run_episodes
    from quadpend_train.reports.report import evaluate
    from quadpend_train.scenarios import Scenario

_MODULES = {
    "Scenario": "quadpend_train.scenarios",
    "compare": "quadpend_train.evaluation.comparison",
    "evaluate": "quadpend_train.reports.report",
    "run_episodes": "quadpend_train.evaluation.episodes",
}
__all__ = ["Scenario", "compare", "evaluate", "run_episodes"]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULES[name]), name)
