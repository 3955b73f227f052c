"""The generated control step computes what the environments compute: its build for the CPU, in double precision."""

import ctypes
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch

from quadpend_gym.core.arrays import Floats
from quadpend_gym.device.env import Motion, QuadPendulumDeviceEnv
from quadpend_gym.device.library import compile_cuda
from quadpend_gym.engines.functions import step_function
from quadpend_gym.scenarios.library import SETS, as_scenario
from tests.quadpend_gym.engines.inputs import SIMULATIONS, Inputs
from tests.quadpend_gym.engines.test_functions import call

LIMIT = 61  # control steps of an episode
SCENARIOS = ["windy", "flight_training_late"]
OWN: dict[str, dict[str, Any]] = {
    "paper, calm": {},
    "paper, drawn loop": {
        "loop": {"latency": (0.0, 0.03), "jitter": 0.004, "thrust": (0.9, 1.1)},
        "task": {"reward": {"action_rate": 0.5}},
    },
    "further events": {
        "task": {"reward": {"action_rate": 0.5}},
        "actuators": {"kind": "packet_bursts", "length": [0.03, 0.05], "pause": [0.05, 0.1]},
        "sensors": [
            {"kind": "frozen", "parts": ["pole"], "length": [0.02, 0.03], "pause": [0.05, 0.1]},
            {"kind": "outliers", "part": "pole", "distance": [0.5, 3.1], "pause": [0.05, 0.1]},
            {"kind": "outliers", "part": "attitude", "pause": [0.05, 0.1]},
        ],
    },
    "events": {
        "vehicle": "hummingbird",
        "interface": "body_rates",
        "observation": "lab",
        "task": {"jumps": {"distance": [0.1, 0.3], "yaw": [0.1, 0.8], "pause": [0.05, 0.2]}},
        "parameters": {"share": 0.3, "names": ["rod_length", "bob_mass"]},
        "pole_told": True,
        "loop": {
            "jitter": 0.003,
            "changes": {"at": [0.1, 0.3], "thrust": [0.7, 0.9], "rotors": [0.5, 0.9], "latency": [0, 0.03]},
        },
        "sensors": [
            {"kind": "noise", "position": 0.001, "euler": 0.01},
            {"kind": "bursts", "length": [0.03, 0.06], "pause": [0.05, 0.1]},
            {"kind": "frozen", "length": [0.02, 0.03], "pause": [0.05, 0.1]},
            {"kind": "outliers", "pause": [0.05, 0.1]},
            {"kind": "dropout", "probability": 0.2},
        ],
        "wind": [
            {"kind": "gusts", "velocity": 3.0, "pause": [0.1, 0.2]},
            {"kind": "ornstein_uhlenbeck", "bob_force": 0.1},
            {"kind": "hold", "until": [0.1, 0.5]},
        ],
    },
    "actuators and sensors": {
        "actuators": [
            {"kind": "action_delay", "steps": 2},
            {"kind": "motor_lag"},
            {"kind": "rate_limit", "rate": 5.0},
            {"kind": "packet_loss", "probability": 0.3},
        ],
        "sensors": [{"kind": "noise", "position": {"white": 0.001, "walk": 0.01}}, {"kind": "delay", "steps": 3}],
        "wind": [
            {"kind": "dryden", "intensity": "light"},
            "breeze",
            {"kind": "step", "force": 0.2, "at": [0.1, 0.3]},
        ],
        "latency": 0.015,
        "task": {"reward": {"action_rate": 0.5}},
    },
}
NAMES = {*SETS["training-flight"], *SETS["training-events"], "flight_training_loop_storm", "flight_sinusoids"}
OTHERS = [*OWN, *sorted({*NAMES, "flight_gusts"} - {*SCENARIOS})]


def in_ulps(a: Any, b: Floats) -> float:
    """Return the largest difference of two arrays in units in the last place of float32."""
    a = np.asarray(a).astype(np.float32)
    return float((np.abs(a - b) / np.maximum(np.spacing(np.maximum(np.abs(a), np.abs(b))), 1e-9)).max())


