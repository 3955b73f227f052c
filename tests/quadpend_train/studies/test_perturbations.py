"""Perturbations have the stated size and change nothing else."""

from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from quadpend_gym.physics.state import State
from quadpend_gym.scenarios import Scenario
from quadpend_train.studies.perturbations import PERTURBATION_AXES, PerturbationAxis


def reset_env(axis: PerturbationAxis, value: float, episodes: int = 6, seed: int = 0) -> Any:
    env = axis.scenario(value).make_vec(episodes, AutoresetMode.SAME_STEP)
    env.reset(seed=seed, options=axis.options(value, episodes, seed))
    return env.unwrapped


@pytest.mark.parametrize("name", PERTURBATION_AXES)
def test_only_the_perturbation_changes_along_an_axis(name: str) -> None:
    axis = PERTURBATION_AXES[name]
    least, most = (reset_env(axis, value).world for value in (axis.values[0], axis.values[-1]))
    np.testing.assert_array_equal(least.reference, most.reference)
    changed = {"tilt": range(12, 18), "offset": range(3), "rod": range(12)}.get(name, ())  # starts depend on the rod
    same = [i for i in range(18) if i not in changed]
    np.testing.assert_array_equal(least.state[:, same], most.state[:, same])


def test_perturbed_starts_have_exact_sizes_and_headings_that_depend_on_the_seed() -> None:
    tilt, offset = PERTURBATION_AXES["tilt"], PERTURBATION_AXES["offset"]
    state = State(reset_env(tilt, 0.4).world.state)
    np.testing.assert_allclose(state.alpha, 0.4, atol=1e-12)
    np.testing.assert_allclose(state.beta, State(reset_env(tilt, 0.1).world.state).beta, atol=1e-12)
    assert np.ptp(np.sort(np.diff(np.sort(state.beta)))) < 1.5
    np.testing.assert_allclose(State(reset_env(tilt, 0.4, 2, seed=4).world.state).beta, state.beta[4:], atol=1e-9)
    position = State(reset_env(offset, 1.5).world.state).position
    np.testing.assert_allclose(np.hypot(*position.T[:2]), 1.5, atol=1e-12)
    np.testing.assert_allclose(position[:, 2], 2.0)


@pytest.mark.parametrize("name", PERTURBATION_AXES)
def test_the_values_of_an_axis_ascend_and_include_the_nominal_one(name: str) -> None:
    axis = PERTURBATION_AXES[name]
    assert list(axis.values) == sorted(set(axis.values))
    assert axis.nominal in axis.values


def test_the_true_mass_differs_from_the_mass_that_controllers_assume() -> None:
    env = reset_env(PERTURBATION_AXES["mass"], 1.5)
    np.testing.assert_allclose(env.world.parameters[:, :2], [[0.75, 0.3]] * 6)
    assert PERTURBATION_AXES["mass"].scenario(1.5).simulation == Scenario().simulation
