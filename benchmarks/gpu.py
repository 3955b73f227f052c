"""Steps per second of `DeviceVectorEnv` on a GPU, beside `QuadPendulumVectorEnv` on one core in the same run.

    python -m benchmarks.gpu --num-envs 1000 10000 100000 1000000

Each rate is the best of several rounds, and includes observation, reward and resets. "Step" repeats the same small
random actions. "Step and policy" computes them in torch with a network of two layers of 64 units from the observations,
which torch reads by DLPack without a copy. Without a GPU the command says so and measures nothing.
"""

import argparse
import json
import platform
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium.error import DependencyNotInstalled
from numba import cuda
from torch.utils.dlpack import from_dlpack

from quadpend_gym import QuadPendulumVectorEnv
from quadpend_gym.gpu import DeviceVectorEnv
from quadpend_gym.gpu.device_functions import SIMULATED

NUM_ENVS = [1_000, 10_000, 100_000, 1_000_000]
_ROUNDS = 5
_ACTION = 0.1  # largest component of a random action


def steps_per_second(step: Callable[[], Any], wait: Callable[[], Any], num_envs: int, seconds: float) -> float:
    """Return the best rate of several rounds.

    Args:
        step: Advances all sub-environments by one control period.
        wait: Returns when all steps are done.
        num_envs: Number of sub-environments.
        seconds: Length of a round, s.
    """
    step()
    wait()
    start = time.perf_counter()
    step()
    wait()
    repeats, best = max(1, int(seconds / (time.perf_counter() - start))), np.inf
    for _ in range(_ROUNDS):
        start = time.perf_counter()
        for _ in range(repeats):
            step()
        wait()
        best = min(best, (time.perf_counter() - start) / repeats)
    return num_envs / best


def measure_cpu(num_envs: int, seconds: float, settings: dict[str, Any]) -> float:
    """Return the steps per second of `QuadPendulumVectorEnv` on one core."""
    env = QuadPendulumVectorEnv(num_envs, autoreset_mode="SameStep", **settings)
    env.reset(seed=0)
    actions = np.random.default_rng(0).uniform(-_ACTION, _ACTION, (num_envs, 4)).astype(np.float32)
    return steps_per_second(lambda: env.step(actions), lambda: None, num_envs, seconds)


def measure_device(num_envs: int, seconds: float, settings: dict[str, Any]) -> tuple[float, float]:
    """Return the steps per second of `DeviceVectorEnv`, alone and with a policy in torch."""
    device = "cpu" if SIMULATED else "cuda"
    env = DeviceVectorEnv(num_envs, **settings, from_dlpack=from_dlpack)
    observation, _ = env.reset(seed=0)
    actions = _ACTION * (2.0 * torch.rand(num_envs, 4, device=device) - 1.0)
    alone = steps_per_second(lambda: env.step(actions), cuda.synchronize, num_envs, seconds)
    layers = (
        torch.nn.Linear(36, 64),
        torch.nn.ReLU(),
        torch.nn.Linear(64, 64),
        torch.nn.ReLU(),
        torch.nn.Linear(64, 4),
    )
    policy = torch.nn.Sequential(*layers, torch.nn.Tanh()).to(device)

    def step() -> None:
        nonlocal observation
        observation = env.step(policy(observation))[0]

    with torch.inference_mode():
        with_policy = steps_per_second(step, cuda.synchronize, num_envs, seconds)
    env.check_actions()
    return alone, with_policy


def machine() -> dict[str, str]:
    """Return the versions and the name of the device."""
    name = "numba's simulator" if SIMULATED else cuda.get_current_device().name.decode()
    return {"device": name, "cpu": platform.machine(), "torch": torch.__version__, "python": platform.python_version()}


def markdown(rates: dict[int, dict[str, float]]) -> str:
    """Return a table of the rates, in millions of steps per second."""
    rows = ["| sub-environments | GPU: step | GPU: step and policy | one core |", "|---|---|---|---|"]
    for num_envs, rate in rates.items():
        rows.append(f"| {num_envs:,} | " + " | ".join(f"{value / 1e6:.3g} M" for value in rate.values()) + " |")
    return "\n".join(rows) + "\n"


def main() -> None:
    """Read the command line and run the benchmark."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.gpu", description="Measure speed on a GPU.")
    parser.add_argument("--num-envs", type=int, nargs="+", default=NUM_ENVS, help="numbers of sub-environments")
    parser.add_argument("--vehicle", help="vehicle, by default the paper's")
    parser.add_argument("--seconds", type=float, default=0.5, help="length of each of five rounds")
    parser.add_argument("--out", type=Path, help="JSON file for the measurements")
    args = parser.parse_args()
    settings = {"vehicle": args.vehicle}
    try:
        DeviceVectorEnv(1)
    except (DependencyNotInstalled, RuntimeError) as error:
        sys.exit(f"nothing was measured: {error}")
    if SIMULATED:
        print("These rates are those of numba's simulator and say nothing about a GPU.")
    torch.set_num_threads(1)
    rates: dict[int, dict[str, float]] = {}
    for num_envs in args.num_envs:
        alone, with_policy = measure_device(num_envs, args.seconds, settings)
        core = measure_cpu(num_envs, args.seconds, settings)
        rates[num_envs] = {"device": alone, "device with policy": with_policy, "one core": core}
    print(", ".join(machine().values()))
    print(markdown(rates))
    if args.out is not None:
        args.out.parent.mkdir(parents=True, exist_ok=True)
        data = {"machine": machine(), "settings": settings, "steps_per_second": rates}
        args.out.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