@pytest.mark.parametrize("name", [*SCENARIOS, *(pytest.param(name, marks=pytest.mark.extras) for name in OTHERS)])
def test_episodes_are_those_of_the_other_environments(name: str) -> None:
    scenario, rows = as_scenario(OWN.get(name, name)), 100
    rng = np.random.default_rng(1)
    env = QuadPendulumDeviceEnv(rows, scenario, device="c", dtype="float64", max_episode_steps=LIMIT)
    other = gym.make_vec("QuadPendulum-v0", rows, scenario=scenario, autoreset_mode="SameStep", max_episode_steps=LIMIT)
    first, _ = env.reset(seed=3)
    assert in_ulps(first, other.reset(seed=3)[0]) <= 1.0
    falls = 0
    for step in range(2 * LIMIT + 5):
        action = rng.uniform(-1.0, 1.0, (rows, 4)).astype(np.float32) * (0.3 if step % 2 else 0.9)
        observation, reward, terminated, truncated, info = env.step(torch.from_numpy(action))
        expected = other.step(action)
        assert in_ulps(observation, expected[0]) <= 1.0
        np.testing.assert_allclose(reward, expected[1], rtol=0.0, atol=1e-12)
        np.testing.assert_array_equal(terminated, expected[2])
        np.testing.assert_array_equal(truncated, expected[3])
        state: Floats = other.unwrapped.world.state  # type: ignore[attr-defined]
        scale = np.abs(state).max(axis=0) + 1e-3
        assert (np.abs(env.state.numpy() - state) <= 1e-12 * scale).all()
        for row in np.flatnonzero(expected[2] | expected[3]):
            assert in_ulps(info["final_obs"][row], expected[4]["final_obs"][row]) <= 1.0
        falls += expected[2].sum()
    assert (falls > 0) == (name != "event_training_catch")  # there a hand holds the pole for longer


