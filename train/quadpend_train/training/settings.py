"""Training settings: dataclasses with the default values, and functions that read settings from files."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any, Literal

from quadpend_baselines import CONTROLLERS
from quadpend_baselines.hybrid import HYBRIDS
from quadpend_gym import RewardWeights
from quadpend_gym.core.files import read_mapping
from quadpend_gym.core.ranges import Range, check_fields
from quadpend_gym.core.validation import check_int, from_plain, suggest
from quadpend_gym.scenarios import HELD_OUT, expand_sets, find_scenario, names_without_files, split_changes
from quadpend_train.policies.mlp_policy import ACTIVATIONS, MlpPolicy
from quadpend_train.training.algorithm_settings import ApgSettings, PpoSettings, SacSettings

PRESETS = Path(__file__).with_name("presets")
SB3_ALGORITHMS = ("ppo", "sac", "tqc")
REPLAY_ALGORITHMS = ("sac", "tqc")  # with a replay buffer
ALGORITHMS = (*SB3_ALGORITHMS, "apg")
_MOST_LAYERS, _WIDEST_LAYER = 16, 8192  # of a network
_MOST_SAMPLES = 50_000_000  # of a rollout, which needs about 0.2 kB of memory for each
# Algorithms that use a table of settings; other algorithms refuse it.
_ALGORITHMS_OF = {"ppo": ("ppo",), "sac": REPLAY_ALGORITHMS, "apg": ("apg",)}


@dataclass(frozen=True)
class HybridSettings:
    """Settings of a hybrid: a learned policy combined with a classical base controller."""

    base_controller: str = ""
    """Name of the base controller; empty for a policy without a base controller."""
    mode: Literal["estimate_only", "residual_action", "bandwidth_scheduling"] = "estimate_only"
    """Use of the policy's action. estimate_only: it acts alone, on the base controller's estimates. residual_action: it
    is added to the base controller's action. bandwidth_scheduling: it scales the base controller's bandwidths."""
    situation: bool = False
    """Whether the policy also observes the noise of the sensors and the strength of the wind over the last second, with
    estimate_only."""
    action_scale: Annotated[float, Range(1e-6, 3.0)] = 1.0
    """Factor κ in (0, 3] on the policy's action, with residual_action and bandwidth_scheduling."""
    fallback_gain: Annotated[float, Range(0.0, 10.0)] = 0.0
    """Gain γ in [0, 10] that reduces the policy's action as the anomaly score increases; 0 disables the fallback."""
    action_repeat: Annotated[int, Range(1, 1000)] = 1
    """Control steps for which each action of the policy is repeated. Timesteps count actions, not control steps."""
    baseline_relative_reward: bool = False
    """Subtract the reward that the base controller alone earns in a copy of the same episode."""
    failure_penalty: Annotated[float, Range(0.0, 1e6)] = 0.0
    """Penalty for a fall (early termination) with a baseline-relative reward, in rewards of steps of 0.01 s. It is
    multiplied by 0.01 s / control period, so that it has the same weight at any control period."""
    imitation_timesteps: Annotated[int, Range(0, 1e12)] = 0
    """Timesteps before training in which the policy imitates the base controller (DAgger)."""

    def __post_init__(self) -> None:
        for name, known in (("base_controller", ("", *CONTROLLERS)), ("mode", tuple(HYBRIDS))):
            _check_choice(getattr(self, name), name, known)
        check_fields(self)
        self._check_combination()

    def _check_combination(self) -> None:
        alone = self.mode == "estimate_only"
        if not self.base_controller and not alone:
            raise ValueError(f"mode {self.mode!r} needs a base_controller")
        if not self.base_controller and self.imitation_timesteps:
            raise ValueError("imitation_timesteps needs a base_controller")
        if not alone and self.imitation_timesteps:
            raise ValueError(f"imitation_timesteps must be 0 with mode {self.mode!r}, not {self.imitation_timesteps}")
        if self.situation and not (alone and self.base_controller):
            raise ValueError("situation needs the mode 'estimate_only' and a base_controller")
        if alone and self.action_repeat > 1:
            raise ValueError(f"action_repeat must be 1 with mode 'estimate_only', not {self.action_repeat}")
        if alone and self.fallback_gain:
            raise ValueError(f"fallback_gain must be 0 with mode 'estimate_only', not {self.fallback_gain:g}")
        if self.failure_penalty and not self.baseline_relative_reward:
            raise ValueError("failure_penalty needs baseline_relative_reward")
        if self.baseline_relative_reward and not self.base_controller:
            raise ValueError("baseline_relative_reward needs a base_controller")

    def as_data(self) -> dict[str, Any] | None:
        """Return the data from which `hybrid_from_data` makes the hybrid; None without a base controller."""
        if not self.base_controller:
            return None
        data = {"kind": self.mode, "base_controller": self.base_controller}
        if self.mode == "estimate_only":
            return {**data, "situation": True} if self.situation else data
        return {**data, "action_scale": self.action_scale, "fallback_gain": self.fallback_gain}


