"""The flatness-based law places its poles, tracks exactly, leaves no offset, and asks for no more than its bounds."""

from dataclasses import replace

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from numpy.testing import assert_allclose
from scipy.linalg import expm

from quadpend_baselines.controllers.flatness import Flatness
from quadpend_baselines.controllers.output_feedback import OutputFeedback
from quadpend_baselines.gains import FlatnessGains
from quadpend_baselines.modelling.linear_model import MODEL_STATE_SIZE, STATE_COLUMNS
from quadpend_gym import PAPER, Actuators, Constant, Parameters, QuadPendulumVectorEnv, Reference, Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.dynamics import accelerations
from quadpend_gym.physics.state import STATE_SIZE, State
from tests.helpers.controllers import (
    CALM,
    HOVER,
    flat_state_and_command,
    hover_states,
    measurement_of,
    rotate_states,
    simulate_with_true_state,
    tilted_pendulum,
    tracking_errors,
    true_estimate,
)
from tests.helpers.physics import UNEQUAL

GAINS = FlatnessGains(
    position_bandwidth=2.5,
    pendulum_bandwidth=7.0,
    attitude_bandwidth=20.0,
    damping=0.9,
    vertical_bandwidth=6.0,
    acceleration=3.0,
    velocity=1.5,
    lean=1.1,
    far_pendulum_bandwidth=4.5,
    far_attitude_bandwidth=8.0,
    near=0.1,
)
# Nowhere bounded, and everywhere near.
LINEAR = replace(GAINS, acceleration=1e9, velocity=1e9, lean=1.5, near=1e9)
UPWARDS = np.array([0.0, 0.0, 0.4, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
LIFTED = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.4, 0.0, 0.0, 0.0])
SIDEWAYS = np.array([0.5, -0.3, 0.0, 0.0, 0.0, 0.0, 0.1, 0.2, 0.03])
CIRCLE = Reference(
    offset=(0.0, 0.0, 2.0, 0.5),
    rate=(0.0, 0.0, 0.1, 0.3),
    amplitude=(1.0, 1.0, 0.0, 0.3),
    frequency=(1.0, 1.0, 0.0, 1.0),
    phase=(np.pi / 2, 0.0, 0.0, 0.0),
)


def characteristic(law: Flatness, yaw: float, disturbance: Floats, step: float = 1e-5) -> Floats:
    """Characteristic polynomial of ẋ = f(x, law(x)), by central differences of this size, at hover in constant wind."""
    p, reference = law.simulation.parameters, Reference.hover(yaw=yaw)
    steps = step * np.concatenate([np.eye(MODEL_STATE_SIZE), -np.eye(MODEL_STATE_SIZE)])
    state = np.repeat(flat_state_and_command(reference, 0.0, disturbance, p)[0], len(steps), axis=0)
    state[:, STATE_COLUMNS] += steps
    s = State(state)
    s.direction[:, 2] = np.sqrt(1.0 - np.sum(s.direction[:, :2] ** 2, axis=1))
    s.direction_rate[:, 2] = -np.sum((s.direction * s.direction_rate)[:, :2], axis=1) / s.direction[:, 2]
    measurement = measurement_of(state, reference)
    command, _ = law.command(true_estimate(measurement, disturbance), measurement, law.initial_memory(len(state)))
    force = accelerations(state, command, np.tile(disturbance, (len(state), 1)), p)
    rates = State(np.empty_like(state))
    rates.position[:], rates.euler[:], rates.direction[:] = s.velocity, s.euler_rate, s.direction_rate
    rates.velocity[:], rates.euler_rate[:], rates.direction_rate[:] = force.position, force.euler, force.direction
    plus, minus = np.split(rates.array[:, STATE_COLUMNS], 2)
    return np.asarray(np.poly((plus - minus).T / (2.0 * step)))


def pairs(*bandwidths: float, damping: float = GAINS.damping) -> Floats:
    """Coefficients of the product of s² + 2ζω s + ω², highest power first."""
    polynomial = np.array([1.0])
    for w in bandwidths:
        polynomial = np.convolve(polynomial, [1.0, 2.0 * damping * w, w * w])
    return polynomial


@pytest.mark.parametrize("parameters", [PAPER, UNEQUAL], ids=["paper", "unequal"])
@pytest.mark.parametrize(
    "disturbance", [CALM, SIDEWAYS, UPWARDS, LIFTED], ids=["calm", "wind from the side", "from below", "on the bob"]
)
def test_the_closed_loop_has_the_poles_that_were_placed(disturbance: Floats, parameters: Parameters) -> None:
    """In continuous time, whatever the heading. Leaning against a wind is no worse than standing upright."""
    law = Flatness(LINEAR, Simulation(parameters))
    promised = pairs(2.5, 7.0, 20.0, 2.5, 7.0, 20.0, 6.0, 6.0)  # x, y, height and yaw
    for yaw in (0.0, 1.0):
        assert_allclose(characteristic(law, yaw, disturbance), promised, rtol=1e-6)


