"""How fast the environments are, as ratios against others measured in the same run.

Each figure is the best of several turns, one process, one thread unless said otherwise. Environments are stepped with a
small fixed action and restart by themselves, so that resets are in the figure. "Everything" is Dryden wind, noisy
sensors and random parameters at once.
"""

import json
import platform
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from rich.console import Console
from rich.table import Table

from quadpend_gym import Dryden, OrnsteinUhlenbeck
from quadpend_gym.envs.vector_env import QuadPendulumVectorEnv
from quadpend_gym.randomization import Around
from quadpend_gym.sensors import Noise
from quadpend_gym.wrappers import VectorParameterWrapper, VectorSensorWrapper

ROWS = (1, 64, 1024, 4096, 16384)
_SECONDS = 0.15
_TURNS = 15


def rates_of(calls: dict[str, tuple[Callable[[], Any], int]]) -> dict[str, float]:
    """Steps per second of functions that each make a number of steps: the best of several turns.

    All of them in every turn, so that what slows the machine for a while slows them alike.
    """
    counts, best = {}, dict.fromkeys(calls, np.inf)
    for name, (function, _) in calls.items():
        function()
        began = time.perf_counter()
        function()
        counts[name] = max(1, int(_SECONDS / max(time.perf_counter() - began, 1e-7)))
    for _ in range(_TURNS):
        for name, (function, _) in calls.items():
            began = time.perf_counter()
            for _ in range(counts[name]):
                function()
            best[name] = min(best[name], (time.perf_counter() - began) / counts[name])
    return {name: steps / best[name] for name, (_, steps) in calls.items()}


def single(env: gym.Env[Any, Any], action: Any) -> tuple[Callable[[], Any], int]:
    """A step of an unwrapped single environment, with a reset whenever an episode ends."""
    env = env.unwrapped
    env.reset(seed=0)

    def step() -> None:
        if env.step(action)[2]:
            env.reset()

    return step, 1


def vector(env: VectorEnv[Any, Any, Any], action: Any) -> tuple[Callable[[], Any], int]:
    """A step of every row of a vector environment, autoresets included."""
    actions = np.repeat([action], env.num_envs, axis=0)
    env.reset(seed=0)
    return lambda: env.step(actions), env.num_envs


def everything(rows: int) -> VectorEnv[Any, Any, Any]:
    """Dryden wind, noise on all that output feedback measures, and ± 30 % of every parameter."""
    env = QuadPendulumVectorEnv(rows, wind=Dryden(), autoreset_mode=AutoresetMode.SAME_STEP)
    noisy = VectorSensorWrapper(env, Noise(position=0.002, euler=0.002, direction=0.002))
    return VectorParameterWrapper(noisy, Around(0.3))


def measure_environments() -> dict[str, float]:
    """Environment steps per second of ours and of others."""
    wind, hover = OrnsteinUhlenbeck(), np.full(4, 0.01, np.float32)
    calls = {
        "QuadPendulum-v0, single": single(gym.make("quadpend_gym:QuadPendulum-v0"), hover),
        "QuadPendulum-v0, single, wind": single(gym.make("quadpend_gym:QuadPendulum-v0", wind=wind), hover),
        "CartPole-v1, single": single(gym.make("CartPole-v1"), 1),
        "InvertedDoublePendulum-v5, single": single(gym.make("InvertedDoublePendulum-v5"), np.zeros(1)),
    }
    for rows in ROWS:
        for name, blowing in (("", None), (", wind", wind)):
            env = QuadPendulumVectorEnv(rows, wind=blowing, autoreset_mode=AutoresetMode.SAME_STEP)
            calls[f"QuadPendulum-v0, {rows} rows{name}"] = vector(env, hover)
        calls[f"QuadPendulum-v0, {rows} rows, everything"] = vector(everything(rows), hover)
        cartpole = gym.make_vec("CartPole-v1", rows, vectorization_mode="vector_entry_point")
        calls[f"CartPole-v1, {rows} rows"] = vector(cartpole, np.int64(1))
    return rates_of(calls)


class FreeVectorEnv(VectorEnv[Any, Any, Any]):
    """An environment of QuadPendulum's spaces that costs nothing: it returns the same arrays at every step."""

    def __init__(self, num_envs: int) -> None:
        ours = QuadPendulumVectorEnv(1)
        self.num_envs = num_envs
        self.metadata = {"autoreset_mode": AutoresetMode.SAME_STEP}
        self.single_observation_space, self.single_action_space = ours.single_observation_space, spaces.Box(-1, 1, (4,))
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._observation = np.random.default_rng(0).normal(size=(num_envs, 36)).astype(np.float32)
        self._reward, self._never = np.full(num_envs, 0.01), np.zeros(num_envs, np.bool_)

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        """The same observation always."""
        return self._observation, {}

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """The same arrays always."""
        return self._observation, self._reward, self._never, self._never, {}


def measure_training(steps: int = 150_000, turns: int = 9) -> dict[str, float]:
    """PPO's environment steps per second on our environment and on one that costs nothing: medians of turns."""
    import torch

    from quadpend_train.envs.sb3_vec_env import SB3VecEnv
    from quadpend_train.training.algorithms import make_model
    from quadpend_train.training.environment import make_env
    from quadpend_train.training.settings import read_settings

    settings = read_settings("demo")
    torch.set_num_threads(settings.torch_threads)
    envs = {
        "PPO on QuadPendulum-v0 in wind": make_env(settings),
        "PPO on a free environment": SB3VecEnv(FreeVectorEnv(settings.num_envs)),
    }
    models = {name: make_model(settings, env, None) for name, env in envs.items()}
    rates: dict[str, list[float]] = {name: [] for name in models}
    for _ in range(turns):
        for name, model in models.items():
            began, before = time.perf_counter(), model.num_timesteps
            model.learn(steps, reset_num_timesteps=False)
            rates[name].append((model.num_timesteps - before) / (time.perf_counter() - began))
    return {name: float(np.median(found)) for name, found in rates.items()}