@dataclass(frozen=True)
class TrainSettings:
    """All settings of a training run.

    Timesteps are steps of the vector environment times its number of sub-environments, as in Stable-Baselines3.

    Raises:
        TypeError: If a setting has the wrong type.
        ValueError: If a setting is out of range, or two settings contradict each other.
    """

    algo: Literal["ppo", "sac", "tqc", "apg"] = "ppo"
    """Algorithm; TQC comes from sb3-contrib, APG (analytic policy gradients) is in this package."""
    scenarios: tuple[str, ...] = ("windy",)
    """Scenarios to train in, in equal numbers of sub-environments: names, sets, TOML or JSON files, or JSON."""
    curriculum: tuple[str, ...] = ()
    """Scenarios to train in first, one after the other, each for an equal part of curriculum_steps."""
    curriculum_steps: Annotated[int, Range(0, 1e12)] = 0
    """Timesteps of the whole curriculum."""
    total_timesteps: Annotated[int, Range(1, 1e12)] = 7_000_000
    """Timesteps of the whole training."""
    start_from: str = ""
    """Learned policy whose network training starts from: the name of a policy of this package, a run folder, or a file
    (.npz or .zip). Its network, hybrid, history and interface must be those of the settings. The critic starts
    untrained."""
    max_seconds: Annotated[float, Range(0.0, 1e9, "s")] = 0.0
    """Wall-clock seconds after which training stops, counted anew when a run is resumed; 0 for no limit. The last
    evaluation and the score come after it."""
    seed: Annotated[int, Range(0, 2**31 - 1)] = 0
    """Seed of the networks and the episodes."""
    num_envs: Annotated[int, Range(1, 100_000)] = 256
    """Number of sub-environments of the vector environment."""
    max_episode_steps: Annotated[int, Range(0, 10_000_000)] = 0
    """Control steps after which a training episode is truncated; 0 for the duration of the scenario."""
    hybrid: HybridSettings = field(default_factory=HybridSettings)
    """Settings of a hybrid."""
    history: Annotated[int, Range(1, 1000)] = 1
    """Number of latest observations that the policy receives."""
    history_actions: Annotated[int, Range(0, 1000)] = 0
    """Number of its own latest actions that the policy also receives."""
    batch_size: Annotated[int, Range(1, 10_000_000)] = 1024
    """Samples per gradient step."""
    learning_rate: Annotated[float, Range(1e-12, 1e6)] = 2e-3
    """Learning rate of Adam at the beginning."""
    final_learning_rate: Annotated[float, Range(0.0, 1e6)] = 4e-5
    """Learning rate of Adam at the end; the learning rate changes linearly."""
    gamma: Annotated[float, Range(0.0, 1.0)] = 0.995
    """Discount factor γ."""
    reward: RewardWeights = field(default_factory=RewardWeights)
    """Reward weights in training. Weights other than the default replace those of the scenarios' tasks."""
    reward_scale: Annotated[float, Range(1e-9, 1e9)] = 0.01
    """Factor on the rewards that the algorithm receives, for discounted returns of order one."""
    net_arch: tuple[int, ...] = (64, 64)
    """Widths of the hidden layers of actor and critic."""
    activation_fn: Literal["relu", "tanh", "elu"] = "relu"
    """Activation function of the hidden layers."""
    input_scales: Annotated[tuple[float, ...], Range(1e-6, 1e6)] = ()
    """Scales s₁, s₂, … of the inputs x of actor and critic, which also receive tanh(s₁ x), tanh(s₂ x), …: large scales
    resolve small errors. From 1e-6 to 1e6. Empty for x alone."""
    sde_sample_freq: Annotated[int, Range(0, 1e9)] = 0
    """Steps between two samples of the noise of gSDE (state-dependent exploration); 0 disables gSDE."""
    save_freq: Annotated[int, Range(1, 1e12)] = 1_000_000
    """Timesteps between two checkpoints; all sub-environments begin new episodes at a checkpoint."""
    eval_freq: Annotated[int, Range(0, 1e12)] = 0
    """Timesteps between two evaluations in the training scenarios; 0 for no evaluations."""
    n_eval_episodes: Annotated[int, Range(1, 100_000)] = 32
    """Episodes of each scenario in an evaluation."""
    patience: Annotated[int, Range(0, 1e9)] = 0
    """Number of evaluations without a better score after which training stops; 0 for no early stopping."""
    num_threads: Annotated[int, Range(1, 1024)] = 1
    """Threads of PyTorch. Two are faster on two idle cores, and many times slower on busy cores."""
    ppo: PpoSettings = field(default_factory=PpoSettings)
    """Settings of PPO only."""
    sac: SacSettings = field(default_factory=SacSettings)
    """Settings of SAC and TQC only."""
    apg: ApgSettings = field(default_factory=ApgSettings)
    """Settings of APG only."""

    def __post_init__(self) -> None:
        if not isinstance(self.start_from, str):
            raise TypeError(f"start_from must be the name or the path of a policy, not {self.start_from!r}")
        for name, kind in _TABLES.items():
            object.__setattr__(self, name, from_plain(kind, getattr(self, name), name))
        for name in ("scenarios", "curriculum"):
            object.__setattr__(self, name, _scenarios(getattr(self, name), name))
        if not isinstance(self.net_arch, tuple | list):
            raise TypeError(f"net_arch must be a list of widths, not {self.net_arch!r}")
        object.__setattr__(self, "net_arch", tuple(self.net_arch))
        object.__setattr__(self, "input_scales", tuple(self.input_scales))
        check_fields(self)
        if len(self.net_arch) > _MOST_LAYERS:
            raise ValueError(f"net_arch must have at most {_MOST_LAYERS} layers, not {len(self.net_arch)}")
        for i, width in enumerate(self.net_arch):
            check_int(width, f"net_arch[{i}]", 1, _WIDEST_LAYER)
        for name in ("learning_rate", "reward_scale"):
            object.__setattr__(self, name, float(getattr(self, name)))
        for name, known in (("algo", ALGORITHMS), ("activation_fn", tuple(ACTIVATIONS))):
            _check_choice(getattr(self, name), name, known)
        self._check_combination()

    def _check_combination(self) -> None:
        if not self.scenarios:
            raise ValueError("scenarios must name at least one scenario")
        for scenarios in (self.scenarios, *((item,) for item in self.curriculum)):
            if self.num_envs % len(expand_sets(scenarios)):
                raise ValueError(
                    f"num_envs must be a multiple of the number of scenarios, {len(expand_sets(scenarios))},"
                    f" not {self.num_envs}"
                )
        for table, algorithms in _ALGORITHMS_OF.items():
            if self.algo not in algorithms and getattr(self, table) != _TABLES[table]():
                raise ValueError(
                    f"the settings in {table} are for algo {' and '.join(algorithms)} only: they must be left out with"
                    f" algo {self.algo!r}"
                )
        if bool(self.curriculum) != bool(self.curriculum_steps):
            raise ValueError("curriculum and curriculum_steps must be given together or not at all")
        self._check_action_repeat()
        if self.start_from and self.hybrid.imitation_timesteps:
            raise ValueError("imitation_timesteps must be 0 with start_from, which replaces the imitation")
        if self.hybrid.baseline_relative_reward and self.gamma == 1.0:
            raise ValueError("baseline_relative_reward needs a gamma below 1")
        if self.patience and not self.eval_freq:
            raise ValueError("patience needs eval_freq")
        if self.algo == "ppo" and self.num_envs * self.ppo.n_steps > _MOST_SAMPLES:
            raise ValueError(
                f"num_envs * ppo.n_steps must be at most {_MOST_SAMPLES}, since a sample needs 0.2 kB of memory,"
                f" not {self.num_envs * self.ppo.n_steps}"
            )
        if self.algo == "ppo" and self.num_envs * self.ppo.n_steps % self.batch_size:
            raise ValueError(
                f"batch_size must divide num_envs * ppo.n_steps = {self.num_envs * self.ppo.n_steps},"
                f" not be {self.batch_size}"
            )

    def _check_action_repeat(self) -> None:
        repeat = self.hybrid.action_repeat
        if self.max_episode_steps % repeat:
            raise ValueError(f"action_repeat must divide max_episode_steps = {self.max_episode_steps}, not be {repeat}")
        for name in () if self.max_episode_steps else expand_sets((*self.curriculum, *self.scenarios)):
            if (steps := find_scenario(name).steps) % repeat:
                raise ValueError(f"action_repeat must divide the {steps} control steps of an episode, not be {repeat}")

    def rollout_timesteps(self) -> int:
        """Return the timesteps of a rollout, after which the networks are trained."""
        steps = {"ppo": self.ppo.n_steps, "apg": self.apg.window}.get(self.algo, self.sde_sample_freq or 1)
        return steps * self.num_envs

    def policy_interface(self) -> dict[str, Any]:
        """Return the fields of a policy's card that say what the policy observes and how its action is applied."""
        return {
            "hybrid": self.hybrid.as_data(),
            "action_repeat": self.hybrid.action_repeat,
            "history": self.history,
            "history_actions": self.history_actions,
        }


