"""Speed of the environments, compared with other environments in the same run.

`make bench` runs this file as ``python -m benchmarks.speed``. Each rate is the best of several rounds in one process
with one thread, unless its name says otherwise. The environments receive a small fixed action at every step, and the
rates include resets. "hummingbird" is a rigid vehicle by body rates. "Everything" means Dryden wind, noisy sensors and
random parameters together.
"""

import argparse
import json
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium.vector import AutoresetMode, VectorEnv

from experiments.pages import DOCS
from quadpend_baselines import controller
from quadpend_gym import Dryden, OrnsteinUhlenbeck
from quadpend_gym.envs.vector_env import QuadPendulumVectorEnv
from quadpend_gym.randomization import Around
from quadpend_gym.sensors import Noise
from quadpend_gym.tasks.observation import OBSERVATION_SIZE
from quadpend_gym.wrappers import VectorParameterWrapper, VectorSensorWrapper
from quadpend_train.common.files import write_text
from quadpend_train.envs.sb3_vec_env import SB3VecEnv
from quadpend_train.policies.export import export
from quadpend_train.training.algorithms import make_model
from quadpend_train.training.environment import make_env
from quadpend_train.training.settings import read_settings

NUM_ENVS = (1, 64, 1024, 4096, 16384)
# The rigid vehicle whose step takes longest: the loop on board and the allocation run in every substep.
RIGID: dict[str, Any] = {"vehicle": "hummingbird", "interface": "body_rates"}
_SECONDS = 0.15  # length of one timing
_ROUNDS = 15
_TRAINING_STEPS = 150_000  # of one timing

Call = tuple[Callable[[], Any], int]  # a function and the number of environment steps that one call makes


def best_rates(calls: dict[str, Call]) -> dict[str, float]:
    """Return the steps per second of each call: the best of several rounds.

    Every round times all calls, so a slow phase of the machine affects all of them alike.
    """
    repeats, best = {}, dict.fromkeys(calls, np.inf)
    for name, (function, _) in calls.items():
        function()
        start = time.perf_counter()
        function()
        repeats[name] = max(1, int(_SECONDS / max(time.perf_counter() - start, 1e-7)))
    for _ in range(_ROUNDS):
        for name, (function, _) in calls.items():
            start = time.perf_counter()
            for _ in range(repeats[name]):
                function()
            best[name] = min(best[name], (time.perf_counter() - start) / repeats[name])
    return {name: steps / best[name] for name, (_, steps) in calls.items()}


def single_env(env: gym.Env[Any, Any], action: Any) -> Call:
    """Return a call that steps a single environment without its wrappers, and resets it when an episode ends."""
    env = env.unwrapped
    env.reset(seed=0)

    def step() -> None:
        if env.step(action)[2]:
            env.reset()

    return step, 1


def vector_env(env: VectorEnv[Any, Any, Any], action: Any) -> Call:
    """Return a call that steps all sub-environments of a vector environment, including autoresets."""
    actions = np.repeat([action], env.num_envs, axis=0)
    env.reset(seed=0)
    return lambda: env.step(actions), env.num_envs


def make_everything(num_envs: int) -> VectorEnv[Any, Any, Any]:
    """Make a vector environment with Dryden wind, noise on the measured outputs, and ± 30 % of every parameter."""
    env = QuadPendulumVectorEnv(num_envs, wind=Dryden(), autoreset_mode=AutoresetMode.SAME_STEP)
    noisy = VectorSensorWrapper(env, Noise(position=0.002, euler=0.002, direction=0.002))
    return VectorParameterWrapper(noisy, Around(0.3))


