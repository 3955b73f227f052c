"""Flights of generated C equal those of the environments."""

from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from numpy.testing import assert_allclose

from quadpend_gym.scenarios import Scenario
from quadpend_train.training.flight import Flights, reference_points
from quadpend_train.training.settings import ApgSettings

HUMMINGBIRD = {"vehicle": "hummingbird", "interface": "body_rates"}
CURVE = {"kind": "waypoints", "times": [0.0, 6.0], "points": [[0.0, 0.0, 2.0], [1.0, 0.0, 2.0]]}
# Drag and gusts, every actuator that is covered, other references, random parameters, and a latency
PAPER = [
    Scenario(),
    Scenario(wind="storm", parameters={"share": 0.2}),
    Scenario(actuators=[{"kind": "motor_lag", "time_constant": 0.02}, {"kind": "action_delay", "steps": 2}]),
    Scenario(wind="windy", actuators=[{"kind": "action_delay", "steps": 1}], task="hover"),
    Scenario(task={"trajectory": CURVE}),
]
LOOP = {
    "latency": [0.015, 0.025],
    "jitter": 0.002,
    "rate_loop": [0.85, 1.15],
    "rotor_lag": [0.9, 1.1],
    "thrust": [0.85, 1.15],
    "changes": {"at": [0.03, 0.06], "latency": [0.01, 0.035], "thrust": [0.7, 0.8], "rotors": [0.7, 0.8]},
}
LOSSES = [{"kind": "packet_loss", "probability": 0.3}, {"kind": "gyro_bias"}]
RIGID = [
    Scenario(**HUMMINGBIRD, latency=0.015, wind="storm", parameters={"share": 0.2}),
    Scenario(**HUMMINGBIRD, latency=0.02, actuators=LOSSES, loop=LOOP),
]


@pytest.mark.parametrize("scenarios", [PAPER, RIGID], ids=["paper", "rigid"])
def test_flights_equal_the_environment(scenarios: Any) -> None:
    """Over 15 steps."""
    random, share = np.random.default_rng(2), 4
    envs = [scenario.make_vec(share, AutoresetMode.DISABLED) for scenario in scenarios]
    worlds = [env.unwrapped.world for env in envs]
    for env in envs:
        env.reset(seed=3)

    def gather(name: str) -> Any:
        return np.concatenate([getattr(world, name) for world in worlds])

    apg = ApgSettings(error=1.0, yaw=0.0, effort=0.0, rate=0.0, lean=1.0)
    flights = Flights(scenarios, [], share * len(scenarios), 36, apg)
    flight = flights.initial(gather("state"))
    for step in range(1, 16):
        action = random.normal(size=(len(flight), 4)).astype(np.float32) * np.float32(0.02)
        point = reference_points(scenarios, gather("reference"), np.full(len(flight), 0.01 * step))
        given = action, gather("wind"), gather("parameters")
        before = [[memory.copy() for memory in world.actuator_memories] for world in worlds]
        results = [env.step(part) for env, part in zip(envs, np.split(action, len(envs)), strict=True)]
        flight, costs = flights.step(flight, *given, flights.drawn(worlds, before), point, flights.weights)
        # The environment rounds actions to float32 after the actuators.
        assert_allclose(flight[:, :18], gather("state"), rtol=0.0, atol=1e-7)
        error = np.linalg.norm(np.concatenate([info["tracking_error"] for *_, info in results]), axis=1)
        assert_allclose(costs[:, 0], error**2, atol=1e-7)
        assert (costs[:, 1] >= error - 1e-7).all()
