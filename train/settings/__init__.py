"""Training settings: one dataclass with every default, and files with what a run does differently."""

import json
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Literal

from quadpend_gym.records import number, positive, whole
from train.files import read_mapping
from train.scenarios import resolve

FOLDER = Path(__file__).parent
ACTIVATIONS = ("relu", "tanh", "elu")


@dataclass(frozen=True)
class TrainSettings:
    """Everything that decides how a policy is trained.

    Raises:
        ValueError: a setting is unknown or out of range.
    """

    scenario: str = "windy"
    """Name of the scenario to train in, or a TOML or JSON file with one, or its JSON, see `train.scenarios`."""
    total_steps: int = 7_000_000
    """Environment steps to train for."""
    max_seconds: float = 0.0
    """Wall-clock seconds after which a run, or its resumption, ends at the latest; 0: no such limit."""
    seed: int = 0
    """Of the networks and the episodes."""
    num_envs: int = 256
    """Rows of the vector environment."""
    rollout_steps: int = 64
    """Steps of each row between two updates."""
    batch_size: int = 1024
    """Samples in a gradient step."""
    epochs: int = 3
    """Passes over a rollout."""
    learning_rate: float = 2e-3
    """Of Adam, at the beginning."""
    final_learning_rate: float = 4e-5
    """Of Adam, at the end; it falls linearly."""
    discount: float = 0.995
    """γ."""
    gae_lambda: float = 0.95
    """λ of the generalised advantage estimate."""
    clip_range: float = 0.2
    """Of PPO's ratio."""
    entropy_coefficient: float = 0.0
    """Of the entropy bonus."""
    reward_scale: float = 0.01
    """Factor on the rewards that the learner sees, so that returns are of order one."""
    hidden: tuple[int, ...] = (64, 64)
    """Widths of the hidden layers of policy and value network."""
    activation: Literal["relu", "tanh", "elu"] = "relu"
    """Between the layers."""
    initial_log_std: float = 0.0
    """Logarithm of the action noise at the beginning."""
    checkpoint_steps: int = 1_000_000
    """Environment steps between two checkpoints."""
    threads: int = 1
    """Of torch. Two are faster on two idle cores, and many times slower on busy ones."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "scenario", resolve(self.scenario))
        object.__setattr__(self, "hidden", tuple(self.hidden))
        for name in ("total_steps", "num_envs", "rollout_steps", "batch_size", "epochs", "checkpoint_steps", "threads"):
            whole(getattr(self, name), name, 1)
        whole(self.seed, "seed", 0)
        for i, width in enumerate(self.hidden):
            whole(width, f"hidden[{i}]", 1)
        for name in ("learning_rate", "clip_range", "reward_scale"):
            positive(getattr(self, name), name)
        for name in ("discount", "gae_lambda"):
            number(getattr(self, name), name, 0.0, 1.0)
        for name in ("max_seconds", "final_learning_rate", "entropy_coefficient"):
            number(getattr(self, name), name, 0.0)
        number(self.initial_log_std, "initial_log_std")
        if self.activation not in ACTIVATIONS:
            raise ValueError(f"activation must be one of {', '.join(ACTIVATIONS)}, not {self.activation!r}")
        if self.num_envs * self.rollout_steps % self.batch_size:
            raise ValueError(
                f"batch_size must divide num_envs * rollout_steps = {self.num_envs * self.rollout_steps},"
                f" not be {self.batch_size}"
            )


def read_settings(name: str) -> TrainSettings:
    """The defaults, changed by a file.

    Args:
        name: of a file here without its ending (``demo``), or the path of a TOML or JSON file, such as the
            ``settings.json`` of a run to repeat.

    Raises:
        ValueError: there is no such file, or it sets something unknown.
    """
    path = FOLDER / f"{name}.toml"
    if not path.is_file():
        path = Path(name)
    if not path.is_file():
        known = ", ".join(sorted(item.stem for item in FOLDER.glob("*.toml")))
        raise ValueError(f"there are no settings {name!r}; there are {known}, or give the path of a file")
    return from_mapping(read_mapping(path), str(path))


def from_mapping(values: dict[str, Any], source: str) -> TrainSettings:
    """The defaults, changed by `values`, which come from `source`.

    Raises:
        ValueError: a key is unknown or a value out of range.
    """
    known = [item.name for item in fields(TrainSettings)]
    if unknown := [key for key in values if key not in known]:
        raise ValueError(f"{source} sets {unknown[0]!r}, which is no setting; the settings are {', '.join(known)}")
    if isinstance(scenario := values.get("scenario"), dict):
        values = {**values, "scenario": json.dumps(scenario, default=str)}
    return TrainSettings(**values)


def to_mapping(settings: TrainSettings) -> dict[str, Any]:
    """All settings as plain data."""
    return asdict(settings)