def test_far_from_upright_the_poles_are_the_slow_ones() -> None:
    """The command is that of fast poles, of slow ones, or at η₀ of those half way between."""
    simulation, angle = Simulation(), 0.01

    def command(gains: FlatnessGains) -> Floats:
        measurement = measurement_of(tilted_pendulum(angle, 0.7))
        return Flatness(gains, simulation).command(true_estimate(measurement), measurement, ())[0]

    def everywhere(pendulum: float, attitude: float) -> FlatnessGains:
        far = {"far_pendulum_bandwidth": pendulum, "far_attitude_bandwidth": attitude}
        return replace(GAINS, pendulum_bandwidth=pendulum, attitude_bandwidth=attitude, **far)

    for near, bandwidths in ((1e6, (7.0, 20.0)), (1e-8, (4.5, 8.0)), (np.tan(angle), (5.75, 14.0))):
        assert_allclose(command(replace(GAINS, near=near)), command(everywhere(*bandwidths)), rtol=1e-6)


@pytest.mark.parametrize("tilt", [0.1, 0.2])
def test_the_bob_moves_as_the_poles_say_even_far_from_upright(tilt: float) -> None:
    """e⁽⁶⁾ = −Σ k_i e⁽ⁱ⁾ from a pendulum at rest that leans, to 2 %, with actuators that can."""
    gains = replace(LINEAR, position_bandwidth=2.0, pendulum_bandwidth=4.0, attitude_bandwidth=8.0)
    simulation = Simulation(actuators=Actuators(100.0, 100.0), period=2e-3, substeps=1)
    steps, flown = 1000, []

    def watch(measurement: object, command: Floats, memory: object) -> None:
        state = State(measurement.state[0])  # type: ignore[attr-defined]
        flown.append(state.position[0] + PAPER.rod_length * state.direction[0])

    simulate_with_true_state(Flatness(gains, simulation), simulation, tilted_pendulum(tilt, 0.0), steps, watch=watch)
    companion = np.eye(6, k=1)
    companion[5] = -pairs(2.0, 4.0, 8.0)[:0:-1]
    # At rest e = l sin α, ë = g tan α and e⁗ = g d²(tan α)/dt², with α̈ = u sin α/(M l) while the thrust stands upright;
    # u holds the height: the rod, which falls, carries less of the bob's weight.
    sine, cosine = np.sin(tilt), np.cos(tilt)
    thrust = PAPER.hover_thrust / (1.0 + PAPER.bob_mass / PAPER.quadrotor_mass * sine**2)
    falling = thrust * sine / (PAPER.quadrotor_mass * PAPER.rod_length)
    moved = np.array([PAPER.rod_length * sine, 0.0, PAPER.gravity * sine / cosine, 0.0, 0.0, 0.0])
    moved[4] = PAPER.gravity * falling / cosine**2
    step, should = expm(companion * simulation.period), []
    for _ in range(steps):
        should.append(moved[0])
        moved = step @ moved
    assert_allclose(flown, should, atol=0.02 * max(should))


@pytest.mark.parametrize("reference", [HOVER, Reference.circle(1.0, 1.0), CIRCLE], ids=["hover", "circle", "turning"])
def test_circles_are_tracked_exactly(reference: Reference) -> None:
    """To micrometres, what the staircase of the command costs: half of it at half the period."""
    errors = []
    for period in (0.01, 0.005):
        simulation, error = Simulation(period=period), [0.0]
        start, _ = flat_state_and_command(reference, 0.0, CALM, PAPER)
        simulate_with_true_state(
            Flatness(GAINS, simulation),
            simulation,
            start,
            round(3.0 / period),
            reference,
            watch=lambda measurement, *_, error=error: error.append(tracking_errors(measurement, PAPER.rod_length)[0]),
        )
        errors.append(max(error))
    assert errors[0] < 3e-6
    assert errors[1] < 0.6 * errors[0] + 1e-12


def test_figure_eights_are_tracked_but_for_the_bobs_rise() -> None:
    reference, error = Reference.figure_eight(1.0, np.sqrt(8.0 / 17.0)), []
    start, _ = flat_state_and_command(reference, 0.0, CALM, PAPER)
    simulation = Simulation()
    simulate_with_true_state(
        Flatness(GAINS, simulation),
        simulation,
        start,
        1000,
        reference,
        watch=lambda measurement, *_: error.append(tracking_errors(measurement, PAPER.rod_length)[0]),
    )
    assert max(error) < 2e-4


