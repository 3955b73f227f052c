"""Tests of `DeviceVectorEnv` that `test_device_env.py` runs in processes of their own, in the simulator or on a GPU."""

import re
from typing import Any

import numpy as np
import pytest
import torch

from quadpend_gym import Constant, QuadPendulumVectorEnv, Reference, StillAir, Task, Waypoints
from quadpend_gym.gpu import DeviceVectorEnv
from quadpend_gym.gpu.device_functions import SIMULATED
from tests.helpers.sources import ROOT

ROWS = 4
TOLERANCE = 1e-12
SETTINGS: dict[str, dict[str, Any]] = {
    "track": {"max_episode_steps": 20},
    "hover in wind": {"task": "hover", "wind": Constant(force=(0.1, 0.2, 0.0), velocity=(2.0, 0.0, 0.0)) + StillAir()},
    "fixed reference": {"task": Task(trajectory=Reference.circle(1.0, 1.0)), "max_episode_steps": 20},
    "rotors": {"vehicle": "hummingbird", "interface": "rotors", "max_episode_steps": 20},
    "body rates, latency": {
        "vehicle": "hummingbird",
        "interface": "body_rates",
        "simulation": {"substeps": 4, "latency": 0.005},
        "wind": Constant(torque=(0.001, 0.0, 0.0)),
    },
}


def tensor(actions: Any) -> torch.Tensor:
    return torch.tensor(np.asarray(actions, np.float32), device="cpu" if SIMULATED else "cuda")


def numbers(array: Any) -> np.ndarray:
    return array.cpu().numpy()


def make(**settings: Any) -> DeviceVectorEnv:
    return DeviceVectorEnv(ROWS, **settings, from_dlpack=torch.from_dlpack)


def pair(**settings: Any) -> tuple[QuadPendulumVectorEnv, DeviceVectorEnv]:
    return QuadPendulumVectorEnv(ROWS, **settings, autoreset_mode="SameStep"), make(**settings)


