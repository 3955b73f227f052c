"""Training settings: their declaration, and functions that read them from files.

A settings file changes the defaults of `TrainSettings`. The table that has the name of the algorithm contains keyword
arguments of its class in Stable-Baselines3 or sb3-contrib, see `quadpend_train.training.arguments`:

    algo = "ppo"
    scenarios = ["windy"]
    total_timesteps = 3_000_000

    [ppo]
    learning_rate = { initial = 2e-3, final = 4e-5 }
    policy_kwargs = { net_arch = [128, 128], log_std_init = -1.0 }
"""

import json
from collections.abc import Mapping
from dataclasses import field, replace
from itertools import takewhile
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from tyro.constructors import PrimitiveConstructorSpec

from quadpend_gym import RewardWeights
from quadpend_gym.core.files import read_mapping
from quadpend_gym.core.models import to_plain_data
from quadpend_gym.core.nested import changed
from quadpend_gym.core.settings import Parsed, Range, parse, settings, suggest
from quadpend_gym.scenarios import SCENARIOS, Scenario, find_scenarios, refuse_held_out, scenario_data
from quadpend_gym.tasks.task import TASKS
from quadpend_gym.vehicles import VEHICLES
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.training import arguments as sb3

PRESETS = Path(__file__).with_name("presets")
ALONE = "estimate_only", "memory_only", "lab_only"  # modes in which the policy acts alone
_INPUTS = "situation", "deviations", "innovations"
_GONE = {"action_repeat": 1, "fallback_gain": 0.0}  # settings of a hybrid on older cards, with the value that remains


@settings
class HybridSettings:
    """Settings of a hybrid: a learned policy combined with a classical base controller."""

    base_controller: str = ""
    """Name of the base controller; empty for a policy without a base controller."""
    mode: Literal["estimate_only", "memory_only", "lab_only", "residual_action"] = "estimate_only"
    """Use of the policy's action. estimate_only: alone, on the base controller's estimates; memory_only: alone, on a
    memory of the measured errors; lab_only: added to the linear feedback of a memory of the observation lab;
    residual_action: added to the base controller's."""
    situation: bool = False
    """Also observe noise and wind of the last second, with estimate_only."""
    deviations: bool = False
    """Observe deviations of the estimates from the trajectory that follows the reference, with estimate_only and
    lqg."""
    innovations: bool = False
    """Also observe filtered innovations of the observer, a memory, with estimate_only."""
    action_scale: Annotated[float, Range(1e-6, 3.0)] = 1.0
    """Factor κ on the policy's action, with residual_action."""
    baseline_relative_reward: bool = False
    """Subtract the reward that the base controller alone earns in a copy of the same episode."""
    failure_penalty: Annotated[float, Range(0.0, 1e6)] = 0.0
    """Penalty for a fall with a baseline-relative reward, in rewards of steps of 0.01 s."""
    imitation_timesteps: Annotated[int, Range(0, 1e12)] = 0
    """Timesteps of imitation of the base controller (DAgger) before training."""
    imitation_rounds: Annotated[int, Range(1, 1000)] = 10
    """Rounds of the imitation, each a flight and a fit."""

    def __post_init__(self) -> None:
        alone = self.mode in ALONE
        observed = any(getattr(self, name) for name in _INPUTS)
        used = observed or self.imitation_timesteps or self.baseline_relative_reward
        if not self.base_controller and (self.mode != "estimate_only" or used):
            raise ValueError("a hybrid needs a base_controller")
        if observed and self.mode != "estimate_only":
            raise ValueError("situation, deviations and innovations need the mode 'estimate_only'")
        if self.imitation_timesteps and not alone:
            raise ValueError(f"imitation_timesteps needs a mode of {', '.join(ALONE)}")
        if self.failure_penalty and not self.baseline_relative_reward:
            raise ValueError("failure_penalty needs baseline_relative_reward")

    def as_data(self) -> dict[str, Any] | None:
        """Return the data from which `hybrid_from_data` makes the hybrid; None without a base controller."""
        if not self.base_controller:
            return None
        data = {"kind": self.mode, "base_controller": self.base_controller}
        if self.mode in ALONE:
            return data | {name: True for name in _INPUTS if getattr(self, name)}
        return {**data, "action_scale": self.action_scale}


