"""Golden hashes of results, to check that a refactoring changes no number.

`make golden` runs this file as ``python -m benchmarks.golden``. It hashes environments, episodes of every controller
and of one seed of each shipped policy, and brief trainings. Run it before and after a refactoring: the first run writes
the hashes to a file, the second compares with them and exits with status 1 if one differs. The hashes cover every bit
of every floating-point number, so compare them only on the machine and with the package versions that wrote the file.
"""

import argparse
import hashlib
import json
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from quadpend_baselines import CONTROLLERS
from quadpend_gym import wrappers
from quadpend_gym.actuators import ActionDelay, MotorLag, RateLimit
from quadpend_gym.randomization import Around
from quadpend_gym.sensors import Delay, Dropout, Noise
from quadpend_train.evaluation.episodes import TEST_SEED, run_episodes
from quadpend_train.policies.loading import load_policy, shipped_policies
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.training.settings import from_mapping
from quadpend_train.training.train import train

Hashes = Iterator[tuple[str, str]]  # names and hashes

ENV_IDS = ("quadpend_gym:QuadPendulum-v0", "quadpend_gym:QuadPendulumHover-v0")
WINDS = ("calm", "breeze", "windy", "storm", "paper")
NOISE = Noise(
    position={"white": 0.001, "bias": 0.002, "walk": 0.001}, velocity=0.01, direction=0.001, euler={"quantum": 0.001}
)
# Wrappers by the name of their stack, the innermost first; "Vector" is put before each name for a vector environment.
STACKS: dict[str, tuple[tuple[Any, ...], ...]] = {
    "plain": (),
    "sensors": (("SensorWrapper", [NOISE, Delay(2), Dropout(0.2)]),),
    "actuators": (("ActuatorWrapper", [ActionDelay(1), MotorLag(0.02), RateLimit(30.0)]),),
    "parameters": (("ParameterWrapper", Around(0.2)),),
    "output feedback": (("OutputFeedbackWrapper",), ("HistoryWrapper", 3, 2)),
}
STACKS["everything"] = tuple(layer for stack in list(STACKS.values()) for layer in stack)

SCENARIOS = ("windy", "lagged", "output_feedback", "storm")

BRIEF: dict[str, Any] = {
    "scenarios": ["windy"],
    "total_timesteps": 1024,
    "num_envs": 16,
    "batch_size": 128,
    "net_arch": [16],
    "n_eval_episodes": 2,
}
# Tables of settings of the algorithms
ALGORITHMS: dict[str, dict[str, Any]] = {
    "ppo": {"ppo": {"n_steps": 16, "n_epochs": 2}},
    "sac": {"sac": {"gradient_steps": 1, "buffer_size": 1024, "learning_starts": 64}},
}
# Settings in which each training differs from `BRIEF`.
TRAININGS: dict[str, dict[str, Any]] = {
    "ppo": {},
    "ppo with evaluations": {"eval_freq": 256, "patience": 3, "scenarios": ["breeze", "storm"]},
    "ppo with gSDE": {"activation_fn": "tanh", "sde_sample_freq": 4, "reward": {"tip": 0.2}},
    "ppo with a curriculum": {"curriculum": ["calm", "breeze"], "curriculum_steps": 512, "save_freq": 256},
    "ppo on estimates": {"hybrid": {"base_controller": "adrc-matched"}, "history": 2, "history_actions": 1},
    "ppo after imitation": {"hybrid": {"base_controller": "flatness", "imitation_timesteps": 640}},
    "ppo with residual actions": {
        "hybrid": {
            "base_controller": "flatness",
            "mode": "residual_action",
            "action_scale": 0.3,
            "fallback_gain": 1.0,
            "baseline_relative_reward": True,
            "failure_penalty": 3.0,
        }
    },
    "ppo with bandwidth scheduling": {
        "hybrid": {
            "base_controller": "flatness",
            "mode": "bandwidth_scheduling",
            "fallback_gain": 3.0,
            "action_repeat": 5,
            "baseline_relative_reward": True,
        },
        "max_episode_steps": 20,
        "ppo": {"n_steps": 16, "n_epochs": 2, "critic_warmup_steps": 256},
    },
    "sac": {"algo": "sac", "total_timesteps": 512, "batch_size": 32},
    "tqc": {"algo": "tqc", "total_timesteps": 512, "batch_size": 32},
}


def digest(value: Any) -> str:
    """Return a hash of arrays, numbers, and mappings and sequences of them."""
    sha = hashlib.sha256()
    _update(sha, value)
    return sha.hexdigest()[:24]


def _update(sha: Any, value: Any) -> None:
    if isinstance(value, dict):
        for key in sorted(value):
            sha.update(key.encode())
            _update(sha, value[key])
    elif isinstance(value, list | tuple) or (isinstance(value, np.ndarray) and value.dtype == object):
        for item in value:
            _update(sha, item)
    elif value is None:
        sha.update(b"none")
    else:
        array = np.ascontiguousarray(value)
        sha.update(f"{array.dtype}{array.shape}".encode())
        sha.update(array.tobytes())


