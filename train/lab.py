"""Train networks that balance on measurements alone, on a GPU: imitation of `lqg`, then gradients of the tracking cost.

    python train/lab.py --out runs/lab                                          # five networks (seeds) side by side
    python train/lab.py --kernels DIR --prepare                                 # only writes the sources
    python train/lab.py --kernels DIR                                           # needs no CasADi then
    python train/lab.py --device c --seeds 0 --rows 32                          # without a GPU, a smaller training

The networks read the inputs of `quadpend_baselines.hybrid.lab`. Environments, inputs, the teacher (the C that `quadpend
export` writes) and the derivatives of the motion are generated kernels. A window of flight and its update are one CUDA
graph. The cost is that of `quadpend_train.training.apg`. Its gradient passes through the motion, what the sensors
measure, the inputs and the network; noise, lost samples and the ends of episodes are not in it. Writes a policy file
for each network.
"""

import argparse
import re
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from copy import deepcopy
from dataclasses import replace
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

import quadpend_baselines
from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.hybrid.lab import FILTER, FOLLOWING, LAB_SIZE, LAGS, NEAR, OUTPUT, lab_part
from quadpend_baselines.policy.told import scaled_pole
from quadpend_gym import __version__, physics
from quadpend_gym.device.env import Kernel, Motion, QuadPendulumDeviceEnv
from quadpend_gym.device.library import Library
from quadpend_gym.physics.plant_kernel import LOOP_SIZE
from quadpend_gym.physics.rigid_settings import nominal_loop
from quadpend_gym.physics.state import ACTION_SIZE, DIRECTION, EULER, EULER_RATE, POSITION
from quadpend_gym.scenarios.library import as_scenario
from quadpend_gym.tasks.observation import LAB
from quadpend_gym.vehicles.parameters import ROD_LENGTH
from quadpend_gym.wind.base import SAMPLE_SIZE
from quadpend_train.common.files import atomic, write_text
from quadpend_train.common.provenance import provenance
from quadpend_train.policies.mlp_policy import FORMAT, MlpPolicy

NOISE = {"kind": "noise", "position": 0.0005, "euler": {"white": 0.001, "bias": 0.01}, "direction": 0.0006}
# Accelerations of 1.7 to 2.4 m/s² along each axis
RISING = {"amplitude": [1.0, 0.5, 0.4, 0.3], "frequency": [1.3, 1.9, 2.2, 0.9], "phase": [0.0, 1.0, 2.0, 0.0]}
BOUNCING = {"amplitude": [0.6, 0.8, 0.25, 0.3], "frequency": [2.0, 1.5, 3.1, 1.3], "phase": [0.0, 2.0, 1.0, 0.0]}
BREEZE = {"kind": "ornstein_uhlenbeck", "force": 0.05}


def drawn(low: float, high: float, **wind: Any) -> dict[str, Any]:
    """Return a wind whose strength is drawn for each episode."""
    return {"kind": "drawn", "wind": wind, "strength": [low, high]}