_TABLES: dict[str, Any] = {
    "hybrid": HybridSettings,
    "ppo": PpoSettings,
    "sac": SacSettings,
    "apg": ApgSettings,
    "reward": RewardWeights,
}


def _check_choice(value: Any, name: str, known: tuple[str, ...]) -> None:
    if value not in known:
        raise ValueError(
            f"{name} must be one of {', '.join(filter(None, known))}, not {value!r}{suggest(value, known)}"
        )


def _scenarios(value: Any, name: str) -> tuple[str, ...]:
    items = (value,) if isinstance(value, str | dict) else value
    try:
        items = [json.dumps(item, default=str) if isinstance(item, dict) else item for item in items]
        for item in items:
            if (base := split_changes(item)[0]) in HELD_OUT:
                raise ValueError(f"{name} cannot be {base!r}, which is held out: use 'training' or single scenarios")
        return tuple(item for given in items for item in names_without_files(given))
    except (TypeError, AttributeError) as error:
        raise TypeError(f"{name} must be one scenario or a list of scenarios, not {value!r}: {error}") from error


def read_settings(name: str) -> TrainSettings:
    """Read training settings; a setting that is missing in the file has its default value.

    Args:
        name: The name of a preset (``"ppo"``), the path of a TOML or JSON file, such as the ``settings.json`` of a
            run, or the path of a policy file, whose card has the settings of its training.

    Raises:
        TypeError: If a setting has the wrong type.
        ValueError: If the file does not exist, or has an unknown setting or a value out of range.
    """
    path = PRESETS / f"{name}.toml"
    if not path.is_file():
        path = Path(name)
    if path.suffix == ".npz":
        card = MlpPolicy.load(path).card
        if "settings" not in card:
            raise ValueError(f"the card of {path} has no settings")
        return settings_of_card(card, str(path))
    if not path.is_file():
        known = sorted(item.stem for item in PRESETS.glob("*.toml"))
        raise ValueError(
            f"settings must be the path of a file or one of {', '.join(known)}, not {name!r}{suggest(name, known)}"
        )
    return from_mapping(read_mapping(path), str(path))