def assert_equal_flights(cpu: QuadPendulumVectorEnv, device: DeviceVectorEnv, steps: int, size: float) -> int:
    """Step both environments with the same random actions, and return the number of episodes that ended."""
    random, ends = np.random.default_rng(0), 0
    for _ in range(steps):
        actions = random.uniform(-size, size, (ROWS, 4)).astype(np.float32)
        observation, reward, terminated, truncated, info = cpu.step(actions)
        on_device = device.step(tensor(actions))
        np.testing.assert_allclose(numbers(device.state), cpu.world.state, rtol=0.0, atol=TOLERANCE)
        np.testing.assert_allclose(numbers(on_device[0]), observation, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(numbers(on_device[1]), reward, rtol=0.0, atol=TOLERANCE)
        np.testing.assert_array_equal(numbers(on_device[2]), terminated)
        np.testing.assert_array_equal(numbers(on_device[3]), truncated)
        ended = terminated | truncated
        np.testing.assert_array_equal(numbers(on_device[4]["_final_obs"]), ended)
        for row in np.flatnonzero(ended):
            last = numbers(on_device[4]["final_obs"])[row]
            np.testing.assert_allclose(last, info["final_obs"][row], rtol=1e-6, atol=1e-6)
        ends += int(ended.sum())
    return ends


@pytest.mark.parametrize("name", SETTINGS)
def test_flights_are_those_of_the_cpu(name: str) -> None:
    cpu, device = pair(**SETTINGS[name])
    expected, _ = cpu.reset(seed=3)
    observation, _ = device.reset(seed=3)
    np.testing.assert_allclose(numbers(observation), expected, rtol=1e-6, atol=1e-6)
    ends = assert_equal_flights(cpu, device, 50, 0.3)
    assert ends == 2 * ROWS or "max_episode_steps" not in SETTINGS[name]


def test_falls_terminate_and_start_the_next_episode() -> None:
    cpu, device = pair()
    cpu.reset(seed=7)
    device.reset(seed=7)
    assert assert_equal_flights(cpu, device, 60, 1.0) > 0


def test_a_diverging_state_is_reset_and_terminates() -> None:
    cpu, device = pair(wind=Constant(force=1e12))
    cpu.reset(seed=0)
    device.reset(seed=0)
    assert assert_equal_flights(cpu, device, 2, 0.0) == 2 * ROWS


def test_a_reset_without_a_seed_starts_the_next_episode() -> None:
    cpu, device = pair()
    for seed in (5, None):
        expected, _ = cpu.reset(seed=seed)
        observation, _ = device.reset(seed=seed)
        np.testing.assert_allclose(numbers(observation), expected, rtol=1e-6, atol=1e-6)
    first, _ = make().reset()
    other, _ = make().reset()
    assert not torch.equal(first, other)


def test_tensors_share_the_memory_of_the_environment() -> None:
    cpu, device = pair()
    cpu.reset(seed=1)
    device.reset(seed=1)
    cpu.world.state[:, 0] += 0.25
    device.state[:, 0] += 0.25
    assert_equal_flights(cpu, device, 2, 0.1)


def test_the_arrays_of_a_step_stay_until_the_step_after_the_next_one() -> None:
    env, actions = make(), tensor(np.zeros((ROWS, 4)))
    first, _ = env.reset(seed=0)
    kept = first.clone()
    second = env.step(actions)[0]
    assert torch.equal(first, kept)
    assert not torch.equal(second, kept)
    assert env.step(actions)[0].data_ptr() == first.data_ptr()


def test_the_arrays_have_the_shapes_and_types_of_the_spaces() -> None:
    env = make()
    observation, _ = env.reset(seed=0)
    assert observation.shape == env.observation_space.shape
    assert observation.dtype == torch.float32
    _, reward, terminated, truncated, info = env.step(tensor(np.zeros((ROWS, 4))))
    assert reward.shape == terminated.shape == truncated.shape == (ROWS,)
    assert info["final_obs"].shape == observation.shape
    assert terminated.dtype == info["_final_obs"].dtype == torch.bool


@pytest.mark.parametrize("wrong", [1.1, -np.inf, np.nan])
def test_an_invalid_action_does_not_advance_its_row_and_is_reported(wrong: float) -> None:
    env, actions = make(), np.zeros((ROWS, 4))
    env.reset(seed=0)
    before = numbers(env.state).copy()
    actions[2, 1] = wrong
    reward = numbers(env.step(tensor(actions))[1])
    assert np.isnan(reward).tolist() == [False, False, True, False]
    assert (numbers(env.state) == before).all(1).tolist() == [False, False, True, False]
    with pytest.raises(ValueError, match=r"action of sub-environment 2 must be four numbers in \[-1, 1\]"):
        env.check_actions()
    env.check_actions()


def test_an_action_outside_by_rounding_is_clipped() -> None:
    cpu, device = pair()
    cpu.reset(seed=0)
    device.reset(seed=0)
    actions = np.full((ROWS, 4), np.float32(1.0000001))
    cpu.step(actions)
    device.step(tensor(actions))
    device.check_actions()
    np.testing.assert_allclose(numbers(device.state), cpu.world.state, rtol=0.0, atol=TOLERANCE)


REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "no rows": ({"num_envs": 0}, "num_envs must be a whole number of at least 1, not 0"),
    "gusts": ({"wind": "gusts"}, "wind must consist of Constant and StillAir on the device, not "),
    "waypoints": (
        {"task": Task(trajectory=Waypoints(points=((0.0, 0.0, 2.0), (0.5, 0.0, 2.0)), times=(0.0, 4.0)))},
        "task.trajectory must be a Reference on the device, not Waypoints",
    ),
    "latency": (
        {"vehicle": "hummingbird", "simulation": {"latency": 0.02}},
        "latency must be shorter than a control period",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_the_device_does_not_have_is_refused(name: str) -> None:
    arguments, message = REFUSED[name]
    with pytest.raises(ValueError, match=message):
        DeviceVectorEnv(**arguments)


def test_wrong_calls_are_refused() -> None:
    env = make()
    with pytest.raises(Exception, match="call reset before step"):
        env.step(tensor(np.zeros((ROWS, 4))))
    with pytest.raises(ValueError, match="seed must be None or an integer of at least 0, not -1"):
        env.reset(seed=-1)
    env.reset(seed=0)
    with pytest.raises(
        ValueError, match=r"actions must have shape \(4, 4\) and type float32, not \(4, 3\) and float32"
    ):
        env.step(tensor(np.zeros((ROWS, 3))))


def test_the_code_of_the_page_runs() -> None:
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs/gpu.md").read_text(encoding="utf-8"), re.DOTALL)
    code = code.replace("num_envs=4096", f"num_envs={ROWS}").replace("range(1000)", "range(3)")
    exec(code.replace('"cuda"', '"cpu"') if SIMULATED else code, {})