# Scenarios to train in: one of this package, and what differs from it. Events are up to nine times as strong as those
# of the set `events`.
CHANGES: dict[str, tuple[str, dict[str, Any]]] = {
    "wind": ("flight_training_wind", {}),
    "turbulence": ("flight_training_turbulence", {}),
    "storm": ("flight_training_storm", {}),
    "storm again": ("flight_training_storm", {}),
    "push": ("flight_training_push", {}),
    "late": (
        "flight_training_late",
        {"loop": {"latency": [0.01, 0.038], "jitter": 0.002, "rate_loop": [0.8, 1.2], "thrust": [0.8, 1.2]}},
    ),
    "losses": (
        "flight_training_noisy",
        {
            "sensors": NOISE,
            "actuators": [{"kind": "packet_loss", "probability": 0.15}, {"kind": "gyro_bias", "deviation": 0.02}],
        },
    ),
    "uncertain": ("flight_training_uncertain", {}),
    "motion": ("flight_training_motion", {}),
    "fast": ("flight_training_fast", {"task": {"references": {"acceleration": [1.0, 5.0]}}}),
    "wide": ("flight_training_wide", {}),
    "sharp": ("flight_training_fast", {"task": {"references": {"radius": [0.6, 1.5], "acceleration": [3.0, 7.0]}}}),
    "rising": ("flight_training_motion", {"task": {"trajectory": RISING}}),
    "bouncing": ("flight_training_motion", {"task": {"trajectory": BOUNCING}}),
    "gusts": ("flight_training_wind", {"wind": drawn(0.3, 1.5, kind="gusts", velocity=[2.0, 0.0, 0.0])}),
    "upset": ("flight_training_upset", {}),
    "jump": ("event_training_jump", {"task": {"jumps": {"distance": [0.03, 2.5], "yaw": [0.0, 3.0]}}}),
    "dropouts": (
        "event_training_dropouts",
        {"sensors": [NOISE, {"kind": "bursts", "length": [0.01, 0.6], "pause": [0.8, 1.0]}]},
    ),
    "blind": (
        "event_training_dropouts",
        {"sensors": [NOISE, {"kind": "bursts", "length": [0.3, 0.9], "pause": [0.8, 1.2]}]},
    ),
    "frozen": (
        "event_training_frozen",
        {"sensors": [NOISE, {"kind": "frozen", "length": [0.01, 0.3], "pause": [1.0, 2.0]}]},
    ),
    "outliers": (
        "event_training_outliers",
        {"sensors": [NOISE, {"kind": "outliers", "distance": [0.02, 4.0], "pause": [1.5, 2.5]}]},
    ),
    "pole force": (
        "event_training_pole_force",
        {"wind": drawn(0.1, 2.5, kind="ornstein_uhlenbeck", force=0.0, bob_force=0.05, time_constant=0.7)},
    ),
    "strong pole force": (
        "event_training_pole_force",
        {"wind": drawn(0.8, 2.0, kind="ornstein_uhlenbeck", force=0.0, bob_force=0.05, time_constant=0.7)},
    ),
    "wind step": (
        "event_training_wind_step",
        {"wind": drawn(0.1, 2.0, kind="step", velocity=[3.0, 0.0, 0.0], at=[3.0, 5.0])},
    ),
    "catch": (
        "event_training_catch",
        {"wind": [BREEZE, {"kind": "hold", "distance": [0.005, 0.12], "until": [0.5, 4.0]}]},
    ),
    "pole untold": (
        "event_training_pole_untold",
        {"parameters": {"share": 0.35, "names": ["bob_mass", "rod_length"]}},
    ),
    "thrust": ("event_training_thrust", {"loop": {"changes": {"at": [2.0, 6.0], "thrust": [0.5, 1.0]}}}),
    "rotor": ("event_training_rotor", {"loop": {"changes": {"at": [2.0, 6.0], "rotors": [0.25, 1.0]}}}),
    "turning": ("event_training_turning", {"task": {"references": {"yaw_amplitude": 5.6}}}),
    "start": ("event_training_start", {"task": {"start": {"pendulum_angle": [0.3, 0.7]}}}),
    "noisy": ("flight_training_noisy", {"sensors": {**NOISE, "level": [3.0, 4.5]}}),
}
POLES = {f"pole {factor}": factor for factor in (0.35, 0.55, 0.8, 1.25, 1.6)}  # told, of these lengths
OWN = {*POLES, "noisy"}  # scenarios with inputs and a teacher of their own, for their vehicle and their known noise
# A scenario whose motion is that of all of them: it has their longest latency, and a hand
MOTION: tuple[str, dict[str, Any]] = (
    "event_training_catch",
    {"loop": {"latency": [0.01, 0.038], "jitter": 0.002, "changes": {"at": [2.0, 6.0], "rotors": [0.25, 1.0]}}},
)
MEMORIES = {"lags": LAGS, "filter": FILTER}  # inputs; without the filter there is no feedback either
TAUGHT = 400  # numbers that a teacher remembers, at most
SETTINGS = "scenarios", "seeds", "rows", "without", "imitation", "gradients"  # that policies depend on
NEVER = -1e6  # when an action acts that is older than all under way
HIDDEN = 120  # width of the two hidden layers
STEPS, BATCHES = 16, 8  # of a window of imitation
PARTS = 10  # of imitation and of gradients, after which an interrupted training goes on
SMALL = 0.1  # output of a network whose relative error counts half
WINDOW = 100  # control steps of a window of gradients
RESTARTED = 0.125  # share of the rows that begin an episode with each window of gradients
RATES = (3e-3, 1e-5), (4e-4, 1e-5)  # learning rates of the imitation and of the gradients, from and to
WEIGHT = 4.0  # of the root mean square of the error, 1/m
LARGEST = 1e6  # gradient of a row's cost with respect to its state
SMALLEST = 5e-4  # error of the logarithm, m
ENOUGH = 0.6  # margin to a limit above which leaning costs nothing
TEACH = """
typedef char memory_suffices[sizeof(lqg_policy) <= 4 * TAUGHT ? 1 : -1];
ROWS(teach_rows, const float *seen, const float *applied, const unsigned char *begun, float *memory, float *label) {
  EACH_ROW {
    lqg_policy p;
    float *flat = (float *)&p, *sample = (float *)&p.sample, *target = (float *)&p.target;
    LOAD(flat, memory, (int)(sizeof p / 4));
    if (begun[i]) p.running = 0;
    LOAD(p.action, applied, 4);
    for (int f = 0; f < SEEN; ++f) *(f < 11 ? sample + f : target + f - 11) = seen[f * n + i] * UNITS[f];
    act(&p);
    if (!(is_bounded(MEMORY, p.memory, 1e15f) && is_bounded(18, p.memory, 300.0f) && is_bounded(4, p.action, 2))) {
      p.running = 0;
      for (int c = 0; c < 4; ++c) p.action[c] = 0;
    }
    STORE(label, p.action, 4);
    STORE(memory, flat, (int)(sizeof p / 4));
  }
}
"""


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    """Return the settings."""
    parser = argparse.ArgumentParser(description="Train networks on measurements alone, on a GPU.")
    add = parser.add_argument
    add("--out", type=Path, default=Path("runs/lab"), help="folder of the policies")
    add("--kernels", type=Path, help="folder of the generated sources; by default in that of the policies")
    add("--prepare", action="store_true", help="only write the generated sources")
    add("--device", default="cuda", help="cuda, or c for the processor")
    add("--scenarios", nargs="+", default=[*CHANGES, *POLES], help="some of the training scenarios")
    add("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4], help="of the networks, which train side by side")
    add("--rows", type=int, default=128, help="sub-environments of a network in each scenario")
    add("--without", nargs="+", choices=[*MEMORIES], default=[], help="parts of the memory that the networks lack")
    add("--imitation", type=int, default=2600, help="windows of 16 steps in which the networks imitate lqg")
    add("--gradients", type=int, default=1380, help="windows of 100 steps of gradients")
    args = parser.parse_args(arguments)
    if unknown := set(args.scenarios) - {*CHANGES, *POLES}:
        parser.error(f"there is no training scenario {min(unknown)!r}, only {', '.join([*CHANGES, *POLES])}")
    for name, least in {"rows": 1, "imitation": 0, "gradients": 0}.items():
        if (number := getattr(args, name)) < least:
            parser.error(f"--{name} must be at least {least}, not {number}")
    if not (args.imitation or args.gradients or args.prepare):
        parser.error("--imitation and --gradients are both 0: nothing would be trained")
    if not args.prepare and args.device != "c" and not torch.cuda.is_available():
        parser.error(f"--device {args.device} needs a GPU, and PyTorch finds none: --device c trains on a processor")
    if len({*args.seeds}) < len(args.seeds) or min(args.seeds) < 0:
        parser.error(f"--seeds must be different and at least 0, not {' '.join(map(str, args.seeds))}")
    if made := [file for seed in args.seeds if (file := args.out / f"lab-{seed}.npz").exists() and not args.prepare]:
        parser.error(f"{made[0]} exists: give another --out")
    args.kernels = args.kernels or args.out / "kernels"
    args.scenarios = sorted(args.scenarios, key=OWN.__contains__)  # those with common inputs beside each other
    return args


@cache
def head() -> str:
    """Return the first line of a source of inputs, which names their equations and the training scenarios."""
    folders = Path(quadpend_baselines.__file__).parent, Path(physics.__file__).parent
    files = sorted(path for folder in folders for path in folder.rglob("*") if path.suffix in {".py", ".toml"})
    texts = "".join([path.read_text("utf-8") for path in files] + [TEACH, repr((CHANGES, POLES, MOTION))])
    return f"/* quadpend_gym {__version__}, inputs {sha256(texts.encode()).hexdigest()[:16]} */\n"


@cache
def training_scenario(name: str) -> Any:
    """Return a training scenario."""
    if name not in POLES:
        base, changes = CHANGES[name]
        return as_scenario(base, **changes)
    found = as_scenario("event_training_pole_told", parameters={"share": 0.65, "names": ["bob_mass"]})
    return replace(found, vehicle=replace(found.vehicle, pole=scaled_pole(found.vehicle.pole, POLES[name])))


def prepare(folder: Path, vehicle: str) -> None:
    """Write the source of inputs and teacher for one of `OWN`, or for the other scenarios, ``"hummingbird"``."""
    import casadi as ca

    from quadpend_gym.device.control_step import rows_of
    from quadpend_train.common.lifted import function, row, seen_by
    from quadpend_train.export.to_c import export_c
    from quadpend_train.policies.loading import load_policy

    scenario = training_scenario(vehicle if vehicle in OWN else "wind")
    part = lab_part(scenario.simulation, Loop.known(scenario).noise)

    def make(observed: Any, action: Any, memory: Any) -> dict[str, Any]:
        nothing = ca.SX(ACTION_SIZE, 1), ca.SX(0, 1), row(ca.SX(0, 1))
        return dict(zip(("seen", "after"), seen_by((part,), observed, action, *nothing, memory), strict=True))

    read = function("read", make, observed=LAB.size, action=ACTION_SIZE, memory=part.memory_size)
    symbols, bars = read.sx_in(), [ca.SX.sym("bar", read.numel_out(i)) for i in range(2)]
    total = sum(ca.dot(value, bar) for value, bar in zip(read(*symbols), bars, strict=True))
    products = ca.cse([ca.densify(ca.gradient(total, symbol)) for symbol in symbols])
    names = [*read.name_in(), "bar_seen", "bar_after"], ["bar_observed", "bar_action", "bar_memory"]
    inputs = rows_of(read, ca.Function("back", [*symbols, *bars], products, *names))
    source = folder / "lqg.c"
    export_c(load_policy("lqg"), "lqg", as_scenario(scenario, parameters=None, pole_told=False), source)
    text = source.read_text(encoding="utf-8")
    text = text[: text.index("typedef lqg_real real;")] + text[text.index("#define SEEN") :]  # `rows_of` has the others
    text = text.replace('#include "lqg.h"', source.with_suffix(".h").read_text(encoding="utf-8"))
    text = re.sub(r"^static void (\w+)\(const real", r"SLOW void \1(const real", text, flags=re.MULTILINE)
    text = re.sub(r"  static void \(\*const advance\[PARTS\]\).*\n", "", text).replace("advance[k](", "advance_0(")
    if "advance_1(" in text:
        raise ValueError("the teacher must have a latency of whole control periods")
    taught = f"#define TAUGHT {TAUGHT}\n#define q_tanh(x) tanhf(x)\n{text}{TEACH}"
    write_text(folder / f"{vehicle}.c", f"{head()}{inputs}\n{taught}")


class Inputs(torch.autograd.Function):
    """The inputs of the networks and their memory, for rows of several vehicles."""

    @staticmethod
    def forward(ctx: Any, vehicles: Any, observed: Tensor, action: Tensor, memory: Tensor) -> Any:
        """Return inputs and memory."""
        ctx.vehicles = vehicles
        ctx.save_for_backward(observed, action, memory)
        return Inputs.run(vehicles, "read_rows", (observed, action, memory), (LAB_SIZE, len(memory)))

    @staticmethod
    def backward(ctx: Any, *bars: Tensor) -> Any:
        """Return the gradients."""
        given = (*ctx.saved_tensors, *bars)
        return None, *Inputs.run(ctx.vehicles, "back_rows", given, (LAB.size, ACTION_SIZE, len(bars[1])))

    @staticmethod
    def run(vehicles: Any, name: str, given: tuple[Tensor, ...], sizes: tuple[int, ...]) -> tuple[Tensor, ...]:
        """Return the results of a function, shapes (size, rows)."""
        found = []
        for library, rows in vehicles:
            own = [item[:, rows].contiguous() for item in given]
            found.append([own[0].new_empty(size, own[0].shape[1]) for size in sizes])
            library(name, own[0].shape[1], *own, *found[-1])
        return tuple(torch.cat(items, 1) for items in zip(*found, strict=True))


class Networks(nn.Module):
    """Networks side by side: every parameter has one of each first."""

    mask: Tensor  # 0 where the networks do not see an input
    near: slice  # inputs to which the outputs are added

    def __init__(self, seeds: list[int], without: list[str]) -> None:
        super().__init__()
        count = len(seeds)
        sizes = (LAB_SIZE, HIDDEN), (HIDDEN, HIDDEN), (HIDDEN, ACTION_SIZE)
        self.weights = nn.ParameterList(torch.empty(count, *size) for size in sizes)
        self.biases = nn.ParameterList(torch.zeros(count, 1, size[1]) for size in sizes)
        for i, seed in enumerate(seeds):
            random = torch.Generator().manual_seed(seed)
            for weights in self.weights:
                gain = 0.01 if weights.shape[2] == ACTION_SIZE else 1.4
                nn.init.orthogonal_(weights.data[i], gain, generator=random)
        self.register_buffer("mask", torch.ones(1, LAB_SIZE, 1), persistent=False)
        for name in without:
            self.mask[:, MEMORIES[name]] = 0.0
        self.weights[0].data *= self.mask
        if without:
            self.weights[0].register_hook(lambda gradient: gradient * self.mask)
        self.near = FOLLOWING if "filter" in without else NEAR

    def forward(self, x: Tensor) -> Tensor:
        """Return the outputs, shape (networks, n, 4), for inputs of shape (networks, n, inputs)."""
        for i, (weights, biases) in enumerate(zip(self.weights, self.biases, strict=True)):
            x = torch.baddbmm(biases, x, weights)
            x = nn.functional.elu(x) if i < 2 else x
        return x


class Flight:
    """The rows of all scenarios: those of a scenario beside each other, and in them those of a network."""

    def __init__(self, args: argparse.Namespace) -> None:
        self.args, self.device = args, torch.device("cpu" if args.device == "c" else args.device)
        names, each, folder = args.scenarios, len(args.seeds) * args.rows, args.kernels
        self.columns = [slice(i * each, (i + 1) * each) for i in range(len(names))]
        self.rows, parts = each * len(names), [name if name in OWN else "hummingbird" for name in names]
        spans = [
            (vehicle, slice(parts.index(vehicle) * each, (parts.index(vehicle) + parts.count(vehicle)) * each))
            for vehicle in dict.fromkeys(parts)
        ]

        def environment(name: str) -> QuadPendulumDeviceEnv:
            file = folder / f"env {name}.c"
            return QuadPendulumDeviceEnv(each, training_scenario(name), device=args.device, kernel=file)

        def vehicle(name: str) -> Library:
            file = folder / f"{name}.c"
            if not (source := file.read_text(encoding="utf-8")).startswith(head()):
                raise ValueError(f"{file} is of another version: remove {folder}, or give another folder")
            return Library(source, args.device, torch.float32)

        folder.mkdir(parents=True, exist_ok=True)
        for name, _ in spans:
            if not (folder / f"{name}.c").exists():
                prepare(folder, name)
        with ThreadPoolExecutor(12 if (folder / "motion.c").exists() else 1) as pool:
            envs, libraries = pool.map(environment, names), pool.map(vehicle, [name for name, _ in spans])
            self.envs, found = list(envs), list(libraries)
        self.motion = Motion(MOTION[0], device=args.device, kernel=folder / "motion.c", **MOTION[1])
        self.vehicles = [(library, rows) for library, (_, rows) in zip(found, spans, strict=True)]
        self.taught = [self.zeros(TAUGHT, rows.stop - rows.start) for _, rows in self.vehicles]
        remembered = lab_part(training_scenario("wind").simulation).memory_size
        self.seen, self.memory = self.zeros(LAB.size, self.rows), self.zeros(remembered, self.rows)
        self.action = self.zeros(ACTION_SIZE, self.rows)
        self.begun = torch.ones(self.rows, dtype=torch.bool, device=self.device)
        self.begin(0)
        tasks = [env.scenario.task.limits for env in self.envs]
        limits = [[np.cos(item.pendulum_angle), np.cos(item.body_angle), item.tracking_error] for item in tasks]
        self.limits = self._per_row(limits)
        (self.unscored,) = self._per_row([[env.scenario.unscored] for env in self.envs])
        self.loop, self.arrival = self._nominal()

    def begin(self, part: int) -> None:
        """Begin other flights, those of a part of the training."""
        first = 10_000_000 + 14_000_000 * self.args.seeds[0] + 200_000 * part
        for i, (env, rows) in enumerate(zip(self.envs, self.columns, strict=True)):
            self.seen[:, rows] = env.reset(seed=first + 5_000 * i)[0].T
        for memory in (self.action, self.memory, *self.taught):
            memory.zero_()
        self.begun.fill_(True)

    def zeros(self, *shape: int) -> Tensor:
        """Return zeros on the device."""
        return torch.zeros(*shape, device=self.device)

    def _per_row(self, numbers: Any) -> Tensor:
        """Return numbers of the scenarios, shape (scenarios, k), for all rows, shape (k, rows)."""
        array = torch.tensor(numbers, dtype=torch.float32, device=self.device)
        return array.repeat_interleave(self.rows // len(self.envs), 0).T.contiguous()

    def _nominal(self) -> tuple[Tensor, Tensor]:
        """Return the loop of the scenarios that draw none, and when each action acts in it."""
        scenario = training_scenario("wind")
        sizes = Kernel.of(scenario, self.args.kernels / "env wind.c").sizes
        loop = [*nominal_loop(scenario.simulation)[:LOOP_SIZE], 0.0]
        ages = np.arange(self.motion.sizes["slots"] - 1, -1, -1)
        arrival = np.where(ages < sizes["slots"], sizes["delay"] - sizes["substeps"] * ages, NEVER)
        loops, arrivals = (
            torch.tensor(list(item), dtype=torch.float32, device=self.device) for item in (loop, arrival)
        )
        return loops[:, None], arrivals[:, None]

    def gather(self, name: str) -> Tensor:
        """Return a part of the memories of all environments."""
        return torch.cat([env.part(name) for env in self.envs], 1)

    def under_way(self) -> Tensor:
        """Return the actions under way, as many as those of the motion."""
        most = ACTION_SIZE * (self.motion.sizes["slots"] - 1)
        queues = [env.part("queue") for env in self.envs]
        return torch.cat([nn.functional.pad(queue, (0, 0, most - len(queue), 0)) for queue in queues], 1)

    def drawn(self, action: Tensor) -> tuple[Tensor, ...]:
        """Return the action after the actuators, wind, loop and arrivals of the next step."""
        slots, found = self.motion.sizes["slots"], []
        for env, rows in zip(self.envs, self.columns, strict=True):
            drawn, n = env.drawn(action[:, rows].T), env.num_envs
            wind = nn.functional.pad(drawn["wind"], (0, 0, 0, SAMPLE_SIZE - len(drawn["wind"])))
            loop, arrival = self.loop.expand(-1, n), self.arrival.expand(-1, n)
            if env.sizes["drawn"]:
                loop, arrival = drawn["loop"], torch.cat([env.part("arrival"), drawn["arrival"]])
                arrival = nn.functional.pad(arrival, (0, 0, slots - len(arrival), 0), value=NEVER)
            found.append((drawn["action"], wind, loop, arrival))
        return tuple(torch.cat(items, 1) for items in zip(*found, strict=True))

    def step(self, action: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Step all environments; return the observations, which rows began an episode, and which of them fell."""
        results = [env.step(action[:, rows].T) for env, rows in zip(self.envs, self.columns, strict=True)]
        fell = torch.cat([result[2] for result in results])
        return torch.cat([result[0].T for result in results], 1), fell | torch.cat([r[3] for r in results]), fell

    def restart(self, mask: Tensor) -> None:
        """Begin an episode in the rows of a mask."""
        for env, rows in zip(self.envs, self.columns, strict=True):
            first, _ = env.reset(options={"reset_mask": mask[rows]})
            self.seen[:, rows] = torch.where(mask[rows], first.T, self.seen[:, rows])
        self.keep(self.seen, self.action, self.memory, mask)

    def keep(self, seen: Tensor, action: Tensor, memory: Tensor, begun: Tensor) -> None:
        """Keep what the next step needs; rows whose episode has begun remember nothing."""
        self.seen.copy_(seen)
        self.action.copy_(torch.where(begun, 0.0, action))
        self.memory.copy_(torch.where(begun, 0.0, memory))
        self.begun.copy_(begun)

    def inputs(self, seen: Tensor, action: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
        """Return the inputs of the networks and their memory."""
        found: tuple[Tensor, Tensor] = Inputs.apply(self.vehicles, seen, action, memory)  # type: ignore[no-untyped-call]
        return found

    def teach(self) -> Tensor:
        """Return the actions of the teachers."""
        labels = []
        for (library, rows), memory in zip(self.vehicles, self.taught, strict=True):
            given = [item[..., rows].contiguous() for item in (self.seen, self.action, self.begun)]
            labels.append(torch.empty_like(given[1]))
            library("teach_rows", rows.stop - rows.start, *given, memory, labels[-1])
        return torch.cat(labels, 1)

    def for_networks(self, items: Tensor) -> Tensor:
        """Return an array of shape (k, rows) as (networks, rows of one, k)."""
        parts = items.view(len(items), len(self.envs), -1, self.args.rows)
        return parts.permute(2, 1, 3, 0).flatten(1, 2)

    def for_rows(self, items: Tensor) -> Tensor:
        """Undo `for_networks`."""
        parts = items.view(len(items), len(self.envs), self.args.rows, -1)
        return parts.permute(3, 1, 0, 2).flatten(1)

    def mean(self, items: Tensor) -> Tensor:
        """Return the means of numbers of the rows in each scenario, shape (scenarios, networks)."""
        return items.view(len(self.envs), -1, self.args.rows).mean(2)


def measured(x: Tensor) -> Tensor:
    """Return what the sensors measure of states, as the observation `LAB` has it, shape (10, n)."""
    half = 0.5 * x[EULER : EULER + 3]
    (cx, cy, cz), (sx, sy, sz) = torch.cos(half), torch.sin(half)
    w, i = cz * cy * cx + sz * sy * sx, cz * cy * sx - sz * sy * cx
    j, k = cz * sy * cx + sz * cy * sx, sz * cy * cx - cz * sy * sx
    horizontal, up = x[DIRECTION : DIRECTION + 2] / 0.25, x[DIRECTION + 2 : DIRECTION + 3]
    return torch.cat([x[POSITION : POSITION + 3], torch.stack([w, i, j, k]), horizontal, up])


def costs(x: Tensor, action: Tensor, seen: Tensor, length: Tensor, limits: Tensor) -> tuple[Tensor, Tensor]:
    """Return the squared tracking error (m²) and the further cost of `quadpend_train.training.apg`, shape (n,)."""
    target, yaw = seen[LAB.columns["reference_0"]], seen[LAB.columns["yaw_reference"].start]
    arm = torch.cat([length * x[DIRECTION : DIRECTION + 2], torch.zeros_like(length)])
    squared = ((x[POSITION : POSITION + 3] + arm - target) ** 2).sum(0)
    turned = x[EULER + 2] - yaw
    turned = turned - 2.0 * torch.pi * torch.round(turned.detach() / (2.0 * torch.pi))
    level = torch.cos(x[EULER]) * torch.cos(x[EULER + 1])
    near = 1.0 - torch.sqrt(squared + 1e-12) / limits[2]
    tilts = [(value - limit) / (1.0 - limit) for value, limit in zip((x[DIRECTION + 2], level), limits, strict=False)]
    lean = (torch.relu(ENOUGH - torch.stack([*tilts, near])) ** 2).sum(0)
    rate = (x[EULER_RATE : EULER_RATE + 3] ** 2).sum(0)
    return squared, 0.1 * turned**2 + 1e-3 * (action**2).sum(0) + 1e-4 * rate + 100.0 * lean


def imitation_loss(outputs: Tensor, wanted: Tensor) -> Tensor:
    """Return the relative error of the outputs of each network, in which small corrections count most."""
    error, size = (torch.sqrt((item**2).sum(2) + 1e-7) for item in (outputs - wanted, wanted))
    return (error / (SMALL + size)).mean(1)


class Trainer:
    """Imitation and gradients."""

    def __init__(self, args: argparse.Namespace, networks: Networks) -> None:
        self.args, self.flight = args, Flight(args)
        device, fast = self.flight.device, self.flight.device.type == "cuda"
        self.networks = networks.to(device)
        self.parameters = list(self.networks.parameters())
        self.rate, self.share = torch.tensor(0.0, device=device), torch.tensor(1.0, device=device)
        self.optimizer = torch.optim.Adam(self.parameters, lr=self.rate, capturable=fast, fused=fast)
        for p in self.parameters:
            p.grad = torch.zeros_like(p)
        self.optimizer.step()  # makes its state
        for state in self.optimizer.state.values():
            for value in state.values():
                value.zero_()
        spread = 0.1 * torch.linspace(0.0, 1.0, args.rows, device=device) ** 2
        self.noise = spread.repeat(len(self.flight.envs) * len(args.seeds))  # standard deviation of that on the actions
        self.loss, shape = self.flight.zeros(len(args.seeds)), (len(self.flight.envs), len(args.seeds))
        self.falls, self.squares, self.scored = (self.flight.zeros(*shape) for _ in range(3))

    def inputs(self, seen: Tensor, action: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
        """Return the inputs of the networks and their memory."""
        return self.flight.inputs(seen, action, memory)

    def act(self, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Return the actions that the networks want, and the outputs; more than ±1 of these is not added."""
        outputs = self.flight.for_rows(self.networks(self.flight.for_networks(inputs)))
        return OUTPUT * outputs.clamp(-1.0, 1.0) + inputs[self.networks.near], outputs

    def descend(self, loss: Tensor) -> None:
        """Take a step of Adam for the loss of each network; its gradient has at most the length 1."""
        torch.autograd.backward(loss.sum())
        gradients = [p.grad for p in self.parameters if p.grad is not None]
        norm = torch.sqrt(torch.stack([item.flatten(1).square().sum(1) for item in gradients]).sum(0))
        scale = torch.where(torch.isfinite(norm), 1.0 / norm.clamp(min=1.0), 0.0)
        for item in gradients:
            item.nan_to_num_(0.0, 0.0, 0.0).mul_(scale[:, None, None])
        self.optimizer.step()
        self.optimizer.zero_grad(set_to_none=False)
        self.loss.copy_(loss.detach())

    def imitate(self) -> None:
        """Fly a window, and fit the networks to the actions of the teacher in it."""
        flight, inputs, labels = self.flight, [], []
        with torch.no_grad():
            for _ in range(STEPS):
                seen, memory = self.inputs(flight.seen, flight.action, flight.memory)
                label, (own, _) = flight.teach(), self.act(seen)
                inputs.append(flight.for_networks(seen))
                labels.append(flight.for_networks(((label - seen[self.networks.near]) / OUTPUT).clamp(-1.0, 1.0)))
                acts = torch.rand(flight.rows, device=flight.device) < self.share
                action = torch.where(acts, label, own) + self.noise * torch.randn_like(own)
                action = action.nan_to_num(0.0).clamp(-1.0, 1.0)
                observed, begun, fell = flight.step(action)
                flight.keep(observed, action, memory, begun)
                self.falls += flight.mean(fell.float()) * self.args.rows
        self.fit(inputs, labels)

    def fit(self, inputs: list[Tensor], labels: list[Tensor]) -> None:
        """Fit the networks to outputs in some steps, shapes (networks, rows of one, k)."""
        x, y = torch.cat(inputs, 1), torch.cat(labels, 1)
        order = torch.rand(x.shape[1], device=x.device).argsort()
        for part in order[: len(order) // BATCHES * BATCHES].view(BATCHES, -1):
            self.descend(imitation_loss(self.networks(x[:, part]), y[:, part]))

    def improve(self) -> None:
        """Fly a window, and follow the gradient of its cost."""
        flight = self.flight
        flight.restart(torch.rand(flight.rows, device=flight.device) < RESTARTED)
        seen, action, memory = flight.seen.clone(), flight.action.clone(), flight.memory.clone()
        x, under_way = flight.gather("x").clone(), flight.under_way()
        squares, further, scored = [], [], []
        bound = LARGEST * len(self.args.seeds) / (WINDOW * flight.rows)

        def limited(bar: Tensor) -> Tensor:
            finite: Tensor = bar.nan_to_num(0.0, 0.0, 0.0)
            length: Tensor = torch.linalg.vector_norm(finite, dim=0)
            return finite.mul((bound / (length + 1e-12)).clamp(max=1.0))

        for _ in range(WINDOW):
            inputs, memory = self.inputs(seen, action, memory)
            wanted, outputs = self.act(inputs)
            action = wanted.clamp(-1.0, 1.0)
            given = action.detach().nan_to_num(0.0)
            acted, *constants = flight.drawn(given)
            arrives = (acted - given).abs().amax(0) < 0.05  # where no packet is lost
            acted = acted + torch.where(arrives, action - action.detach(), 0.0)
            wind, loop, arrival = constants
            parameters, clock = flight.gather("parameters").clone(), torch.cat([env.clock for env in flight.envs])
            moved, under_way = flight.motion(x, under_way, acted, wind, parameters, loop, arrival)
            seen, begun, fell = flight.step(given)
            # The values are those of the environments, the slopes those of the motion.
            x = flight.gather("x").clone() + torch.where(begun, 0.0, moved - moved.detach())
            if x.requires_grad:
                x.register_hook(limited)  # type: ignore[no-untyped-call]
            square, cost = costs(x, action, seen, parameters[ROD_LENGTH : ROD_LENGTH + 1], flight.limits)
            excess = (torch.relu(torch.cat([wanted, outputs]).abs() - 1.0) ** 2).sum(0)
            squares.append(torch.where(begun, 0.0, square))
            further.append(torch.where(begun, 0.0, cost + excess))
            scored.append(((flight.envs[0].scenario.period * (1.0 + clock) > flight.unscored) & ~begun).float())
            slope = measured(x) - measured(x).detach()
            seen = torch.cat([seen[:10] + torch.where(begun, 0.0, slope), seen[10:]])
            action, memory, under_way = (torch.where(begun, 0.0, item) for item in (action, memory, under_way))
            self.falls += flight.mean(fell.float()) * self.args.rows
        square, weight = torch.stack(squares), torch.stack(scored)
        mean = (square * weight).sum(0) / weight.sum(0).clamp(min=1.0)
        logs = torch.where(weight.sum(0) > 0.5 * WINDOW, 0.5 * torch.log(mean + SMALLEST**2), 0.0)
        rmse = torch.sqrt(flight.mean(square.mean(0)) + 1e-6)
        loss = (WEIGHT * rmse + flight.mean(logs) + flight.mean(torch.stack(further).mean(0))).mean(0)
        self.descend(loss)
        self.squares += flight.mean((square * weight).sum(0)).detach()
        self.scored += flight.mean(weight.sum(0))
        flight.keep(seen.detach(), action.detach(), memory.detach(), begun)

    def graphed(self, function: Callable[[], None]) -> Callable[[], None]:
        """Return a function as a CUDA graph; what the networks learned while it was warmed up is undone."""
        run = function
        if self.flight.device.type == "cuda":
            start = deepcopy(self.state())
            stream = torch.cuda.Stream()  # type: ignore[no-untyped-call]
            stream.wait_stream(torch.cuda.current_stream())
            with torch.cuda.stream(stream):
                function()
                function()
            torch.cuda.current_stream().wait_stream(stream)
            graph = torch.cuda.CUDAGraph()
            with torch.cuda.graph(graph):
                function()
            run = graph.replay
            self.set_state(start)
            self.forget()
        return run

    def state(self) -> dict[str, Any]:
        """Return what the networks have learned."""
        return {"networks": self.networks.state_dict(), "optimizer": self.optimizer.state_dict()["state"]}

    def set_state(self, state: dict[str, Any]) -> None:
        """Set what `state` returned, in place."""
        self.networks.load_state_dict(state["networks"])
        with torch.no_grad():
            for i, p in enumerate(self.parameters):
                for name, value in self.optimizer.state[p].items():
                    value.copy_(state["optimizer"][i][name])

    def train(self) -> list[MlpPolicy]:
        """Imitate, then improve, each in ten parts; what an interrupted training has done of them is not repeated."""
        how = {name: getattr(self.args, name) for name in SETTINGS} | {"kernels": head()}
        file, done, seconds, runs = self.args.out / "training.pt", 0, 0.0, {}
        if file.exists():
            found = torch.load(file, map_location=self.flight.device)
            if found["how"] != how:
                raise SystemExit(f"{file} is of a training with other settings or equations: give another --out")
            done, seconds = found["done"], found["seconds"]
            self.set_state(found)
        stages = (self.imitate, self.args.imitation, RATES[0]), (self.improve, self.args.gradients, RATES[1])
        for part in range(done, 2 * PARTS):
            begin, (function, count, (first, last)) = time.perf_counter(), stages[part // PARTS]
            if count and function not in runs:
                runs = {function: self.graphed(function)}
            self.flight.begin(part)
            torch.manual_seed(1000 * self.args.seeds[0] + part)
            for k in range(count * (part % PARTS) // PARTS, count * (part % PARTS + 1) // PARTS):
                self.share.fill_(max(1.0 - 5.0 * k / count, 0.0))
                self.rate.fill_(first * (last / first) ** (k / count))
                runs[function]()
            seconds += time.perf_counter() - begin
            if count:
                with atomic(file) as new:
                    torch.save({**self.state(), "how": how, "done": part + 1, "seconds": seconds}, new)
                self.report(f"{function.__name__} {part % PARTS + 1}/{PARTS}, {seconds:.0f} s")
        return self.policies(how, seconds)

    def report(self, head: str) -> None:
        """Print the losses, and in each scenario the falls of a network and its root mean square error (mm)."""
        errors = 1e3 * torch.sqrt(self.squares.sum(1) / self.scored.sum(1).clamp(min=1.0))
        cells = zip(self.args.scenarios, self.falls.mean(1).tolist(), errors.tolist(), strict=True)
        losses = " ".join(f"{value:.4f}" for value in self.loss.tolist())
        print(f"{head}, loss {losses}:", ", ".join(f"{n} {f:.3g}/{e:.3g}" for n, f, e in cells), flush=True)
        self.forget()

    def forget(self) -> None:
        """Begin the sums of the next report."""
        for item in (self.falls, self.squares, self.scored):
            item.zero_()

    def policies(self, how: dict[str, Any], seconds: float) -> list[MlpPolicy]:
        """Return the policy of each network."""
        cuda, args = self.flight.device.type == "cuda", self.args
        steps = len(args.scenarios) * args.rows * (STEPS * args.imitation + WINDOW * args.gradients)
        device = torch.cuda.get_device_name() if cuda else "c"
        card: dict[str, Any] = {"format": FORMAT, "activation": "elu", "squashed": False, "provenance": provenance()}
        hybrid = {"kind": "lab_only", "base_controller": "lqg"}
        card |= {"hybrid": hybrid | ({} if self.networks.near == NEAR else {"feedback": False})}
        card |= {"script": {"file": "train/lab.py", **how}}
        card |= {"interface": "body_rates", "vehicle": "hummingbird", "device": device}
        card |= {"steps": steps, "seconds": round(seconds)}
        layers = [
            (weights.detach().cpu().numpy(), biases.detach().cpu().numpy())
            for weights, biases in zip(self.networks.weights, self.networks.biases, strict=True)
        ]
        return [
            MlpPolicy([(weights[i], biases[i, 0]) for weights, biases in layers], {**card, "seed": seed})
            for i, seed in enumerate(args.seeds)
        ]


def main(arguments: list[str] | None = None) -> None:
    """Train, or only write the sources."""
    args = parse(arguments)
    if args.prepare:
        args.device, args.seeds, args.rows = "c", [0], 1
        Flight(args)
    else:
        for policy in Trainer(args, Networks(args.seeds, args.without)).train():
            policy.save(file := args.out / f"lab-{policy.card['seed']}.npz")
            print(f"Saved: {file}")


if __name__ == "__main__":
    main()
