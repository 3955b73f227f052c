"""Training settings: dataclasses with every default, and files with what a run does differently."""

import json
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Literal

from quadpend_baselines import CONTROLLERS
from quadpend_baselines.hybrid.companion import STEERS
from quadpend_gym import RewardWeights
from quadpend_gym.core.validation import check_int, check_number, check_positive, from_plain
from quadpend_train.common.files import read_mapping
from quadpend_train.policies.mlp_policy import ACTIVATIONS, VIEW, MlpPolicy
from quadpend_train.scenarios import SETS, expand, resolve

FOLDER = Path(__file__).with_name("presets")
ACTIVATIONS = tuple(ACTIVATIONS)
ALGORITHMS = ("ppo", "sac", "tqc")


@dataclass(frozen=True)
class PpoSettings:
    """What only PPO has."""

    n_steps: int = 64
    """Steps of each row between two updates."""
    n_epochs: int = 3
    """Passes over a rollout."""
    gae_lambda: float = 0.95
    """λ of the generalised advantage estimate."""
    clip_range: float = 0.2
    """Of the ratio of new and old policy."""
    ent_coef: float = 0.0
    """Of the entropy bonus."""
    log_std_init: float = 0.0
    """Logarithm of the action noise at the beginning."""
    critic_warmup_steps: int = 0
    """Environment steps at the beginning in which only the critic learns, for policies that begin well."""

    def __post_init__(self) -> None:
        for name in ("n_steps", "n_epochs"):
            check_int(getattr(self, name), name, 1)
        check_int(self.critic_warmup_steps, "critic_warmup_steps", 0)
        check_number(self.gae_lambda, "gae_lambda", 0.0, 1.0)
        check_positive(self.clip_range, "clip_range")
        check_number(self.ent_coef, "ent_coef", 0.0)
        check_number(self.log_std_init, "log_std_init")


@dataclass(frozen=True)
class SacSettings:
    """What only SAC and TQC have."""

    gradient_steps: int = 4
    """Gradient steps after each step of all rows."""
    buffer_size: int = 300_000
    """Transitions that are remembered."""
    learning_starts: int = 10_000
    """Environment steps with random actions before learning begins."""
    tau: float = 0.005
    """Share of the critic that its slow copy takes over in a gradient step."""
    ent_coef_init: float = 0.1
    """Weight of the entropy at the beginning; it is learned."""
    target_entropy: float = -4.0
    """Of the policy, which that weight is learned for."""

    def __post_init__(self) -> None:
        for name in ("gradient_steps", "buffer_size", "learning_starts"):
            check_int(getattr(self, name), name, 1)
        check_number(self.tau, "tau", 0.0, 1.0)
        check_positive(self.ent_coef_init, "ent_coef_init")
        check_number(self.target_entropy, "target_entropy")