@pytest.mark.parametrize(
    "wind",
    [
        Constant((0.2, -0.1, 0.0)),
        Constant((0.0, 0.0, 0.3)),
        Constant(bob_force=(0.05, -0.03, 0.0)),
        Constant((0.1, 0.0, -0.2), bob_force=(0.0, 0.05, 0.0), torque=(0.05, -0.03, 0.02)),
    ],
    ids=["from the side", "from below", "on the bob", "everywhere"],
)
def test_in_steady_wind_no_offset_is_kept(wind: Constant) -> None:
    env = QuadPendulumVectorEnv(4, wind=wind, autoreset_mode=AutoresetMode.DISABLED, max_episode_steps=None)
    observation, _ = env.reset(seed=3, options={"reference": HOVER})
    policy, memory = OutputFeedback(Flatness, GAINS), None
    for _ in range(800):
        action, memory = policy.predict(observation, memory)
        observation, _, terminated, _, info = env.step(action)
        assert not terminated.any()
    assert_allclose(info["tracking_error"], 0.0, atol=1e-5)


def test_a_pendulum_that_leans_20_degrees_is_caught() -> None:
    """At rest, in every direction, and the body leans no further than a little over its bound."""
    azimuths, lean, simulation = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False), [], Simulation()
    caught = simulate_with_true_state(
        Flatness(GAINS, simulation),
        simulation,
        tilted_pendulum(0.35, azimuths, 12),
        700,
        watch=lambda measurement, *_: lean.append(np.prod(np.cos(measurement.state[:, 6:8]), axis=1).min()),
    )
    assert_allclose(caught, hover_states(12), atol=1e-3)
    assert 0.5 < np.arccos(min(lean)) < GAINS.lean


def test_what_the_position_asks_is_bounded() -> None:
    """100 m beside the reference it does what it does 10 m beside it, and flies there no faster than it may."""
    simulation, gains = Simulation(), replace(GAINS, acceleration=1.0, velocity=0.8)
    law, far = Flatness(gains, simulation), hover_states(2)
    State(far).position[:, 0] += [10.0, 100.0]
    measurement = measurement_of(far)
    commands, _ = law.command(true_estimate(measurement), measurement, ())
    assert_allclose(commands[0], commands[1], rtol=1e-9)
    velocities = []
    simulate_with_true_state(
        law, simulation, far[:1], 800, watch=lambda measurement, *_: velocities.append(measurement.state[0, 3])
    )
    assert velocities[-1] == pytest.approx(-gains.velocity, rel=0.01)
    assert min(velocities) > -1.2 * gains.velocity


def test_the_lean_that_the_pendulum_asks_is_bounded() -> None:
    """A pendulum beyond rescue asks for the bound: the body turns towards its tangent with k₄, and no faster."""
    simulation, bounds = Simulation(actuators=Actuators(1e4, 1e4)), np.array([0.2, 0.4, 0.6])
    measurement = measurement_of(tilted_pendulum(0.8, 0.0))
    torques = []
    for bound in bounds:
        law = Flatness(replace(LINEAR, lean=bound), simulation)
        torques.append(law.command(true_estimate(measurement), measurement, ())[0][0, 2])
    turning = np.diff(torques) / PAPER.inertia_pitch
    assert_allclose(turning / np.diff(np.tan(bounds)), pairs(2.5, 7.0, 20.0)[2], rtol=1e-9)


def test_a_turned_world_is_flown_the_same() -> None:
    rng = np.random.default_rng(15)
    state = tilted_pendulum(rng.uniform(0.0, 0.3, 20), rng.uniform(0.0, 6.0, 20), 20)
    state[:, :12] += 0.3 * rng.normal(size=(20, 12))
    law, wind = Flatness(GAINS, Simulation(UNEQUAL)), np.array([0.3, 0.0, 0.1, 0.05, 0.0, 0.0, 0.1, 0.0, 0.0])
    commands = []
    for angle in (0.0, 1.2):
        measurement = measurement_of(rotate_states(state, angle), Reference.hover(yaw=angle))
        blown = rotate_states(np.concatenate([wind[:6], np.zeros(STATE_SIZE - 6)]), angle)[:6]
        command, _ = law.command(true_estimate(measurement, np.concatenate([blown, wind[6:]])), measurement, ())
        commands.append(command)
    assert_allclose(commands[0], commands[1], atol=1e-9)
