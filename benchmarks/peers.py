"""Speed of this package beside crazyflow (JAX) and rotorpy (PyTorch, NumPy), for docs/accuracy.md.

    .venv/bin/pip install -c constraints.txt -e '.[peers]'
    make bench

A rate is in simulated seconds per second of processor time, summed over all vehicles. Processor time counts every
thread, and the process is bound to one core. Each rate is the best of several rounds that time all contenders.
crazyflow needs SCIPY_ARRAY_API=1 before SciPy is imported; the Makefile sets it.
"""

import os
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from benchmarks.speed import RIGID, Call, best_rates, rate_table
from experiments.pages import DOCS, fill
from quadpend_gym.envs.vector_env import QuadPendulumVectorEnv

NUM_VEHICLES = (1024, 8192)
PERIOD = 0.01  # s, between two commands


def quadpend(rows: int, **parts: Any) -> Call:
    """Return a step of this package's environment, and the simulated seconds of a call."""
    env = QuadPendulumVectorEnv(rows, autoreset_mode=AutoresetMode.SAME_STEP, **parts)
    env.reset(seed=0)
    return partial(env.step, np.full((rows, 4), 0.01, np.float32)), rows * PERIOD


def crazyflow_env(rows: int) -> Call:
    """Return a step of crazyflow's environment."""
    from crazyflow.envs import ReachPosEnv

    env = ReachPosEnv(num_envs=rows, dynamics="first_principles", freq=round(1.0 / PERIOD))
    env.reset(seed=0)
    commands = np.tile(np.array([0.01, 0.01, 0.0, 0.33], np.float32), (rows, 1))
    return lambda: env.step(commands)[1].block_until_ready(), rows * PERIOD


def crazyflow(rows: int, control: str, command: tuple[float, ...], period: float = PERIOD) -> Call:
    """Return a command of crazyflow's simulator, without an environment, and its steps until the next command."""
    from crazyflow.sim import Sim

    sim = Sim(rows, control=control, dynamics="first_principles")
    commands = np.tile(np.array(command, np.float32), (rows, 1, 1))

    def advance() -> None:
        getattr(sim, f"{control}_control")(commands)
        sim.step(round(sim.freq * period))
        sim.data.states.pos.block_until_ready()

    return advance, rows * period


def rotorpy_env(rows: int) -> Call:
    """Return a step of rotorpy's vector environment."""
    import torch
    from rotorpy.learning.quadrotor_environments import make_default_vec_env
    from rotorpy.vehicles.hummingbird_params import quad_params

    env = make_default_vec_env(rows, quad_params, "cmd_ctbr", torch.device("cpu"))
    env.reset(seed=0)
    return partial(env.step, np.tile([-0.6, 0.01, 0.01, 0.0], (rows, 1))), rows * PERIOD


def rotorpy(rows: int) -> Call:
    """Return a step of rotorpy's simulator of one vehicle; it has no batches."""
    from rotorpy.vehicles.hummingbird_params import quad_params
    from rotorpy.vehicles.multirotor import Multirotor

    vehicle = Multirotor(quad_params, control_abstraction="cmd_ctbr")
    control = {"cmd_thrust": 5.0, "cmd_w": np.full(3, 0.01)}
    state = dict(vehicle.initial_state)
    return lambda: state.update(vehicle.step(state, control, PERIOD)), PERIOD


_attitude = partial(crazyflow, control="attitude", command=(0.01, 0.01, 0.0, 0.45))
_wrench = partial(crazyflow, control="force_torque", command=(0.45, 1e-6, 1e-6, 0.0))
CONTENDERS: dict[str, Callable[[int], Call]] = {
    "quadpend-gym, environment, paper's vehicle": quadpend,
    "quadpend-gym, environment, hummingbird by body rates": partial(quadpend, **RIGID),
    "crazyflow, environment by attitude": crazyflow_env,
    "crazyflow, attitude controller": _attitude,
    "crazyflow, attitude controller, commands held for 0.1 s": partial(_attitude, period=0.1),
    "crazyflow, force and torque, commands held for 0.1 s": partial(_wrench, period=0.1),
    "rotorpy, environment by body rates": rotorpy_env,
    "rotorpy, one vehicle by body rates": rotorpy,
}


def main() -> None:
    """Measure, print, and update the page; without the extra `peers`, say so."""
    missing = [name for name in ("crazyflow", "rotorpy") if find_spec(name) is None]
    if missing:
        print(f"Skipped, since {' and '.join(missing)} of the extra `peers` are not installed.")
        return
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    calls = {(name, f"{rows:,} vehicles"): make(rows) for rows in NUM_VEHICLES for name, make in CONTENDERS.items()}
    table = rate_table("simulated seconds per second of one core", best_rates(calls))
    print(table)
    fill(DOCS / "accuracy.md", {"peers": table})


if __name__ == "__main__":
    main()