@dataclass(frozen=True)
class TrainSettings:
    """Everything that decides how a policy is trained.

    Raises:
        ValueError: a setting is unknown or out of range.
    """

    algo: Literal["ppo", "sac", "tqc"] = "ppo"
    """The algorithm; TQC is sb3-contrib's."""
    scenario: tuple[str, ...] = ("windy",)
    """Scenarios to train in, which share the rows: names, sets of them, TOML or JSON files, or JSON, see
    `quadpend_train.scenarios`."""
    curriculum: tuple[str, ...] = ()
    """Scenarios to train in before, one after the other, for equal shares of `curriculum_steps`."""
    curriculum_steps: int = 0
    """Environment steps that the curriculum takes."""
    total_timesteps: int = 7_000_000
    """Environment steps to train for."""
    max_seconds: float = 0.0
    """Wall-clock seconds after which a run, or its resumption, ends at the latest; 0: no such limit."""
    seed: int = 0
    """Of the networks and the episodes."""
    num_envs: int = 256
    """Rows of the vector environment."""
    max_episode_steps: int = 1000
    """Control steps after which an episode is truncated while training."""
    companion: str = ""
    """Classical controller that flies along, see `quadpend_baselines.hybrid.companion`; none without."""
    steers: Literal["alone", "action", "pace"] = "alone"
    """What the learner does beside its companion: act alone, correct its action, or set its bandwidths."""
    authority: float = 1.0
    """How much a correction or a pace counts, κ."""
    caution: float = 0.0
    """How soon a learner that steers is trusted less, γ of equation (4) of `quadpend_baselines.hybrid.companion`."""
    hold: int = 1
    """Control steps that an action is held, where the learner steers. But for this and `max_episode_steps`, steps count the
    learner's decisions."""
    paired: bool = False
    """Whether the reward is relative to what the companion alone earns in the same episode, see `quadpend_train.envs.baseline_relative`."""
    failure_penalty: float = 0.0
    """What a fall takes off a paired reward besides: an RMSE counts it as 1 m, the reward as what is not earned."""
    history: int = 1
    """Observations that the learner sees side by side."""
    history_actions: int = 0
    """Its own latest actions beside them."""
    imitation_steps: int = 0
    """Environment steps before all others in which the policy imitates its companion."""
    batch_size: int = 1024
    """Samples in a gradient step."""
    learning_rate: float = 2e-3
    """Of Adam, at the beginning."""
    final_learning_rate: float = 4e-5
    """Of Adam, at the end; it falls linearly."""
    gamma: float = 0.995
    """γ."""
    reward: RewardWeights = field(default_factory=RewardWeights)
    """What the learner is rewarded for, instead of the task's weights; see `quadpend_gym.tasks.rewards`."""
    reward_scale: float = 0.01
    """Factor on the rewards that the learner sees, so that returns are of order one."""
    net_arch: tuple[int, ...] = (64, 64)
    """Widths of the hidden layers of policy and critic."""
    activation_fn: Literal["relu", "tanh", "elu"] = "relu"
    """Between the layers."""
    sde_sample_freq: int = 0
    """Steps that an exploration lasts, which depends on the state (gSDE); 0: noise that is new at every step."""
    save_freq: int = 1_000_000
    """Environment steps between two checkpoints, at which all rows begin new episodes."""
    eval_freq: int = 0
    """Environment steps between two evaluations in the training scenarios; 0: none."""
    n_eval_episodes: int = 32
    """Episodes of each scenario in an evaluation."""
    patience: int = 0
    """Evaluations without a better score after which training ends; 0: never."""
    torch_threads: int = 1
    """Of torch. Two are faster on two idle cores, and many times slower on busy ones."""
    ppo: PpoSettings = field(default_factory=PpoSettings)
    """Of PPO alone."""
    sac: SacSettings = field(default_factory=SacSettings)
    """Of SAC and TQC alone."""

    def __post_init__(self) -> None:
        for name, kind in (("ppo", PpoSettings), ("sac", SacSettings), ("reward", RewardWeights)):
            object.__setattr__(self, name, from_plain(kind, getattr(self, name), name))
        for name in ("scenario", "curriculum"):
            object.__setattr__(self, name, _scenarios(getattr(self, name), name))
        if not isinstance(self.net_arch, tuple | list):
            raise TypeError(f"net_arch must be widths, not {self.net_arch!r}")
        object.__setattr__(self, "net_arch", tuple(self.net_arch))
        for name in ("total_timesteps", "num_envs", "max_episode_steps", "hold", "history", "batch_size", "save_freq"):
            check_int(getattr(self, name), name, 1)
        for name in ("n_eval_episodes", "torch_threads"):
            check_int(getattr(self, name), name, 1)
        for name in ("seed", "curriculum_steps", "history_actions", "imitation_steps", "sde_sample_freq"):
            check_int(getattr(self, name), name, 0)
        for name in ("eval_freq", "patience"):
            check_int(getattr(self, name), name, 0)
        for i, width in enumerate(self.net_arch):
            check_int(width, f"net_arch[{i}]", 1)
        for name in ("learning_rate", "reward_scale", "authority"):
            object.__setattr__(self, name, check_positive(getattr(self, name), name))
        object.__setattr__(self, "caution", float(check_number(self.caution, "caution", 0.0, 10.0)))
        check_number(self.gamma, "gamma", 0.0, 1.0)
        for name in ("max_seconds", "final_learning_rate", "failure_penalty"):
            check_number(getattr(self, name), name, 0.0)
        self._check_choices()
        self._check_together()

    def _check_choices(self) -> None:
        for name, known in (
            ("algo", ALGORITHMS),
            ("activation_fn", ACTIVATIONS),
            ("companion", ("", *CONTROLLERS)),
            ("steers", STEERS),
        ):
            if (value := getattr(self, name)) not in known:
                raise ValueError(f"{name} must be one of {', '.join(filter(None, known))}, not {value!r}")

    def _check_together(self) -> None:
        if not self.scenario:
            raise ValueError("scenario must name at least one")
        for scenarios in (self.scenario, *((item,) for item in self.curriculum)):
            if self.num_envs % len(expand(scenarios)):
                raise ValueError(
                    f"num_envs must be a multiple of the {len(expand(scenarios))} scenarios that share the rows, not"
                    f" {self.num_envs}"
                )
        if bool(self.curriculum) != bool(self.curriculum_steps):
            raise ValueError("curriculum and curriculum_steps belong together: give both or neither")
        if (self.steers != "alone" or self.imitation_steps) and not self.companion:
            raise ValueError("a learner that steers or imitates needs a companion")
        if self.steers != "alone" and self.imitation_steps:
            raise ValueError("a learner that steers its companion cannot imitate it: give no imitation_steps")
        if self.hold > 1 and self.steers == "alone":
            raise ValueError("only a learner that steers its companion can hold its action")
        if self.caution and self.steers == "alone":
            raise ValueError("only a learner that steers its companion can be met with caution")
        if self.max_episode_steps % self.hold:
            raise ValueError(f"hold must divide max_episode_steps = {self.max_episode_steps}, not be {self.hold}")
        if self.failure_penalty and not self.paired:
            raise ValueError("only a paired reward has a failure_penalty")
        if self.paired and not self.companion:
            raise ValueError("a paired reward needs a companion")
        if self.paired and self.gamma == 1.0:
            raise ValueError("a paired reward needs a gamma below 1")
        if self.patience and not self.eval_freq:
            raise ValueError("patience needs eval_freq")
        if self.algo == "ppo" and self.num_envs * self.ppo.n_steps % self.batch_size:
            raise ValueError(
                f"batch_size must divide num_envs * ppo.n_steps = {self.num_envs * self.ppo.n_steps},"
                f" not be {self.batch_size}"
            )

    def view(self) -> dict[str, Any]:
        """What the policy sees and what becomes of its action, as a `LearnedPolicy` needs to know it."""
        return {name: getattr(self, name) for name in VIEW}


