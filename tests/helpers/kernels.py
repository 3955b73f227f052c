"""Compile the kernels that most tests need, once before several processes run the tests."""

from quadpend_baselines import controller
from quadpend_gym import Reference, Simulation, Sinusoids
from tests.helpers.controllers import AVAILABLE_CONTROLLERS
from tests.helpers.envs import make, make_vec
from tests.helpers.wind import EXAMPLES
from tests.helpers.wrappers import STACKS, wrapped


def compile_kernels() -> None:
    """Take a step in every stack of wrappers and in every wind, and compute an action of every controller."""
    for layers in STACKS.values():
        for env in (wrapped(make(), layers), wrapped(make_vec(3), layers)):
            env.reset(seed=0)
            env.step(env.action_space.sample())
    for wind in EXAMPLES.values():
        for env in (make(wind=wind), make_vec(3, wind=wind)):
            observation, _ = env.reset(seed=0)
            env.step(env.action_space.sample())
    for name in AVAILABLE_CONTROLLERS:
        controller(name).predict(observation)
    rigid = Simulation(vehicle="hummingbird", interface="body_rates", latency=0.015)
    for reference in (
        Reference.hover(2.0),
        Sinusoids(terms=({"amplitude": (0.1, 0.0, 0.0, 0.0), "frequency": (1.0, 0.0, 0.0, 0.0)},)),
    ):
        env = make(simulation=rigid)
        observation, _ = env.reset(seed=0, options={"reference": reference})
        env.step(env.action_space.sample())
    flatness = controller("flatness", rigid)
    _, memory = flatness.predict(observation)
    flatness.predict(observation, memory)


if __name__ == "__main__":
    compile_kernels()
