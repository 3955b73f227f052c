"""docs/benchmarks/gpu.json: the environment on a GPU, beside crazyflow, and how long PPO trains there.

    python -m benchmarks.gpu                                  # about six minutes
    python -m benchmarks.gpu --only steps --kernels DIR       # with kernels that another machine generated

Rates are medians of rounds that CUDA events time; a call is a CUDA graph of ten steps with constant actions of 0.01,
in which episodes end and begin. A rate of crazyflow is of its simulator with commands of attitude each 10 ms, or of
force and torque each 100 ms, without an environment. Training times contain the evaluations, not the compilation.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from runpy import run_path
from statistics import median
from typing import Any

import numpy as np
import torch

from quadpend_gym.device.env import Motion, QuadPendulumDeviceEnv
from quadpend_gym.scenarios.library import as_scenario

ROOT = Path(__file__).parents[1]
ROWS = (4096, 16_384, 65_536, 262_144, 1_048_576, 4_194_304)
HUMMINGBIRD = as_scenario(
    {"vehicle": "hummingbird", "interface": "body_rates", "substeps": 4, "latency": 0.02, "wind": "still_air"}
)
SCENARIOS: dict[str, Any] = {
    "paper": as_scenario(None),
    "flight_training_wind": as_scenario("flight_training_wind"),
    "flight_training_late": as_scenario("flight_training_late"),
    "event_training_jump": as_scenario("event_training_jump"),
    "event_training_catch": as_scenario("event_training_catch"),
    "hummingbird": HUMMINGBIRD,
}


TRAININGS: dict[str, tuple[str, ...]] = {
    "paper": (),
    "hummingbird": ("--history", "2", "--log-std", "-2"),
}


def kernel(name: str, folder: str | None) -> Path | None:
    """Return the file of a generated kernel, if there is a folder for them."""
    return None if folder is None else Path(folder, f"{name}.c")


def timed(call: Callable[[], object], calls: int, rounds: int = 5) -> float:
    """Return the median time of a call on the GPU, s."""
    times = []
    for _ in range(rounds):
        begin, end = (torch.cuda.Event(enable_timing=True) for _ in range(2))  # type: ignore[no-untyped-call]
        begin.record()
        for _ in range(calls):
            call()
        end.record()
        torch.cuda.synchronize()
        times.append(float(begin.elapsed_time(end)) / 1e3 / calls)
    return median(times)


def captured(call: Callable[[], object], repeats: int) -> Callable[[], None]:
    """Return a CUDA graph of some calls."""
    call()
    torch.cuda.synchronize()
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        for _ in range(repeats):
            call()
    return graph.replay


def steps(name: str, folder: str | None, rows: tuple[int, ...] = ROWS) -> list[dict[str, Any]]:
    """Return steps and simulated seconds a second of an environment."""
    scenario, found = SCENARIOS[name], []
    for n in rows:
        env = QuadPendulumDeviceEnv(n, scenario, kernel=kernel(name, folder))
        if n <= ROWS[0]:
            env.reset(seed=0)
        else:
            env.keys.random_()
            env._seeded = True
            env.reset()
        actions = torch.full((n, 4), 0.01, device="cuda")
        seconds = timed(captured(partial(env.step, actions), 10), 20) / 10
        rate = n / seconds
        found.append({"scenario": name, "rows": n, "steps": rate, "simulated": rate * scenario.period})
        del env
        torch.cuda.empty_cache()
    return found


def products(folder: str | None, rows: tuple[int, ...] = ROWS[2:5]) -> list[dict[str, Any]]:
    """Return products with the transposed Jacobian of the motion a second."""
    name = "flight_training_wind"
    scenario = SCENARIOS[name]
    motion, found = Motion(scenario, kernel=kernel(name, folder)), []
    env = QuadPendulumDeviceEnv(1, scenario, kernel=kernel(name, folder))
    env.reset(seed=0)
    size, slots = motion.sizes["x"], motion.sizes["slots"]
    for n in rows:
        x = env._memory[:size].repeat(1, n).contiguous()
        queue = 0.1 * torch.rand(4 * slots, n, device="cuda")
        wind = 0.1 * torch.randn(12, n, device="cuda")
        parameters = torch.tensor(scenario.simulation.parameters.as_array(), dtype=torch.float32, device="cuda")
        p = parameters[:, None].repeat(1, n).contiguous()
        none = x.new_empty(0)  # there is no drawn loop
        path, after, bar = x.new_empty(motion.sizes["substeps"], *x.shape), torch.empty_like(x), torch.randn_like(x)
        bar_x, bar_queue = torch.empty_like(x), torch.empty_like(queue)
        forward = timed(partial(motion.library, "move_rows", n, x, queue, none, wind, p, none, path, after), 20)
        arguments = path, after, queue, none, wind, p, none, bar, bar_x, bar_queue
        backward = timed(partial(motion.library, "move_rows_back", n, *arguments), 20)
        found.append({"rows": n, "motions": n / forward, "products": n / backward})
    return found


def crazyflow(rows: tuple[int, ...] = (65_536, 1_048_576)) -> list[dict[str, Any]]:
    """Return simulated seconds a second of crazyflow."""
    from crazyflow.sim import Sim

    found = []
    for n in rows:
        for control, command, period in (
            ("attitude", (0.01, 0.01, 0.0, 0.45), 0.01),
            ("force_torque", (0.45, 1e-6, 1e-6, 0.0), 0.1),
        ):
            sim = Sim(n, control=control, dynamics="first_principles", device="gpu")
            commands = 0.0 * sim.data.states.quat + np.array(command, np.float32)  # on the GPU, shape (n, 1, 4)

            def advance(
                sim: Any = sim, control: str = control, commands: Any = commands, period: float = period
            ) -> None:
                getattr(sim, f"{control}_control")(commands)
                sim.step(round(sim.freq * period))

            times = []
            for _ in range(4):
                begin = time.perf_counter()
                for _ in range(10):
                    advance()
                sim.data.states.pos.block_until_ready()
                times.append((time.perf_counter() - begin) / 10)
            rate = n * period / min(times)
            found.append({"control": control, "command_period": period, "rows": n, "simulated": rate})
    return found


def training(folder: str | None, name: str, seconds: float, *arguments: str) -> dict[str, Any]:
    """Return the evaluations of a PPO, and after how many seconds it survived 99 % of the episodes."""
    script = run_path(str(ROOT / "train" / "ppo_gpu.py"))
    args = script["parse"](["--seconds", str(seconds), *arguments])
    args.scenario, args.kernel = SCENARIOS[name], kernel(name, folder)
    found: list[dict[str, Any]] = []

    def report(item: dict[str, Any]) -> None:
        found.append(item)
        print(name, item, flush=True)

    script["train"](args, report)
    reached = [item["seconds"] for item in found if item.get("survival", 0.0) >= 0.99]
    return {"scenario": name, "settings": arguments, "balanced": reached[0] if reached else None, "evaluations": found}


def main() -> None:
    """Measure, print and write what was measured."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", nargs="+", default=["steps", "products", "crazyflow", "ppo"])
    parser.add_argument("--kernels", help="folder of generated kernels")
    parser.add_argument("--seconds", type=float, default=60.0, help="of each training")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "benchmarks" / "gpu.json")
    args = parser.parse_args()
    if args.kernels is not None:
        Path(args.kernels).mkdir(exist_ok=True)
    if not torch.cuda.is_available():
        print("Skipped: this benchmark needs a GPU, and PyTorch finds none. Nothing is written.")
        return
    result: dict[str, Any] = {
        "command": " ".join(["python -m benchmarks.gpu", *sys.argv[1:]]),
        "card": torch.cuda.get_device_name(),
        "torch": torch.__version__,
    }

    def measure(part: str, function: Callable[[], Any]) -> None:
        begin = time.perf_counter()
        try:
            result[part] = function()
        except Exception as error:  # one part that fails must not cost the others
            result[part] = repr(error)
        print(part, f"{time.perf_counter() - begin:.1f} s", json.dumps(result[part])[:3000], flush=True)
        lines = ",\n".join(f"{json.dumps(name)}: {json.dumps(value)}" for name, value in result.items())
        args.out.write_text(f"{{\n{lines}\n}}\n".replace("NaN", "null"), encoding="utf-8")

    if "steps" in args.only:
        for name in list(SCENARIOS)[:-1]:
            measure(f"steps {name}", partial(steps, name, args.kernels))
    if "products" in args.only:
        measure("products", partial(products, args.kernels))
    if "ppo" in args.only:
        for name, own in TRAININGS.items():
            measure(f"ppo {name}", partial(training, args.kernels, name, args.seconds, *own))
            for seed in ("1", "2"):
                arguments = (*own, "--seed", seed, "--until", "0.99", "--evaluate-every", "0.5")
                measure(f"ppo {name} {seed}", partial(training, args.kernels, name, 10.0, *arguments))
    if "crazyflow" in args.only:
        measure("crazyflow", crazyflow)


if __name__ == "__main__":
    main()