def measure_policies() -> dict[str, float]:
    """How many times faster `LearnedPolicy` predicts than the model of Stable-Baselines3 it was exported from."""
    import torch

    from quadpend_train.policies.export import export
    from quadpend_train.training.algorithms import make_model
    from quadpend_train.training.environment import make_env
    from quadpend_train.training.settings import read_settings

    settings = read_settings("demo")
    torch.set_num_threads(settings.torch_threads)
    model = make_model(settings, make_env(settings), None)
    policy = export(model)
    seen = np.random.default_rng(0).normal(size=(256, 36)).astype(np.float32)
    ratios = {}
    for name, observation in (("one observation", seen[0]), ("256 observations", seen)):
        rates = rates_of(
            {
                "ours": (lambda o=observation: policy.predict(o), 1),  # type: ignore[misc]
                "theirs": (lambda o=observation: model.predict(o, deterministic=True), 1),  # type: ignore[misc]
            }
        )
        ratios[f"LearnedPolicy.predict / PPO.predict, {name}"] = rates["ours"] / rates["theirs"]
    return ratios


def measure_pictures() -> dict[str, float]:
    """Pictures per second, headless, in the middle of a flight; ours have 640 × 480 pixels, CartPole's 600 × 400."""
    from quadpend_baselines import controller

    calls: dict[str, tuple[Callable[[], Any], int]] = {}
    for name, wind in (("calm", None), ("storm", "storm")):
        env = gym.make("quadpend_gym:QuadPendulum-v0", wind=wind, render_mode="rgb_array")
        pilot, memory = controller("flatness"), None
        observation, _ = env.reset(seed=0)
        for _ in range(200):
            action, memory = pilot.predict(observation, memory)
            observation, *_ = env.step(action)
        calls[f"QuadPendulum-v0, {name}"] = env.render, 1
    cartpole = gym.make("CartPole-v1", render_mode="rgb_array")
    cartpole.reset(seed=0)
    calls["CartPole-v1"] = cartpole.render, 1
    return rates_of(calls)


_FIRST_EPISODE = """
import time; began = time.perf_counter()
import quadpend_gym; imported = time.perf_counter()
import gymnasium as gym, numpy as np
env = gym.make("quadpend_gym:QuadPendulum-v0", wind=quadpend_gym.OrnsteinUhlenbeck())
env.reset(seed=0)
for _ in range(10): env.step(np.zeros(4, np.float32))
print(imported - began, time.perf_counter() - imported)
"""


def measure_start() -> dict[str, float]:
    """Seconds to import, and to compile what a first episode needs, with an empty cache and with a full one."""
    import tempfile

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


def _ratios(rates: dict[str, float]) -> dict[str, float]:
    ratios = {
        "single / CartPole-v1": rates["QuadPendulum-v0, single"] / rates["CartPole-v1, single"],
        "single / InvertedDoublePendulum-v5": rates["QuadPendulum-v0, single"]
        / rates["InvertedDoublePendulum-v5, single"],
    }
    for rows in ROWS:
        ours = rates[f"QuadPendulum-v0, {rows} rows"]
        ratios[f"{rows} rows / CartPole-v1's"] = ours / rates[f"CartPole-v1, {rows} rows"]
        ratios[f"{rows} rows, everything / calm"] = rates[f"QuadPendulum-v0, {rows} rows, everything"] / ours
    return ratios


def markdown(
    rates: dict[str, float], ratios: dict[str, float], pictures: dict[str, float], start: dict[str, float]
) -> str:
    """The figures as a Markdown table, rounded to three digits."""
    rows = [
        *((name, f"{rate:,.3g} steps/s" if rate < 1e3 else _thousands(rate)) for name, rate in rates.items()),
        *((name, f"{ratio:.2f} ×") for name, ratio in ratios.items()),
        *((name, f"{rate:.0f} pictures/s") for name, rate in pictures.items()),
        *((name, f"{seconds:.2f} s") for name, seconds in start.items()),
    ]
    return "\n".join(["| | |", "|---|---|", *(f"| {name} | {value} |" for name, value in rows)]) + "\n"


def _thousands(rate: float) -> str:
    return f"{rate / 1e6:.3g} M steps/s" if rate >= 1e6 else f"{rate / 1e3:.3g} k steps/s"


def main(out: Path | None) -> None:
    """Measure, print, and write the figures to `out`, and as a table beside it."""
    rates = measure_environments()
    ratios = _ratios(rates)
    trained = measure_training()
    rates |= trained
    ours, free = trained.values()
    ratios["PPO / PPO on a free environment"] = ours / free
    ratios |= measure_policies()
    pictures, start = measure_pictures(), measure_start()
    console = Console()
    for title, figures, form in (
        ("environment steps per second", rates, "{:,.0f}"),
        ("ratios", ratios, "{:.2f}"),
        ("pictures per second", pictures, "{:,.0f}"),
        ("seconds", start, "{:.2f}"),
    ):
        table = Table("", title, title_justify="left")
        for name, value in figures.items():
            table.add_row(name, form.format(value))
        console.print(table)
    if out is not None:
        machine = f"{platform.machine()}, Python {platform.python_version()}"
        out.parent.mkdir(parents=True, exist_ok=True)
        data = {"machine": machine, "steps_per_second": rates, "ratios": ratios, "pictures": pictures, "seconds": start}
        out.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
        out.with_suffix(".md").write_text(markdown(rates, ratios, pictures, start), encoding="utf-8")
