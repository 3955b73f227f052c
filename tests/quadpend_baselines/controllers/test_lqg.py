"""LQG: its model is that of the loop, its delay margin has a bound, and its change to the flatness-based law."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from quadpend_baselines import controller
from quadpend_baselines.controllers.flatness import Flatness
from quadpend_baselines.controllers.lqg import Lqg, riccati
from quadpend_baselines.gains import gains_for
from quadpend_baselines.modelling.linear_loop import linear_policy, margins, vehicle_model
from quadpend_baselines.modelling.linear_model import EULER, linearise_actions
from quadpend_baselines.modelling.linear_reference import linear_reference
from quadpend_baselines.policy.protocol import to_action
from quadpend_gym import Simulation
from quadpend_gym.physics.state import State
from tests.helpers.controllers import hover_states, run_law
from tests.quadpend_baselines.modelling.test_linear_reference import HOVER, stationary_error

PAPER = Simulation()


def test_the_model_of_the_design_is_that_of_the_loop() -> None:
    scenario = replace(HOVER, latency=0.0)
    model, vehicle = linearise_actions(scenario.simulation), vehicle_model(scenario)
    assert_allclose(model.transition, vehicle.A, atol=1e-6)
    assert_allclose(model.input, vehicle.B[:, -4:], atol=1e-6)
    assert_allclose(model.disturbance, vehicle.B[:, [0, 1, 2, 3, 4, 6, 7, 8]], atol=1e-6)


def test_its_delay_margin_is_bounded_and_its_error_near_the_reference() -> None:
    """The margin is beyond the known latency; `flatness` has four times the reference."""
    policy = linear_policy(controller("lqg").adapt(HOVER), HOVER)
    assert margins(vehicle_model(HOVER), policy).delay > 0.015
    assert stationary_error(HOVER, policy) < 3.5 * linear_reference(HOVER)


def test_near_the_reference_it_is_the_optimal_linear_feedback_and_far_from_it_flatness() -> None:
    gains, near, far = gains_for("lqg", PAPER), hover_states(), hover_states()
    State(near).euler[:, 0] = 1e-3
    action, _ = run_law(Lqg(gains, PAPER), near)
    x = np.zeros(24)
    x[EULER.start] = 1e-3
    assert_allclose(action[0], -riccati(gains, PAPER)[0] @ x, atol=1e-5)
    State(far).euler[:, 0] = 1.0
    expected, _ = run_law(Flatness(gains.far, PAPER), far)
    assert_array_equal(run_law(Lqg(gains, PAPER), far)[0], to_action(expected, PAPER))
