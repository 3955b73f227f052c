"""Scaling of actions and selection of rows in memories."""

from typing import Any

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from quadpend_baselines import controller
from quadpend_baselines.policy.protocol import replace_rows, to_action
from quadpend_gym import PAPER, Simulation
from quadpend_gym.physics.plants import plant_of
from tests.helpers.controllers import simulation_of
from tests.helpers.envs import assert_same, draw_actions, make_vec


def test_to_action_inverts_the_command_of_the_plant_exactly() -> None:
    for simulation in (Simulation(), simulation_of(PAPER._replace(bob_mass=0.3), (5.0, 2.0))):
        actions = draw_actions(0, 50)
        command = plant_of(simulation).command(actions)
        thrust = simulation.parameters.hover_thrust
        assert_allclose(command[:, 0], thrust * (1.0 + actions[:, 0]), rtol=1e-6)
        assert_array_equal(plant_of(simulation).command(np.zeros((1, 4), np.float32)), [[thrust, 0.0, 0.0, 0.0]])
        assert_array_equal(to_action(command, simulation), actions)


def test_replace_rows_works_through_tuples_of_arrays() -> None:
    policy: Any = controller("flatness")
    memories = [policy.predict(make_vec(rows).reset(seed=rows)[0])[1] for rows in (5, 2)]
    copies = [memory.estimate.array.copy() for memory in memories]
    whole = replace_rows(np.array([3, 1]), memories[1], memories[0])
    assert type(whole) is type(memories[0])
    assert_array_equal(whole.action[[3, 1]], memories[1].action)
    assert_array_equal(whole.action[[0, 2, 4]], memories[0].action[[0, 2, 4]])
    assert_array_equal(whole.estimate.state[[3, 1]], memories[1].estimate.state)
    assert_same([memory.estimate.array for memory in memories], copies)
