"""Golden hashes of results, to check that a refactoring changes no number.

`make golden` runs this file as ``python -m benchmarks.golden``. It hashes what environments return, episodes of every
controller and of one seed of each shipped policy, and brief trainings. Run it before and after a refactoring: the first
run writes the hashes to a file, the second compares with them and exits with status 1 if one differs. The hashes cover
every bit of every floating-point number, so compare them only on the machine and with the package versions that wrote
the file.

`golden_cases` has the tables of what is hashed. Only the functions from `make_env` to `train_briefly` call the
packages: after a change of the packages' interface, edit these.
"""

import argparse
import copy
import hashlib
import json
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from benchmarks import golden_cases as cases
from benchmarks.golden_cases import Parts
from quadpend_gym.scenarios import SCENARIOS, Scenario, find_scenario
from quadpend_gym.wrappers import HistoryWrapper, VectorHistoryWrapper
from quadpend_train.evaluation.episodes import TEST_SEED, run_episodes
from quadpend_train.policies.loading import load_policy
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.training.settings import from_mapping
from quadpend_train.training.train import train

Entry = tuple[str, Callable[[], Any]]  # a name of our own, and what computes the numbers


def make_env(mode: str, env_id: str, num_envs: int, history: tuple[int, int] | None = None, **parts: Any) -> Any:
    """Return a single environment, or a vector environment with a mode of autoreset."""
    if mode == "single":
        env: Any = gym.make(f"quadpend_gym:{env_id}", **parts)
        return HistoryWrapper(env, *history) if history else env
    env = gym.make_vec(f"quadpend_gym:{env_id}", num_envs, autoreset_mode=mode, **parts)
    return VectorHistoryWrapper(env, *history) if history else env


def fly(policy: str, scenario: Scenario, episodes: int) -> dict[str, Any]:
    """Return the results of episodes."""
    results = run_episodes([load_policy(policy)], scenario, episodes, TEST_SEED)
    return {
        "survived": np.asarray(results.survived, np.bool_),
        "steps": np.asarray(results.steps, np.int64),
        "rmse": results.rmse,
        "penalised rmse": results.penalised_rmse,
        "settled rmse": results.settled_rmse,
        "largest tilt": results.largest_tilt,
        "effort": results.effort,
        "return": results.episode_return,
        "error": results.error,
    }


def train_briefly(settings: Parts) -> list[Any]:
    """Return the weights of a policy after a training with these settings."""
    with tempfile.TemporaryDirectory() as folder:
        policy = MlpPolicy.load(train(from_mapping(settings, "golden"), Path(folder) / "run", progress=False))
    return [list(layer) for layer in policy.layers]


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
        sha.update(f"{len(value)}".encode())
        for item in value:
            _update(sha, item)
    elif value is None:
        sha.update(b"none")
    else:
        array = np.ascontiguousarray(value)
        sha.update(f"{array.dtype}{array.shape}".encode())
        sha.update(array.tobytes())


def _steps(parts: Parts, mode: str) -> list[Any]:
    """Return what an environment returns for random actions."""
    parts = {**cases.DEFAULTS, **parts}
    steps, deviation = parts.pop("steps"), parts.pop("actions")
    env = make_env(mode, **parts)
    generator = np.random.default_rng(5)
    returned = [copy.deepcopy(env.reset(seed=11))]
    for _ in range(steps):
        action = deviation * generator.standard_normal(env.action_space.shape)
        returned.append(copy.deepcopy(env.step(action.clip(-1.0, 1.0).astype(np.float32))))
        ended = np.logical_or(*returned[-1][2:4])
        if mode == "single" and ended:
            returned.append(copy.deepcopy(env.reset()))
        elif mode == "Disabled" and ended.any():
            returned.append(copy.deepcopy(env.reset(options={"reset_mask": ended})))
    return returned


def entries() -> Iterator[Entry]:
    """Yield environments with every part, short flights in all scenarios and of all policies, and brief trainings."""
    for name, parts in cases.ENVIRONMENTS.items():
        for mode in ("SameStep", "NextStep") if "num_envs" in parts else ("single", "SameStep", "NextStep"):
            yield f"environments: {name}, {mode}", partial(_steps, parts, mode)
    yield "environments: masked resets", partial(_steps, cases.EVERYTHING, "Disabled")
    for name in SCENARIOS:
        scenario = replace(find_scenario(name), duration=cases.LONG)
        yield f"scenarios: {name}", partial(fly, "flatness", scenario, 3)
    for name, flights in cases.FLIGHTS.items():
        policy, number = f"{name}-0" if name.startswith(cases.LEARNED) else name, cases.EPISODES.get(name, 20)
        for flight, parts in flights.items():
            scenario = Scenario(**{"duration": cases.SECONDS, **parts})
            yield f"episodes: {name}, {flight}", partial(fly, policy, scenario, number)
    for name, changes in cases.TRAININGS.items():
        algo = changes.get("algo", "ppo")
        settings = {**cases.BRIEF, algo: cases.ALGORITHMS[algo], **changes}
        yield f"trainings: {name}", partial(train_briefly, settings)


def compute(only: str = "") -> dict[str, str]:
    """Return the hashes by name, of the entries whose names contain a text."""
    return {name: digest(numbers()) for name, numbers in entries() if only in name}


def check(path: Path, hashes: dict[str, str]) -> list[str]:
    """Compare hashes with those in a file, and return the names of those that differ.

    Hashes that the file lacks are added to it; it may not exist yet.
    """
    known: dict[str, str] = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({**hashes, **known}, indent=1) + "\n", encoding="utf-8")
    return [name for name, value in hashes.items() if known.get(name, value) != value]


def main() -> None:
    """Read the command line, hash, and compare."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.golden", description="Hash results and compare them.")
    parser.add_argument("--file", type=Path, default=Path("results/golden.json"), help="JSON file of the hashes")
    parser.add_argument("--only", default="", metavar="SUBSTRING", help="hash only what has this text in its name")
    arguments = parser.parse_args()
    existed = arguments.file.exists()
    hashes = compute(arguments.only)
    different = check(arguments.file, hashes)
    for name in different:
        print(f"Different: {name}")
    print(f"{len(hashes)} hashes, {len(different)} differ." if existed else f"Written: {arguments.file}")
    sys.exit(1 if different else 0)


if __name__ == "__main__":
    main()