def _scenarios(value: Any, name: str) -> tuple[str, ...]:
    items = (value,) if isinstance(value, str | dict) else value
    try:
        if "test" in items:
            raise ValueError(f"{name} cannot be 'test', which is held out: train in 'training', or in single scenarios")
        items = [json.dumps(item, default=str) if isinstance(item, dict) else item for item in items]
        return tuple(item for given in items for item in ([given] if given in SETS else [resolve(given)]))
    except (TypeError, AttributeError) as error:
        raise TypeError(f"{name} must be a scenario or several, not {value!r}: {error}") from error


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
    if path.suffix == ".npz":
        card = MlpPolicy.load(path).card
        if "settings" not in card:
            raise ValueError(f"the card of {path} has no settings")
        return from_mapping(card["settings"], f"the card of {path}")
    if not path.is_file():
        known = ", ".join(sorted(item.stem for item in FOLDER.glob("*.toml")))
        raise ValueError(f"there are no settings {name!r}; there are {known}, or give the path of a file")
    return from_mapping(read_mapping(path), str(path))


def from_mapping(values: dict[str, Any], source: str) -> TrainSettings:
    """The defaults, changed by `values`, which come from `source`.

    Raises:
        ValueError: a key is unknown or a value out of range.
    """
    for name, kind in (("", TrainSettings), ("ppo", PpoSettings), ("sac", SacSettings), ("reward", RewardWeights)):
        known = [item.name for item in fields(kind)]
        given = values if not name else values.get(name, {})
        if not isinstance(given, dict):
            raise TypeError(f"{name} must be a mapping, not {given!r}")
        if unknown := [key for key in given if key not in known]:
            raise ValueError(f"{source} sets {unknown[0]!r}, which is no setting; the settings are {', '.join(known)}")
    return TrainSettings(**values)


def to_mapping(settings: TrainSettings) -> dict[str, Any]:
    """All settings as plain data."""
    return asdict(settings)
