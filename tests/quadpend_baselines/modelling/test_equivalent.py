"""The equivalent point-mass pendulum, and the inverse dynamics of the attitude."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quadpend_baselines.controllers.lqr import deviation
from quadpend_baselines.modelling.equivalent import equivalent_forces, equivalent_model, equivalent_reference
from quadpend_baselines.modelling.inverse_dynamics import body_torques
from quadpend_baselines.modelling.quantities import Derivatives, calm, load_forces, load_state
from quadpend_baselines.modelling.taylor import Series, Triple
from quadpend_baselines.modelling.trajectory_drag import forces_now, plus_constant
from quadpend_gym import Reference, Simulation
from quadpend_gym.physics.drag import AIR_DENSITY
from quadpend_gym.physics.euler_kernel import advance
from quadpend_gym.physics.rigid_settings import make_rigid_settings
from quadpend_gym.physics.state import DISTURBANCE_SIZE, State
from quadpend_gym.physics.vectors import Four, Vec3
from quadpend_gym.vehicles import Drag, Pole, Vehicle, hover_wrench
from tests.helpers import rigid

POLE = Pole(0.1, 0.4, 0.3 * 0.1 * 0.4**2)
BODY = Vehicle(0.5, (0.004, 0.003, 0.006), POLE, torque=(1.0, 1.0))
RAISED = equivalent_model(Simulation(vehicle=replace(BODY, pivot=(0.0, 0.0, 0.06))))


@pytest.mark.parametrize("disturbance", [np.zeros(9), np.array([0.02, 0.0, 0.1, 0.01, 0.02, 0.05, 0.0, 0.0, 0.0])])
def test_a_pole_with_inertia_moves_like_the_equivalent_point_mass(disturbance: np.ndarray) -> None:
    simulation = Simulation(vehicle=BODY, period=0.3, substeps=30)
    state = rigid.at_rest(1)
    State(state).direction[:] = [0.03, -0.02, np.sqrt(1.0 - 0.03**2 - 0.02**2)]
    design = state.copy()
    torque = np.array([2e-5, -3e-5, 1e-5])
    flight = rigid.start(simulation, state).after(np.array([0.1, *torque]), disturbance)
    model = equivalent_model(simulation)
    p = model.parameters
    constant, zero = load_forces(disturbance[:, np.newaxis], 0, 0), Series(*[0.0] * 5)
    forces = equivalent_forces(plus_constant((Triple(*[zero] * 3), Triple(*[zero] * 3)), constant), model.numbers)
    acting = np.concatenate(forces_now(forces, constant))
    command = np.array([[1.1 * p.hover_thrust, *torque]])
    advance(design, command, acting[np.newaxis], p.as_array()[np.newaxis], 0.3, 30)
    assert_allclose(flight.state, design, atol=2e-5)


def test_the_torques_make_the_demanded_accelerations() -> None:
    vehicle = rigid.random_vehicle(3, drag=Drag(angular=(1e-3, 2e-3, 3e-3)))
    simulation = Simulation(vehicle=vehicle, period=1e-5, substeps=1)
    flight = rigid.start_tumbling(simulation, 5, 7, 0.5)
    rng = np.random.default_rng(0)
    wanted, disturbance = rng.normal(size=(5, 3)), rng.normal(size=(5, DISTURBANCE_SIZE))
    disturbance[:, :3] *= 0.1
    hover, scale = hover_wrench(simulation.parameters, simulation.vehicle.pivot), simulation.command_scale
    model, rigid_settings, torques = equivalent_model(simulation), make_rigid_settings(simulation), np.empty((5, 3))
    for row in range(5):
        state, forces = load_state(flight.state.T, 0, row), load_forces(disturbance.T, 0, row)
        physics, acceleration = model.numbers.vehicle, Vec3(*wanted[row])
        torques[row] = body_torques(state, acceleration, hover[0], forces, physics, rigid_settings)
    action = np.column_stack([np.zeros(5), (torques - hover[1:]) / scale[1:]])
    assert np.abs(action).max() < 1.0
    after = flight.after(action, disturbance)
    assert_allclose((after.named.euler_rate - flight.named.euler_rate) / 1e-5, wanted, atol=5e-3)


def equivalent(derivatives: np.ndarray) -> np.ndarray:
    """Return the derivatives of F without drag, shape (5, 3), for those of F_d."""
    given = Derivatives(*(Vec3(*row) for row in derivatives), *[Vec3(0.0, 0.0, 0.0)] * 2, Four(*[0.0] * 4))
    none = Triple(*[Series(*[0.0] * 5)] * 3)
    return np.array(equivalent_reference(given, (none, none), RAISED.numbers)[:5])


def test_the_wanted_flat_output_of_a_raised_pivot_is_that_of_the_equations() -> None:
    """For slow motion, F and its derivatives solve (1) and (2) with F_d = ζ + l r."""
    p, a, b = RAISED.parameters, RAISED.numbers.pendulum_arm, RAISED.numbers.thrust_arm
    mu = RAISED.numbers.pivot_share / (1.0 - RAISED.numbers.pivot_share)
    w = 0.3  # rad/s
    powers = np.array([(1j * w) ** i for i in range(2, 7)])
    sigma = powers[0] / p.gravity
    t = sigma - sigma * powers[0] / p.chain_stiffness
    s = (1.0 + mu) * sigma - mu * t
    tracked = 1.0 - a * s - b * t  # F_d for F = exp(i w t)
    reference = np.zeros((5, 3))
    reference[:, 0] = np.real(powers * tracked)
    assert equivalent(reference)[0, 0] == pytest.approx(np.real(powers[0]), rel=1e-4)
    assert np.abs(reference[0, 0] - np.real(powers[0])) > 1e-3 * w**2


@pytest.mark.parametrize("amplitude", [(1.0, 0.5), (1.0, 0.0), (0.0, 0.0)], ids=["figure eight", "line", "rest"])
def test_the_wanted_flat_output_of_oscillations_is_that_of_their_frequencies(
    amplitude: tuple[float, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Equation (3) has the solution F = F_d/(1 + c₂ w² − c₄ w⁴) for each frequency w, here along turned axes."""
    monkeypatch.setattr("quadpend_baselines.modelling.equivalent._LEAST", 1e-9)
    model, frequency = RAISED.numbers, np.array([0.8, 1.6])
    sine, cosine = np.sin(0.7), np.cos(0.7)
    turn = np.array([[cosine, -sine], [sine, cosine]])
    part = 1.0 / (1.0 + model.second * frequency**2 - model.fourth * frequency**4)
    for phase in (0.1, 0.8, 2.0):
        powers = (1j * frequency) ** np.arange(2, 7)[:, np.newaxis]
        wanted = np.real(powers * amplitude * np.exp(1j * phase * frequency))
        found = equivalent(np.column_stack([wanted @ turn.T, wanted[:, 0]]))
        assert_allclose(found[:, :2], (part * wanted) @ turn.T, atol=1e-5)
        assert_allclose(found[:, 2], wanted[:, 0])