def environments(
    env_ids: Sequence[str] = ENV_IDS, winds: Sequence[str] = WINDS, steps: int = 400, num_envs: int = 70
) -> Hashes:
    """Hash what single and vector environments return, in every wind and behind every stack of wrappers.

    Args:
        env_ids: Environments.
        winds: Presets of wind.
        steps: Steps of each environment.
        num_envs: Sub-environments of a vector environment.
    """
    for env_id in env_ids:
        for wind in winds:
            for name, stack in STACKS.items():
                for mode in ("SameStep", "NextStep"):
                    vector = gym.make_vec(env_id, num_envs=num_envs, wind=wind, autoreset_mode=mode)
                    yield (
                        f"{env_id}, {wind}, {name}, {mode}",
                        digest(_vector_steps(_wrap(vector, stack, "Vector"), steps)),
                    )
                yield (
                    f"{env_id}, {wind}, {name}, single",
                    digest(_steps(_wrap(gym.make(env_id, wind=wind), stack), steps)),
                )


def _wrap(env: Any, stack: tuple[tuple[Any, ...], ...], prefix: str = "") -> Any:
    for name, *arguments in stack:
        env = getattr(wrappers, prefix + name)(env, *arguments)
    return env


def _vector_steps(env: Any, steps: int) -> list[Any]:
    generator = np.random.default_rng(5)
    returned = [env.reset(seed=11)]
    for _ in range(steps):
        action = 0.15 * generator.standard_normal(env.action_space.shape)
        returned.append(env.step(action.clip(-1.0, 1.0).astype(np.float32)))
    return returned


def _steps(env: Any, steps: int) -> list[Any]:
    generator = np.random.default_rng(6)
    returned = [env.reset(seed=12)]
    for _ in range(steps):
        action = 0.1 * generator.standard_normal(env.action_space.shape)
        returned.append(env.step(action.clip(-1.0, 1.0).astype(np.float32)))
        if returned[-1][2] or returned[-1][3]:
            returned.append(env.reset())
    return returned


def episodes(names: Sequence[str] = (), scenarios: Sequence[str] = SCENARIOS, count: int = 200) -> Hashes:
    """Hash the results of episodes.

    Args:
        names: Policies; if empty, all controllers and one seed of each shipped policy.
        scenarios: Scenarios.
        count: Episodes in each scenario; `nmpc`, whose actions take milliseconds, runs a twentieth of them.
    """
    for name in names or [*CONTROLLERS, *(seeds[0] for seeds in shipped_policies().values())]:
        vehicle = " · hummingbird · body_rates" if "hummingbird" in name else ""
        for scenario in (f"{scenario}{vehicle}" for scenario in scenarios):
            number = max(count // 20, 1) if name == "nmpc" else count
            yield f"{name}, {scenario}", digest(run_episodes([load_policy(name)], scenario, number, TEST_SEED))


def trainings(names: Sequence[str] = tuple(TRAININGS)) -> Hashes:
    """Hash the weights of policies after brief trainings.

    Args:
        names: Keys of `TRAININGS`.
    """
    for name in names:
        changes = TRAININGS[name]
        table = ALGORITHMS["ppo" if changes.get("algo", "ppo") == "ppo" else "sac"]
        settings = from_mapping({**BRIEF, **table, **changes}, f"the training {name!r}")
        with tempfile.TemporaryDirectory() as folder:
            policy = MlpPolicy.load(train(settings, Path(folder) / "run", progress=False))
        yield name, digest([list(layer) for layer in policy.layers])


PARTS: dict[str, Callable[[], Hashes]] = {
    "environments": environments,
    "episodes": episodes,
    "trainings": trainings,
}


def check(path: Path, hashes: dict[str, str]) -> list[str]:
    """Compare hashes with those in a file, and return the names of those that differ.

    Hashes that the file lacks are added to it.

    Args:
        path: JSON file; it may not exist yet.
        hashes: Hashes by name.
    """
    known: dict[str, str] = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({**hashes, **known}, indent=1) + "\n", encoding="utf-8")
    return [name for name, value in hashes.items() if known.get(name, value) != value]


def main() -> None:
    """Read the command line, hash, and compare."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.golden", description="Hash results and compare them.")
    parser.add_argument("--file", type=Path, default=Path("results/golden.json"), help="JSON file of the hashes")
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=[*PARTS], help="what to hash (default: all)")
    arguments = parser.parse_args()
    existed = arguments.file.exists()
    hashes: dict[str, str] = {}
    for part in arguments.parts:
        print(f"Hashing {part} …", flush=True)
        hashes |= {f"{part}: {name}": value for name, value in PARTS[part]()}
    different = check(arguments.file, hashes)
    for name in different:
        print(f"Different: {name}")
    print(f"{len(hashes)} hashes, {len(different)} differ." if existed else f"Written: {arguments.file}")
    sys.exit(1 if different else 0)


if __name__ == "__main__":
    main()