def from_mapping(values: dict[str, Any], source: str) -> TrainSettings:
    """Return training settings from a mapping; a setting that is missing has its default value.

    Args:
        values: Settings by name, some or all.
        source: Where the settings come from, for error messages.

    Raises:
        TypeError: If a setting has the wrong type.
        ValueError: If a name is unknown or a value out of range.
    """
    for name, kind in {"": TrainSettings, **_TABLES}.items():
        known = [item.name for item in fields(kind)]
        table = values.get(name, {}) if name else values
        if not isinstance(table, dict):
            raise TypeError(f"{name} must be a mapping, not {table!r}")
        if unknown := [key for key in table if key not in known]:
            raise ValueError(
                f"{source} sets {unknown[0]!r}, which is not a setting{suggest(unknown[0], known)}; the settings are"
                f" {', '.join(known)}"
            )
    return TrainSettings(**values)


def settings_of_card(card: Mapping[str, Any], name: str) -> TrainSettings:
    """Return the settings with which a policy was trained.

    Older cards also have the tables of other algorithms, which are left out: their defaults may have changed.

    Args:
        card: The card of the policy, which has settings.
        name: Name of the policy, for error messages.

    Raises:
        TypeError: If a setting has the wrong type.
        ValueError: If a setting is unknown or out of range.
    """
    settings = card["settings"]
    return from_mapping(_used(settings, settings.get("algo", TrainSettings.algo)), f"the card of {name}")


def to_mapping(settings: TrainSettings) -> dict[str, Any]:
    """Return the settings that the algorithm of `settings` uses as plain data."""
    return _used(asdict(settings), settings.algo)


def _used(values: Mapping[str, Any], algo: str) -> dict[str, Any]:
    """Return the settings without the tables of other algorithms."""
    return {name: value for name, value in values.items() if algo in _ALGORITHMS_OF.get(name, (algo,))}
