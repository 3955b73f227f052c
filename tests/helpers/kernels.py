"""Compile the kernels that most tests need, once before several processes run the tests."""

from typing import Any

from quadpend_baselines import CONTROLLERS, controller
from quadpend_gym import Simulation
from tests.helpers.envs import make, make_vec
from tests.helpers.wrappers import STACKS, make_wrapped, make_wrapped_vec

RIGID = Simulation(vehicle="hummingbird", interface="body_rates", latency=0.015)
TRAJECTORY = {"kind": "waypoints", "times": [0, 2], "points": [[0, 0, 2], [1, 0, 2]]}


def compile_kernels() -> None:
    """Step one row and several rows, whose arrays can have another memory layout, and call every controller."""
    envs: list[Any] = [make_wrapped(layers) for layers in STACKS.values()]
    envs += [make_wrapped_vec(3, layers) for layers in STACKS.values()]
    for simulation in (Simulation(), RIGID):
        for task in ("track", {"trajectory": TRAJECTORY}):
            envs += [make(simulation=simulation, task=task), make_vec(3, simulation=simulation, task=task)]
    for env in envs:
        env.reset(seed=0)
        env.step(env.action_space.sample())
    observation = make().reset(seed=0)[0]
    for policy in (*map(controller, CONTROLLERS), controller("flatness", RIGID)):
        policy.predict(observation)


if __name__ == "__main__":
    compile_kernels()