@settings
class ApgSettings:
    """Settings of APG only; its module explains the cost."""

    learning_rate: Annotated[float, Range(1e-12, 1e6)] = 2e-3
    """Learning rate of Adam at the beginning."""
    final_learning_rate: Annotated[float, Range(0.0, 1e6)] = 4e-5
    """Learning rate of Adam at the end; the learning rate changes linearly."""
    net_arch: Annotated[tuple[int, ...], Range(1, 8192)] = (64, 64)
    """Widths of the hidden layers."""
    activation_fn: Literal["relu", "tanh", "elu"] = "relu"
    """Activation function of the hidden layers."""
    window: Annotated[int, Range(1, 10_000)] = 100
    """Control steps through which gradients are propagated; one gradient step per window."""
    restart: Annotated[float, Range(0.0, 1.0)] = 0.5
    """Share of the sub-environments that begin a new episode with each window."""
    rmse: Annotated[float, Range(0.0, 1e6, "1/m")] = 6.0
    """Weight w_R of the RMSE, 1/m."""
    log_rmse: Annotated[float, Range(0.0, 1e6)] = 0.0
    """Weight w_L of the logarithm of a row's error."""
    error: Annotated[float, Range(0.0, 1e6, "1/m")] = 0.1
    """Weight w₁ of the tracking error, 1/m."""
    yaw: Annotated[float, Range(0.0, 1e6, "1/rad²")] = 0.1
    """Weight w_ψ of the squared yaw error, 1/rad²."""
    effort: Annotated[float, Range(0.0, 1e6)] = 1e-3
    """Weight w_a of the squared actions."""
    rate: Annotated[float, Range(0.0, 1e6, "s²/rad²")] = 1e-4
    """Weight w_ω of the squared Euler-angle rates, s²/rad²."""
    lean: Annotated[float, Range(0.0, 1e6)] = 100.0
    """Weight w_l of coming near the limits of an episode."""
    max_grad_norm: Annotated[float, Range(1e-9, 1e9)] = 1.0
    """Largest norm of the gradient of a step."""
    max_state_gradient: Annotated[float, Range(1e-9, 1e12)] = 3000.0
    """Largest norm of the gradient of a row's cost with respect to its state at one step."""


def training_scenarios(given: Any) -> tuple[Scenario, ...]:
    """Return scenarios to train in from one or several, each a `Scenario`, a text or a mapping of its fields."""
    items = [given] if isinstance(given, str | Mapping | Scenario) else given
    refuse_held_out(items)
    if not (found := find_scenarios(items)):
        raise ValueError("scenarios must name at least one scenario")
    return tuple(scenario if scenario.name else replace(scenario, name=name) for name, scenario in found.items())


def scenario_text(scenario: Scenario) -> str:
    """Return the text from which `find_scenario` makes a scenario again."""
    data = _data(scenario)
    return data if isinstance(data, str) else json.dumps(data, ensure_ascii=False)


def _data(scenario: Scenario) -> Any:
    """Return a scenario as in a settings file: its name, or the fields that are not the default ones."""
    if scenario == SCENARIOS.get(scenario.name):
        return scenario.name
    to_plain_data(scenario, _refuse)
    default = scenario_data(Scenario())
    data = {name: value for name, value in scenario_data(scenario).items() if value != default[name]}
    presets: dict[str, Mapping[str, Any]] = {"vehicle": VEHICLES, "task": TASKS}
    for part in presets.keys() & data.keys():
        data[part] = next((n for n, item in presets[part].items() if item == getattr(scenario, part)), data[part])
    return data


def _refuse(model: Any) -> Any:
    raise ValueError(f"a settings file cannot describe {model!r}: give the models of a scenario as 'module:factory'")