def measure_environments() -> dict[str, float]:
    """Return the steps per second of this package's environments and of Gymnasium's."""
    wind, hover = OrnsteinUhlenbeck(), np.full(4, 0.01, np.float32)
    calls = {
        "QuadPendulum-v0, single": single_env(gym.make("quadpend_gym:QuadPendulum-v0"), hover),
        "QuadPendulum-v0, single, wind": single_env(gym.make("quadpend_gym:QuadPendulum-v0", wind=wind), hover),
        "QuadPendulum-v0, single, hummingbird": single_env(gym.make("quadpend_gym:QuadPendulum-v0", **RIGID), hover),
        "CartPole-v1, single": single_env(gym.make("CartPole-v1"), 1),
        "InvertedDoublePendulum-v5, single": single_env(gym.make("InvertedDoublePendulum-v5"), np.zeros(1)),
    }
    for n in NUM_ENVS:
        for suffix, model in (("", None), (", wind", wind)):
            env = QuadPendulumVectorEnv(n, wind=model, autoreset_mode=AutoresetMode.SAME_STEP)
            calls[f"QuadPendulum-v0, num_envs={n}{suffix}"] = vector_env(env, hover)
        env = QuadPendulumVectorEnv(n, autoreset_mode=AutoresetMode.SAME_STEP, **RIGID)
        calls[f"QuadPendulum-v0, num_envs={n}, hummingbird"] = vector_env(env, hover)
        calls[f"QuadPendulum-v0, num_envs={n}, everything"] = vector_env(make_everything(n), hover)
        cartpole = gym.make_vec("CartPole-v1", n, vectorization_mode="vector_entry_point")
        calls[f"CartPole-v1, num_envs={n}"] = vector_env(cartpole, np.int64(1))
    return best_rates(calls)


class FreeVectorEnv(QuadPendulumVectorEnv):
    """QuadPendulum's environment that computes nothing: it always returns the same arrays."""

    def __init__(self, num_envs: int) -> None:
        super().__init__(num_envs, autoreset_mode=AutoresetMode.SAME_STEP)
        size = (num_envs, OBSERVATION_SIZE)
        self._fixed = np.random.default_rng(0).normal(size=size).astype(np.float32)
        self._reward, self._never = np.full(num_envs, 0.01), np.zeros(num_envs, np.bool_)

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        """Return the fixed observation."""
        return self._fixed, {}

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Return the fixed arrays; no episode ends."""
        return self._fixed, self._reward, self._never, self._never, {}


def measure_training(rounds: int = 9) -> dict[str, float]:
    """Return PPO's environment steps per second on QuadPendulum-v0 and on `FreeVectorEnv`, medians over rounds."""
    settings = read_settings("ppo")
    torch.set_num_threads(settings.num_threads)
    envs = {
        "PPO on QuadPendulum-v0 in wind": make_env(settings),
        "PPO on a free environment": SB3VecEnv(FreeVectorEnv(settings.num_envs)),
    }
    models = {name: make_model(settings, env, None) for name, env in envs.items()}
    rates: dict[str, list[float]] = {name: [] for name in models}
    for _ in range(rounds):
        for name, model in models.items():
            start, before = time.perf_counter(), model.num_timesteps
            model.learn(_TRAINING_STEPS, reset_num_timesteps=False)
            rates[name].append((model.num_timesteps - before) / (time.perf_counter() - start))
    return {name: float(np.median(values)) for name, values in rates.items()}


def measure_policies() -> dict[str, float]:
    """Return how many times faster `MlpPolicy.predict` is than `predict` of the SB3 model it was exported from."""
    settings = read_settings("ppo")
    torch.set_num_threads(settings.num_threads)
    model = make_model(settings, make_env(settings), None)
    policy = export(model)
    observations = np.random.default_rng(0).normal(size=(256, OBSERVATION_SIZE)).astype(np.float32)
    ratios = {}
    for name, observation in (("one observation", observations[0]), ("256 observations", observations)):
        exported = partial(policy.predict, observation)
        sb3 = partial(model.predict, observation, deterministic=True)
        rates = best_rates({"exported": (exported, 1), "sb3": (sb3, 1)})
        ratios[f"MlpPolicy.predict / PPO.predict, {name}"] = rates["exported"] / rates["sb3"]
    return ratios


def measure_pictures() -> dict[str, float]:
    """Return the pictures per second that the environments render without a window, in the middle of an episode.

    QuadPendulum's pictures have 640 × 480 pixels, CartPole's 600 × 400.
    """
    calls: dict[str, Call] = {}
    for name, wind in (("calm", None), ("storm", "storm")):
        env = gym.make("quadpend_gym:QuadPendulum-v0", wind=wind, render_mode="rgb_array")
        policy, memory = controller("flatness"), None
        observation, _ = env.reset(seed=0)
        for _ in range(200):
            action, memory = policy.predict(observation, memory)
            observation, *_ = env.step(action)
        calls[f"QuadPendulum-v0, {name}"] = env.render, 1
    cartpole = gym.make("CartPole-v1", render_mode="rgb_array")
    cartpole.reset(seed=0)
    calls["CartPole-v1"] = cartpole.render, 1
    return best_rates(calls)