@pytest.mark.parametrize("name", SIMULATIONS)
def test_derivatives_are_those_of_the_step_function(name: str) -> None:
    simulation, rows = SIMULATIONS[name], 50
    x, function = Inputs(simulation, rows), step_function(simulation, moves_air=True)
    fields = ("vehicle", "interface", "period", "substeps", "latency")
    motion = Motion({key: getattr(simulation, key) for key in fields}, device="c", dtype="float64", wind="still_air")
    state, memory, action, wind, parameters = (
        torch.from_numpy(np.array(item.T, np.float64, order="C")) for item in x.of_step()
    )
    size = motion.sizes["x"]
    whole = torch.cat([state, memory[: size - 18]]).requires_grad_()
    under_way, action = memory[size - 18 :].clone().requires_grad_(), action.requires_grad_()
    after = motion(whole, under_way, action, wind, parameters)
    np.testing.assert_allclose(torch.cat(after).detach().T, np.hstack(call(function, *x.of_step())), atol=1e-12)
    bar = np.random.default_rng(2).normal(size=(len(whole) + len(under_way), rows))
    torch.autograd.backward(after, [torch.from_numpy(bar[:size]), torch.from_numpy(bar[size:])])
    backward = function.factory(
        "back", [*function.name_in(), "adj:next_state", "adj:next_memory"], ["adj:state", "adj:memory", "adj:action"]
    )
    expected = np.hstack(call(backward, *x.of_step(), bar[:18].T, bar[18:].T))
    gradient = torch.cat([whole.grad, under_way.grad, action.grad]).T
    np.testing.assert_allclose(gradient, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("name", ["paper, drawn loop", "events"])
def test_the_motion_is_that_of_the_environment_for_what_it_draws(name: str) -> None:
    """Also with a drawn loop, its jitter and changes, and a hand."""
    env = QuadPendulumDeviceEnv(20, OWN[name], device="c", dtype="float64", max_episode_steps=LIMIT)
    motion, random = Motion(OWN[name], device="c", dtype="float64"), torch.Generator().manual_seed(0)
    env.reset(seed=3)
    for _ in range(2 * LIMIT):
        action = torch.rand(20, 4, generator=random).double() - 0.5
        drawn, parts = env.drawn(action), [env.part(part).clone() for part in ("x", "queue", "parameters")]
        arrival, newest = torch.cat([env.part("arrival"), drawn["arrival"]]), drawn["action"].float().double()
        given = parts[0], parts[1], newest, drawn["wind"], parts[2], drawn["loop"], arrival
        after, under_way = motion(*given)
        *_, terminated, truncated, _ = env.step(action)
        going = ~(terminated | truncated)
        np.testing.assert_allclose(after[:, going], env.part("x")[:, going], rtol=0.0, atol=1e-12)
        np.testing.assert_array_equal(under_way[:, going], env.part("queue")[:, going])
    with pytest.raises(ValueError, match="the scenario draws the loop: give Motion loop and arrival"):
        motion(*given[:5])


def test_single_precision_flies_like_double_precision() -> None:
    found = []
    for dtype in ("float32", "float64"):
        env = gym.make_vec("QuadPendulum-v0", num_envs=64, device="c", dtype=dtype, wind="windy")
        env.reset(seed=1)
        steps = [env.step(torch.zeros(64, 4)) for _ in range(30)]
        assert steps[-1][0].dtype is getattr(torch, dtype)
        found.append(steps[-1][0].double())
    np.testing.assert_allclose(*found, atol=2e-4)


def test_a_kernel_file_needs_no_casadi(tmp_path: Path) -> None:
    file = tmp_path / "kernel.c"
    expected = QuadPendulumDeviceEnv(4, device="c", kernel=file).reset(seed=0)[0]
    program = (
        "import sys; sys.modules['casadi'] = None\n"
        "import gymnasium as gym, quadpend_gym\n"
        "assert 'torch' not in sys.modules\n"
        f"env = gym.make_vec('QuadPendulum-v0', num_envs=4, device='c', kernel={str(file)!r})\n"
        "print(env.reset(seed=0)[0].double().sum().item())"
    )
    out = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert float(out) == expected.double().sum().item()
    with pytest.raises(ValueError, match="kernel of another scenario"):
        QuadPendulumDeviceEnv(4, device="c", kernel=file, wind="windy")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"scenario": "flight_waypoints"}, "no waypoints"),
        ({"scenario": "flight_loop", "loop": {"rotor_lag": (0.9, 1.1)}}, "does not draw loop.rotor_lag"),
        ({"sensors": {"kind": "bursts", "length": (0.001, 0.1), "pause": (0.0, 0.1)}}, "cannot step the sensor bursts"),
        ({"autoreset_mode": "NextStep"}, "autoreset_mode must be 'SameStep'"),
        ({"dtype": "float16"}, "dtype must be"),
        ({"num_envs": 0}, "num_envs must be"),
    ],
)
def test_what_is_not_covered_is_refused_by_name(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        gym.make_vec("QuadPendulum-v0", **{"num_envs": 2, "device": "c", **arguments})


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_without_a_gpu_there_is_one_sentence() -> None:
    with pytest.raises(ValueError, match="needs a GPU, and PyTorch finds none: device='c' computes the same"):
        gym.make_vec("QuadPendulum-v0", num_envs=2, device="cuda")


@pytest.mark.extras
@pytest.mark.parametrize("architecture", ["sm_80", "sm_90"])
@pytest.mark.parametrize("defines", ["", "#define SINGLE\n", "#define MOTION\n", "#define SINGLE\n#define MOTION\n"])
def test_nvrtc_compiles_the_source(architecture: str, defines: str) -> None:
    """``pip install nvidia-cuda-nvrtc`` brings NVRTC, which needs no GPU; NVRTC may name another file."""
    places = [
        os.environ.get("NVRTC", ""),
        *(str(f) for f in Path(torch.__file__).parents[1].glob("nvidia/*/lib/libnvrtc.so.*")),
    ]
    place = next((place for place in places if place), None)
    if place is None:
        pytest.skip("NVRTC is not installed: pip install nvidia-cuda-nvrtc")
    from quadpend_gym.device.control_step import control_step

    source = f"#define THREADS 128\n{defines}{control_step(as_scenario('flight_training_wind')).source}"
    assert len(compile_cuda(source, architecture, nvrtc=ctypes.CDLL(place))) > 10_000