_SCENARIOS = PrimitiveConstructorSpec[Any](
    nargs="*",
    metavar="[SCENARIO [SCENARIO ...]]",
    instance_from_str=tuple,
    is_instance=lambda instance: isinstance(instance, tuple),
    str_from_instance=lambda scenarios: [scenario.name or "…" for scenario in scenarios],
)


@settings
class TrainSettings:
    """All settings of a training run.

    Timesteps are steps of the vector environment times its number of sub-environments, as in Stable-Baselines3.
    """

    algo: str = "ppo"
    """Algorithm: apg (analytic policy gradients), or ppo, sac, tqc, td3, a2c, trpo and others of Stable-Baselines3 and
    sb3-contrib."""
    scenarios: Annotated[Any, Parsed(training_scenarios, lambda: Any), _SCENARIOS] = field(
        default_factory=lambda: training_scenarios("windy")
    )
    """Scenarios to train in, with equal numbers of rows: names, sets, TOML or JSON files, or JSON."""
    total_timesteps: Annotated[int, Range(1, 1e12)] = 7_000_000
    """Timesteps of the whole training."""
    start_from: str = ""
    """Learned policy whose network training starts from: a name, a run folder, or a file (.npz or .zip). Network,
    hybrid and interface must be those of the settings; a network of the true state also starts one of estimates,
    whose further inputs begin without weight."""
    max_seconds: Annotated[float, Range(0.0, 1e9, "s")] = 0.0
    """Wall-clock seconds after which imitation and training stop, counted anew when resumed; 0: no limit."""
    seed: Annotated[int, Range(0, 2**31 - 1)] = 0
    """Seed of the networks and the episodes."""
    num_envs: Annotated[int, Range(1, 100_000)] = 256
    """Number of sub-environments (rows)."""
    max_episode_steps: Annotated[int, Range(0, 10_000_000)] = 0
    """Control steps after which an episode is truncated; 0: the duration of the scenario."""
    hybrid: HybridSettings = field(default_factory=HybridSettings)
    """Settings of a hybrid."""
    reward: RewardWeights = field(default_factory=RewardWeights)
    """Weights of the reward in place of those of the scenarios' tasks."""
    reward_scale: Annotated[float, Range(1e-9, 1e9)] = 0.01
    """Factor on the rewards, for discounted returns of order one."""
    input_scales: Annotated[tuple[float, ...], Range(1e-6, 1e6)] = ()
    """Scales s₁, s₂, … of further inputs tanh(s₁ x), tanh(s₂ x), … beside x: large scales resolve small errors."""
    critic_warmup_steps: Annotated[int, Range(0, 1e12)] = 0
    """First timesteps in which an on-policy algorithm trains the critic alone, for policies that start well."""
    save_freq: Annotated[int, Range(1, 1e12)] = 1_000_000
    """Timesteps between two checkpoints."""
    eval_freq: Annotated[int, Range(0, 1e12)] = 0
    """Timesteps between two evaluations in the training scenarios; 0: none."""
    n_eval_episodes: Annotated[int, Range(1, 100_000)] = 32
    """Episodes of each scenario in an evaluation."""
    num_threads: Annotated[int, Range(1, 1024)] = 1
    """Threads of PyTorch; several are slow on busy cores."""
    apg: ApgSettings = field(default_factory=ApgSettings)
    """Settings of APG only."""
    arguments: Annotated[dict[str, Any], tyro.conf.Suppress] = field(default_factory=dict)
    """Keyword arguments of the algorithm's class, in files the table with the name of the algorithm."""

    def __post_init__(self) -> None:
        if self.algo != "apg":
            object.__setattr__(self, "arguments", sb3.complete(self.algo, self.arguments))
            if self.apg != ApgSettings():
                raise ValueError(f"the settings in apg are for algo 'apg' only, not {self.algo!r}")
            if self.critic_warmup_steps and self.argument("train_freq") is not None:
                raise ValueError(f"critic_warmup_steps needs an on-policy algorithm, not {self.algo!r}")
        elif self.hybrid.baseline_relative_reward:
            raise ValueError("baseline_relative_reward must be False with algo 'apg', not True")
        if self.num_envs % (count := len(self.scenarios)):
            raise ValueError(f"num_envs must be a multiple of the number of scenarios, {count}, not {self.num_envs}")
        if self.start_from and self.hybrid.imitation_timesteps:
            raise ValueError("imitation_timesteps must be 0 with start_from, which replaces the imitation")

    def argument(self, name: str) -> Any:
        """Return an argument of the algorithm: as given, or the default of its class; None if it has no such one."""
        return self.arguments[name] if name in self.arguments else sb3.default(self.algo, name)

    def policy_interface(self) -> dict[str, Any]:
        """Return the fields of a policy's card that say what the policy observes and how its action is applied."""
        return {"hybrid": self.hybrid.as_data()}