_FIRST_EPISODE = """
import time; start = time.perf_counter()
import quadpend_gym; imported = time.perf_counter()
import gymnasium as gym, numpy as np
env = gym.make("quadpend_gym:QuadPendulum-v0", wind=quadpend_gym.OrnsteinUhlenbeck())
env.reset(seed=0)
for _ in range(10): env.step(np.zeros(4, np.float32))
print(imported - start, time.perf_counter() - imported)
"""


def measure_start() -> dict[str, float]:
    """Return the seconds to import the package, and to make and step an environment for the first time.

    Numba compiles the kernels if its on-disk cache is empty ("cold"), and loads them otherwise ("cached").
    """
    with tempfile.TemporaryDirectory() as cache:
        environment = {"NUMBA_CACHE_DIR": cache, "PATH": "/usr/bin:/bin"}
        runs = [
            subprocess.run(
                [sys.executable, "-c", _FIRST_EPISODE], env=environment, capture_output=True, text=True, check=True
            )
            for _ in range(2)
        ]
    cold, cached = ([float(item) for item in run.stdout.split()] for run in runs)
    return {"import quadpend_gym": cached[0], "first episode, cold": cold[1], "first episode, cached": cached[1]}


def speed_ratios(rates: dict[str, float]) -> dict[str, float]:
    """Return the ratios of the rates that `measure_environments` returns."""
    single = rates["QuadPendulum-v0, single"]
    ratios = {
        "single / CartPole-v1": single / rates["CartPole-v1, single"],
        "single, hummingbird / CartPole-v1": rates["QuadPendulum-v0, single, hummingbird"]
        / rates["CartPole-v1, single"],
        "single / InvertedDoublePendulum-v5": single / rates["InvertedDoublePendulum-v5, single"],
    }
    for n in NUM_ENVS:
        label = f"num_envs={n}"
        calm, everything = rates[f"QuadPendulum-v0, {label}"], rates[f"QuadPendulum-v0, {label}, everything"]
        ratios[f"{label} / CartPole-v1's"] = calm / rates[f"CartPole-v1, {label}"]
        ratios[f"{label}, everything / calm"] = everything / calm
        ratios[f"{label}, hummingbird / paper"] = rates[f"QuadPendulum-v0, {label}, hummingbird"] / calm
    return ratios


def markdown(
    rates: dict[str, float], ratios: dict[str, float], pictures: dict[str, float], start: dict[str, float]
) -> str:
    """Return steps per second, ratios, pictures per second and start-up times (s) as a Markdown table."""
    rows = [
        *((name, _format_rate(rate)) for name, rate in rates.items()),
        *((name, f"{ratio:.2f} ×") for name, ratio in ratios.items()),
        *((name, f"{rate:.0f} pictures/s") for name, rate in pictures.items()),
        *((name, f"{seconds:.2f} s") for name, seconds in start.items()),
    ]
    return "\n".join(["| | |", "|---|---|", *(f"| {name} | {value} |" for name, value in rows)]) + "\n"


def _format_rate(rate: float) -> str:
    if rate < 1e3:
        return f"{rate:,.3g} steps/s"
    return f"{rate / 1e6:.3g} M steps/s" if rate >= 1e6 else f"{rate / 1e3:.3g} k steps/s"


def main() -> None:
    """Measure everything, print it, and write it to a JSON file with a Markdown table beside it."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.speed", description="Measure speed.")
    parser.add_argument("--out", type=Path, default=DOCS / "bench.json", help="JSON file for the measurements")
    out = parser.parse_args().out
    rates = measure_environments()
    ratios = speed_ratios(rates)
    training_rates = measure_training()
    rates |= training_rates
    quadpend, free = training_rates.values()
    ratios["PPO / PPO on a free environment"] = quadpend / free
    ratios |= measure_policies()
    pictures, start = measure_pictures(), measure_start()
    table = markdown(rates, ratios, pictures, start)
    print(table)
    machine = f"{platform.machine()}, Python {platform.python_version()}"
    data = {"machine": machine, "steps_per_second": rates, "ratios": ratios, "pictures": pictures, "seconds": start}
    write_text(out, json.dumps(data, indent=1) + "\n")
    write_text(out.with_suffix(".md"), table)


if __name__ == "__main__":
    main()
