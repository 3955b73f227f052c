"""Properties of every controller: flights, `predict` protocol, independent rows, memory, rotational symmetry."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from numpy.testing import assert_allclose

from quadpend_baselines import CONTROLLERS, controller
from quadpend_baselines.gains import gains_for, law_of, scale_gains, tuning
from quadpend_baselines.policy.protocol import to_action
from quadpend_gym import PAPER, Constant, OrnsteinUhlenbeck, QuadPendulumVectorEnv, Reference, Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.allocation import mean_wrench
from quadpend_gym.physics.plants import plant_of
from quadpend_gym.physics.state import STATE_FIELDS
from quadpend_gym.scenarios import Scenario, as_scenario
from quadpend_gym.vehicles import hover_wrench
from quadpend_train.evaluation.episodes import run_episodes
from tests.helpers.controllers import quick_controller, rotate_states, rotate_vectors

every_controller = pytest.mark.parametrize("name", CONTROLLERS)
WITH_ESTIMATOR = [name for name in CONTROLLERS if getattr(law_of(name), "observer", "") == "kalman"]
WIND = OrnsteinUhlenbeck(force=0.1, bob_force=0.01, torque=0.01)
RIGID = ("wrench", "rotors", "body_rates")
FLIGHTS = {
    "calm": Scenario(),
    "windy": Scenario(wind=WIND),
    "load": Scenario(task="load"),
    "wrench": Scenario(vehicle="hummingbird"),
    "rotors": Scenario(vehicle="x500", interface="rotors", period=0.02, substeps=8),
    "body_rates": Scenario(
        vehicle="racer", interface="body_rates", period=0.02, substeps=8, latency=0.02, observation="output_feedback"
    ),
}


def make(rows: int, wind: Any = WIND) -> Any:
    """Return a vector environment without time limit."""
    return QuadPendulumVectorEnv(rows, wind=wind, autoreset_mode=AutoresetMode.DISABLED)


def run(policy: Any, env: Any, seed: int = 5, steps: int = 100, **options: Any) -> tuple[Floats, Floats, Any]:
    """Return the observations and actions, shape (steps, rows, …), and the last memory; no episode terminates."""
    observation, _ = env.reset(seed=seed, options=options)
    observations, actions, memory = [], [], None
    for _ in range(steps):
        action, memory = policy.predict(observation, memory)
        observations.append(observation)
        actions.append(action)
        observation, _, terminated, _, _ = env.step(action)
        assert not terminated.any()
    return np.array(observations), np.array(actions), memory


# Not flown: adrc, nmpc and swing-up carry no load; swing-up is for the paper's vehicle, nmpc is slow, and adrc-paper
# has no margin for the lag of rotors.
NOT_FLOWN = {"load": ("adrc", "lqg", "nmpc", "swing-up"), **dict.fromkeys(RIGID, ("adrc-paper", "nmpc", "swing-up"))}


@every_controller
@pytest.mark.parametrize("flight", FLIGHTS)
def test_every_controller_flies(name: str, flight: str) -> None:
    """For 2 s in calm air, in wind, with a hanging load, and on one rigid vehicle with each interface."""
    if name.startswith(NOT_FLOWN.get(flight, ("never",))):
        return
    scenario = FLIGHTS[flight]
    env = scenario.make_vec(2, AutoresetMode.DISABLED)
    run(quick_controller(name).adapt(scenario), env, seed=3, steps=round(2.0 / scenario.simulation.period))


@every_controller
def test_rows_of_a_batch_are_independent_and_like_single_observations(name: str) -> None:
    policy = quick_controller(name)
    observations, batch, _ = run(policy, make(3), steps=40)
    for row in range(3):
        memory = None
        for observation, actions in zip(observations, batch, strict=True):
            action, memory = policy.predict(observation[row], memory)
            assert action.shape == (4,)
            assert action.dtype == np.float32
            assert_allclose(action, actions[row], atol=1e-6)


@every_controller
def test_episode_start_resets_the_memory_of_one_row(name: str) -> None:
    """Row 1 starts a new episode and behaves as in a first episode; row 0 continues its episode."""
    policy, steps = quick_controller(name), 15
    observations, actions, _ = run(policy, make(2), steps=2 * steps)
    new_observations, new_actions, _ = run(policy, make(2), seed=50, steps=steps)
    memory = None
    for step in range(2 * steps):
        restarted = step >= steps
        second = new_observations[step - steps, 1] if restarted else observations[step, 1]
        observation = np.stack([observations[step, 0], second])
        action, memory = policy.predict(observation, memory, np.array([False, step == steps]))
        assert_allclose(action[0], actions[step, 0], atol=1e-6)
        assert_allclose(action[1], new_actions[step - steps, 1] if restarted else actions[step, 1], atol=1e-6)


@every_controller
def test_actions_do_not_change_when_the_world_is_rotated(name: str) -> None:
    """The rotation about the vertical includes start, reference, heading and wind; the episodes last half a second.

    The sign terms of ADRC saturate in x and in y separately, so that its symmetry holds for right angles only.
    Observers of 500 rad/s amplify the rounding of single precision.
    """
    angle = np.deg2rad(70.0 if name in WITH_ESTIMATOR else 90.0)
    tolerance = 0.03 if name in ("adrc-paper", "adrc-matched") else 1e-4
    policy, force, torque = quick_controller(name), np.array([0.1, -0.05, 0.05]), (0.02, -0.01, 0.01)
    env = make(3)
    env.reset(seed=7, options={"reference": circle(0.0)})
    start, actions = env.world.state.copy(), []
    for rotation in (0.0, angle):
        state = rotate_states(start, rotation)
        fields = {field: state[:, part] for field, part in STATE_FIELDS.items()}
        wind = Constant(force=tuple(rotate_vectors(force, rotation)), torque=torque)
        actions.append(run(policy, make(3, wind=wind), steps=50, state=fields, reference=circle(rotation))[1])
    assert_allclose(actions[0], actions[1], atol=tolerance)


def circle(angle: float) -> Reference:
    """Return a circle whose centre is not the origin, rotated about the origin."""
    x, y, z = rotate_vectors(np.array([0.4, -0.2, 2.0]), angle)
    return Reference(
        offset=(x, y, z, 0.3 + angle),
        amplitude=(0.8, 0.8, 0.1, 0.2),
        frequency=(0.9, 0.9, 0.5, 0.7),
        phase=(np.pi / 2 + angle, angle, 0.0, 0.5),
    )


@pytest.mark.parametrize("interface", RIGID)
def test_actions_make_the_demanded_mean_thrust_and_torques(interface: str) -> None:
    simulation = Simulation(vehicle="hummingbird", interface=interface, period=0.02, substeps=8)
    torque = np.array([0.004, -0.003, 0.001])
    command = np.tile(hover_wrench(simulation.parameters, simulation.vehicle.pivot) + np.array([0.3, *torque]), (3, 1))
    rigid = plant_of(simulation).initial_memory(np.zeros((3, 18)))
    rigid[1, 4:7] = [0.5, -0.4, 0.2]
    rigid[2, 7:] *= [1.01, 1.02, 0.99, 1.0]
    action = to_action(command, simulation, rigid)
    assert_allclose(mean_wrench(action, rigid, simulation), command, rtol=0.02, atol=2e-4)


@pytest.mark.parametrize("name", ["lqg", "flatness", "swing-up"])
def test_the_name_of_a_vehicle_does_not_change_its_controller(name: str) -> None:
    simulation = Simulation(vehicle="hummingbird", interface="body_rates")
    renamed = replace(simulation, vehicle=replace(simulation.vehicle, name="mine"))
    assert gains_for(name, renamed) == gains_for(name, simulation)


def test_gains_scale_with_the_time_constant_of_the_pendulum() -> None:
    p = PAPER
    slow = p._replace(rod_length=4.0 * p.rod_length)
    assert slow.chain_stiffness == pytest.approx(p.chain_stiffness / 4.0)
    flatness, lqr = (scale_gains(tuning(name).gains, p, slow) for name in ("flatness", "lqr"))
    assert flatness.attitude_bandwidth == pytest.approx(0.5 * tuning("flatness").gains.attitude_bandwidth)
    assert flatness.damping == tuning("flatness").gains.damping
    assert lqr.position == pytest.approx(4.0 * tuning("lqr").gains.position)


@pytest.mark.parametrize("name", ["lqg", "dual-mode", "flatness"])
def test_the_drag_of_a_known_velocity_is_followed(name: str) -> None:
    """On a circle of 2.1 m/s, where drag is a tenth of the weight; errors alone do not tell the velocity."""
    task = {"trajectory": Reference.circle(1.5, 2.0**0.5)}
    largest = []
    for observation in ("lab", "output_feedback"):
        scenario = as_scenario(
            "flight_circle", wind=None, sensors=None, actuators=None, observation=observation, task=task
        )
        largest.append(run_episodes([controller(name)], scenario, 1, seed=0).error[0, 0, 400:].max())
    assert largest[0] < min(0.2 * largest[1], 0.017)
