"""Speed of the environments, compared with other environments in the same run, for docs/accuracy.md.

`make bench` runs this file as ``python -m benchmarks.speed``. Each rate is the best of several rounds in one process
with one thread. The environments receive a small fixed action at every step, and the rates include resets.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv

from experiments.pages import DOCS, fill
from quadpend_gym import Dryden, OrnsteinUhlenbeck
from quadpend_gym.envs.vector_env import QuadPendulumVectorEnv
from quadpend_gym.randomization import Around
from quadpend_gym.sensors import Noise
from quadpend_train.evaluation.formatting import markdown_table

NUM_ENVS = (1, 64, 1024, 4096, 16384)
# The rigid vehicle whose step takes longest: the loop on board and the allocation run in every substep.
RIGID: dict[str, Any] = {"vehicle": "hummingbird", "interface": "body_rates"}
_SECONDS = 0.15  # length of one timing
_ROUNDS = 15

Call = tuple[Callable[[], Any], float]  # a function and what one call makes, usually the number of environment steps
Key = tuple[str, str]  # row and column of a table of rates


def best_rates(calls: dict[Key, Call]) -> dict[Key, float]:
    """Return what each call makes per second of processor time: the best of several rounds.

    Every round times all calls, so a slow phase of the machine affects all of them alike.
    """
    repeats, best = {}, dict.fromkeys(calls, np.inf)
    for key, (function, _) in calls.items():
        function()
        start = time.process_time()
        function()
        repeats[key] = max(1, int(_SECONDS / max(time.process_time() - start, 1e-7)))
    for _ in range(_ROUNDS):
        for key, (function, _) in calls.items():
            start = time.process_time()
            for _ in range(repeats[key]):
                function()
            best[key] = min(best[key], (time.process_time() - start) / repeats[key])
    return {key: made / best[key] for key, (_, made) in calls.items()}


def rate_table(heading: str, rates: dict[Key, float]) -> str:
    """Return rates, rounded to three digits, as a Markdown table."""
    names, columns = (list(dict.fromkeys(key[i] for key in rates)) for i in range(2))
    cells = {key: f"{float(f'{rate:.3g}'):,g}" for key, rate in rates.items()}
    return markdown_table(
        [heading, *columns], [[name, *(cells.get((name, c), "–") for c in columns)] for name in names]
    )


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
    noise = Noise(position=0.002, euler=0.002, direction=0.002)
    parts: dict[str, Any] = {"wind": Dryden(), "sensors": noise, "parameters": Around(0.3)}
    return QuadPendulumVectorEnv(num_envs, autoreset_mode=AutoresetMode.SAME_STEP, **parts)


def measure_environments() -> dict[Key, float]:
    """Return the thousands of steps per second of this package's environments and of Gymnasium's, by name and size."""
    hover, wind = np.full(4, 0.01, np.float32), OrnsteinUhlenbeck()
    variants: dict[str, dict[str, Any]] = {"calm": {}, "wind": {"wind": wind}, "hummingbird": RIGID}
    make = partial(gym.make, "quadpend_gym:QuadPendulum-v0")
    calls = {(name, "single"): single_env(make(**parts), hover) for name, parts in variants.items()}
    calls["CartPole-v1", "single"] = single_env(gym.make("CartPole-v1"), 1)
    calls["InvertedDoublePendulum-v5", "single"] = single_env(gym.make("InvertedDoublePendulum-v5"), np.zeros(1))
    for n in NUM_ENVS:
        for name, parts in variants.items():
            env = QuadPendulumVectorEnv(n, autoreset_mode=AutoresetMode.SAME_STEP, **parts)
            calls[name, f"{n:,}"] = vector_env(env, hover)
        calls["everything", f"{n:,}"] = vector_env(make_everything(n), hover)
        cartpole = gym.make_vec("CartPole-v1", n, vectorization_mode="vector_entry_point")
        calls["CartPole-v1", f"{n:,}"] = vector_env(cartpole, np.int64(1))
    return {key: rate / 1e3 for key, rate in best_rates(calls).items()}


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


def main() -> None:
    """Measure everything, print it, and update the page."""
    argparse.ArgumentParser(prog="python -m benchmarks.speed", description=__doc__).parse_args()
    environments, start = measure_environments(), measure_start()
    rows = [[name, f"{seconds:.2f} s"] for name, seconds in start.items()]
    tables = {"environments": rate_table("environment", environments), "speed": markdown_table(["", ""], rows)}
    print("\n\n".join(tables.values()))
    fill(DOCS / "accuracy.md", tables)


if __name__ == "__main__":
    main()