@pytest.mark.parametrize("order", range(5))
def test_the_wanted_flat_output_of_other_motions_stays_near_theirs(order: int) -> None:
    """For one derivative alone, and for growing exponentials, which oscillate at no frequency."""
    alone, growing = np.zeros((5, 3)), np.outer(1.5 ** np.arange(2, 7), [1.0, -2.0, 0.0])
    alone[order] = 3.0, -1.0, 0.0
    size = 1.0 + RAISED.numbers.second + abs(RAISED.numbers.fourth)
    assert np.abs(equivalent(alone)).max() <= 3.0 * size
    expected, numbers = growing.copy(), RAISED.numbers
    expected[1:3] += numbers.second * growing[3:5]
    expected[0] += numbers.second * expected[2] + numbers.fourth * growing[4]
    assert_allclose(equivalent(growing), expected, rtol=1e-12)


def trajectory(simulation: Simulation, reference: Reference, time: float, drag: Four) -> tuple[np.ndarray, np.ndarray]:
    """Return state, shape (1, 18), and action on a reference."""
    d = reference.derivatives(np.array([time]))[0]
    place = np.zeros(18)
    place[:6] = d[:2, :3].ravel()
    given = Derivatives(*(Vec3(*row[:3]) for row in d[2:7]), Vec3(*d[:3, 3]), Vec3(*d[1, :3]), drag)
    still, settings = load_state(np.zeros((18, 1)), 0, 0), make_rigid_settings(simulation)
    error, command = deviation(still, calm(), given, equivalent_model(simulation).numbers, settings)
    scale = simulation.command_scale
    return (place - np.concatenate(error))[np.newaxis], np.array(command) / scale - [1.0, 0.0, 0.0, 0.0]


def open_loop(simulation: Simulation, reference: Reference, drag: Four) -> float:
    """Return the largest deviation (m, rad, m/s, rad/s) from the trajectory after 0.2 s of its commands."""
    flight = rigid.start(simulation, trajectory(simulation, reference, 0.0, drag)[0])
    for k in range(100):
        flight = flight.after(trajectory(simulation, reference, (k + 0.5) * simulation.period, drag)[1])
    expected, _ = trajectory(simulation, reference, 100 * simulation.period, drag)
    return float(np.abs(flight.state - expected).max())


CIRCLE = Reference(amplitude=(1.0, 1.0, 0.0, 0.0), frequency=(1.2, 1.2, 0.0, 0.0), phase=(np.pi / 2, 0.0, 0.0, 0.0))


@pytest.mark.parametrize("reference", [CIRCLE, Reference.figure_eight(1.0, 0.8)], ids=["circle", "figure eight"])
def test_a_vehicle_flies_its_trajectory_in_the_drag_of_body_pole_and_rotors(reference: Reference) -> None:
    """With a raised pivot. What is left out is of higher order in tilt and drag; it grows by 4 in 0.2 s."""
    body, half = replace(BODY, pivot=(0.0, 0.0, 0.05), pole=replace(POLE, drag_area=0.01)), 0.5 * AIR_DENSITY
    simulation = Simulation(vehicle=replace(body, drag=Drag(0.02, (0.2, 0.2, 0.4))), period=2e-3, substeps=1)
    known = open_loop(simulation, reference, Four(0.2, 0.4, half * 0.02, half * 0.01))
    unknown = open_loop(simulation, reference, Four(*[0.0] * 4))
    assert known < 3e-3
    assert unknown > 0.1
