"""The simulation in PyTorch equals the environment's, and its gradients equal finite differences."""

from typing import Any

import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode
from numpy.testing import assert_allclose, assert_array_equal

from quadpend_gym.physics.euler_kernel import advance as kernel_advance
from quadpend_gym.physics.state import STATE_SIZE, State
from quadpend_gym.scenarios import Scenario
from quadpend_gym.vehicles import PAPER
from quadpend_train.differentiable import dynamics, observation
from quadpend_train.differentiable.plant import Plant

ROWS = 64
TOLERANCE = {"rtol": 1e-12, "atol": 1e-12}


def random_states(random: Any, rows: int = ROWS) -> Any:
    """Return states that are up to 60° from upright."""
    state = random.normal(size=(rows, STATE_SIZE)) * 0.5
    s = State(state)
    s.direction[:, 2] = 1.0 + np.abs(s.direction[:, 2])
    s.direction[:] /= np.linalg.norm(s.direction, axis=1, keepdims=True)
    s.direction_rate[:] -= np.sum(s.direction * s.direction_rate, axis=1, keepdims=True) * s.direction
    return state


def random_inputs(random: Any, rows: int = ROWS) -> tuple[Any, Any, Any]:
    """Return commands, disturbances and parameters."""
    command = random.normal(size=(rows, 4)) * [10.0, 2.0, 2.0, 0.5] + [20.0, 0.0, 0.0, 0.0]
    parameters = PAPER.as_array() * random.uniform(0.7, 1.4, size=(rows, 9))
    return command, random.normal(size=(rows, 9)), parameters


def tensors(*arrays: Any) -> Any:
    return [torch.as_tensor(array, dtype=torch.float64) for array in arrays]


def advance(state: Any, command: Any, disturbance: Any, parameters: Any, period: float, substeps: int) -> Any:
    """Advance states with the differentiable dynamics."""
    forces = dynamics.Forces(*disturbance.split(3, dim=1))
    physics = dynamics.as_physics(parameters)
    after = dynamics.advance(dynamics.as_motion(state), command, forces, physics, period, substeps)
    return dynamics.as_state(after)


@pytest.mark.parametrize(("period", "substeps"), [(0.01, 2), (0.02, 1), (0.04, 8)])
def test_dynamics_equal_the_kernel(period: float, substeps: int) -> None:
    random = np.random.default_rng(0)
    state, inputs = random_states(random), random_inputs(random)
    out = advance(*tensors(state, *inputs), period, substeps)
    kernel_advance(state, *inputs, period, substeps)
    assert_allclose(out.numpy(), state, **TOLERANCE)


def test_gradients_equal_finite_differences() -> None:
    random = np.random.default_rng(1)
    state, command, disturbance, parameters = tensors(random_states(random, 2), *random_inputs(random, 2))
    for item in (state, command, disturbance):
        item.requires_grad_()
    assert torch.autograd.gradcheck(
        lambda *inputs: advance(*inputs, parameters, 0.01, 2), (state, command, disturbance)
    )


# A steady wind with drag and gusts, every actuator that is covered, other references, and random parameters
SCENARIOS = [
    Scenario(),
    Scenario(wind="storm", parameters={"share": 0.2}),
    Scenario(actuators=[{"kind": "motor_lag", "time_constant": 0.02}, {"kind": "action_delay", "steps": 2}]),
    Scenario(wind="windy", actuators=[{"kind": "action_delay", "steps": 1}], task="hover"),
]


def test_plant_and_observation_equal_the_environment() -> None:
    """Over 30 steps, in scenarios with drag, actuators and random parameters."""
    random, share = np.random.default_rng(2), 4
    envs = [scenario.make_vec(share, AutoresetMode.DISABLED) for scenario in SCENARIOS]
    worlds = [env.unwrapped.world for env in envs]
    for env in envs:
        env.reset(seed=3)

    def gather(name: str) -> Any:
        return torch.as_tensor(np.concatenate([getattr(world, name) for world in worlds]))

    plant = Plant(SCENARIOS, share * len(SCENARIOS), torch.float64)
    memory, motion = plant.initial_memory(), dynamics.as_motion(gather("state"))
    physics, reference = dynamics.as_physics(gather("parameters")), gather("reference")
    limits = torch.tensor([observation.limit_row(world.task.limits) for world in worlds]).repeat_interleave(share, 0)
    for step in range(1, 31):
        action = random.normal(size=(plant.initial_memory().shape[0], 4)).astype(np.float32) * np.float32(0.02)
        motion, memory = plant.step(motion, torch.as_tensor(action), gather("wind"), physics, memory)
        results = [env.step(part) for env, part in zip(envs, np.split(action, len(envs)), strict=True)]
        state, expected = dynamics.as_state(motion), gather("state")
        assert_allclose(state[: 2 * share], expected[: 2 * share], **TOLERANCE)
        assert_allclose(
            state, expected, rtol=0.0, atol=1e-7
        )  # the environment rounds the actuators' actions to float32
        motion = dynamics.as_motion(gather("state"))
        target = observation.reference_derivatives(
            reference, torch.full((len(action),), 0.01 * step, dtype=torch.float64)
        )
        tracking = observation.tracking_errors(motion, physics.rod_length, target)
        assert_allclose(tracking.error, np.concatenate([info["tracking_error"] for *_, info in results]), **TOLERANCE)
        observed, expected = observation.observe_state(motion, tracking), [result[0][:, :18] for result in results]
        assert_allclose(observed, np.concatenate(expected), rtol=1e-6, atol=1e-6)
        margins = torch.cat(observation.margins(motion, tracking, limits), dim=1)
        assert_array_equal(margins.amin(dim=1) < 0.0, np.concatenate([result[2] for result in results]))