def presets() -> dict[str, str]:
    """Return the comments at the beginning of the presets, by name."""
    texts = {path.stem: path.read_text(encoding="utf-8") for path in sorted(PRESETS.glob("*.toml"))}
    comments = {name: takewhile(lambda line: line.startswith("#"), text.splitlines()) for name, text in texts.items()}
    return {name: " ".join(line.strip("# ") for line in lines) for name, lines in comments.items()}


def read_settings(name: str) -> TrainSettings:
    """Read the training settings in a preset (``"ppo"``), in a TOML or JSON file, or on the card of a policy file."""
    path = PRESETS / f"{name}.toml"
    path = path if path.is_file() else Path(name)
    if path.suffix == ".npz":
        return settings_of_card(MlpPolicy.load(path).card, str(path))
    if not path.is_file():
        known = list(presets())
        raise ValueError(
            f"settings must be the path of a file or one of {', '.join(known)}, not {name!r}{suggest(name, known)}"
        )
    return from_mapping(read_mapping(path), str(path))


def settings_of_card(card: Mapping[str, Any], name: str) -> TrainSettings:
    """Return the settings with which the policy `name` was trained, from its card."""
    if "settings" not in card:
        raise ValueError(f"the card of {name} has no settings: the policy was exported, or a script trained it")
    return from_mapping(card["settings"], f"the card of {name}")


def from_mapping(values: Mapping[str, Any], source: str) -> TrainSettings:
    """Return training settings from a mapping, as `read_settings`; messages about errors name the source."""
    given = dict(values)
    if "arguments" in given:
        raise ValueError(f"{source} has no field 'arguments': those of the algorithm are in the table of its name")
    if (algo := given.get("algo", "ppo")) != "apg":
        given["arguments"] = given.pop(algo, {})
    if isinstance(hybrid := given.get("hybrid"), Mapping):
        given["hybrid"] = {name: value for name, value in hybrid.items() if _GONE.get(name) != value}
    return parse(TrainSettings, given, source)


def to_mapping(settings: TrainSettings) -> dict[str, Any]:
    """Return settings as plain data, as in a settings file."""
    return {**_tables(settings), "scenarios": [_data(scenario) for scenario in settings.scenarios]}


def _tables(settings: TrainSettings) -> dict[str, Any]:
    """Return the fields of a settings file, with scenarios as objects."""
    names = {name: name for name in vars(settings) if name not in ("arguments", "apg")}
    names[settings.algo] = "apg" if settings.algo == "apg" else "arguments"
    fields = {name: getattr(settings, field) for name, field in names.items()}
    return {name: value if name == "scenarios" else to_plain_data(value, _itself) for name, value in fields.items()}


def _itself(value: Any) -> Any:
    return value


def with_values(settings: TrainSettings, values: Mapping[str, Any]) -> TrainSettings:
    """Return settings with other values, by paths such as ``ppo.learning_rate`` or ``num_envs``."""
    return from_mapping(changed(_tables(settings), values), "the given values")
