"""Properties of every controller: `predict` protocol, independent rows, explicit memory, rotational symmetry."""

import re
from inspect import signature
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from numpy.testing import assert_allclose, assert_array_equal

import quadpend_gym
from quadpend_baselines import ADRC, CONTROLLERS, controller
from quadpend_baselines.controllers.output_feedback import OutputFeedback
from quadpend_baselines.gains import GAINS
from quadpend_baselines.registry import CONTROLLER_FACTORIES
from quadpend_gym import (
    PAPER,
    Constant,
    OrnsteinUhlenbeck,
    QuadPendulumVectorEnv,
    Reference,
)
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import STATE_FIELDS
from quadpend_gym.wrappers import VectorOutputFeedbackWrapper
from tests.helpers.controllers import (
    controller_parameters,
    quick_controller,
    rotate_states,
    rotate_vectors,
    simulation_of,
)
from tests.helpers.sources import ROOT

every_controller = pytest.mark.parametrize("name", controller_parameters())
WITH_ESTIMATOR = [name for name, make in CONTROLLER_FACTORIES.items() if getattr(make, "func", None) is OutputFeedback]
# ADRC uses positions and angles only, also when velocities are observed.
every_feedback = pytest.mark.parametrize(
    ("name", "outputs"),
    [
        pytest.param(*parameter.values, outputs, marks=parameter.marks)
        for outputs, names in ((False, CONTROLLERS), (True, WITH_ESTIMATOR))
        for parameter in controller_parameters(names)
    ],
)
WIND = OrnsteinUhlenbeck(force=0.1, bob_force=0.01, torque=0.01)
OTHER_SIMULATION = simulation_of(
    PAPER._replace(quadrotor_mass=0.6, bob_mass=0.25, rod_length=0.4, inertia_pitch=0.08), (4.0, 2.0), period=0.02
)


def make(rows: int, outputs: bool = False, wind: Any = WIND, **kwargs: Any) -> Any:
    """Return a vector environment without time limit."""
    env = QuadPendulumVectorEnv(rows, wind=wind, autoreset_mode=AutoresetMode.DISABLED, **kwargs)
    return VectorOutputFeedbackWrapper(env) if outputs else env


def run(policy: Any, env: Any, seed: int = 5, steps: int = 100, **options: Any) -> tuple[Floats, Floats, Any]:
    """Return the observations and actions, shape (steps, rows, …), and the last memory."""
    observation, _ = env.reset(seed=seed, options=options)
    observations, actions, memory = [], [], None
    for _ in range(steps):
        action, memory = policy.predict(observation, memory)
        observations.append(observation)
        actions.append(action)
        observation, _, terminated, _, _ = env.step(action)
        assert not terminated.any()
    return np.array(observations), np.array(actions), memory


@every_feedback
def test_rows_of_a_batch_are_independent(name: str, outputs: bool) -> None:
    policy = quick_controller(name)
    _, batch, _ = run(policy, make(3, outputs), seed=5, steps=40)
    for row in range(3):
        _, alone, _ = run(policy, make(1, outputs), seed=5 + row, steps=40)
        assert_allclose(alone[:, 0], batch[:, row], atol=1e-6)


@every_feedback
def test_episode_start_resets_the_memory_of_one_row(name: str, outputs: bool) -> None:
    """Row 1 starts a new episode and behaves as in a first episode; row 0 continues its episode."""
    policy, steps = quick_controller(name), 15
    observations, actions, _ = run(policy, make(2, outputs), steps=2 * steps)
    new_observations, new_actions, _ = run(policy, make(2, outputs), seed=50, steps=steps)
    memory = None
    for step in range(2 * steps):
        restarted = step >= steps
        second = new_observations[step - steps, 1] if restarted else observations[step, 1]
        observation = np.stack([observations[step, 0], second])
        action, memory = policy.predict(observation, memory, np.array([False, step == steps]))
        assert_allclose(action[0], actions[step, 0], atol=1e-6)
        assert_allclose(action[1], new_actions[step - steps, 1] if restarted else actions[step, 1], atol=1e-6)


@every_controller
def test_designed_for_returns_the_controller_designed_for_that_simulation(name: str) -> None:
    """The gains stay the same, and the original controller does not change."""
    policy: Any = controller(name)
    changed, designed = policy.designed_for(OTHER_SIMULATION), controller(name, OTHER_SIMULATION)
    observations, before, _ = run(policy, make(2), steps=5)
    memories: list[Any] = [None] * 3
    differ = False
    for step, observation in enumerate(observations):
        actions = []
        for i, variant in enumerate((changed, designed, policy)):
            action, memories[i] = variant.predict(observation, memories[i])
            actions.append(action)
        assert_array_equal(actions[0], actions[1])
        assert_array_equal(actions[2], before[step])
        differ |= not np.allclose(actions[0], actions[2], atol=1e-3)
    assert differ
    assert changed.simulation == OTHER_SIMULATION
    assert changed.gains == policy.gains == GAINS[name]
    assert type(changed) is type(policy)


@every_feedback
def test_actions_do_not_change_when_the_world_is_rotated(name: str, outputs: bool) -> None:
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
        actions.append(run(policy, make(3, outputs, wind), steps=50, state=fields, reference=circle(rotation))[1])
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


@pytest.mark.parametrize("name", controller_parameters(WITH_ESTIMATOR))
@pytest.mark.parametrize("outputs", [False, True])
def test_estimated_disturbance_converges_to_the_true_one_in_steady_wind(name: str, outputs: bool) -> None:
    """After 3 s, the estimates of all forces and torques are exact, except for the vertical force on the bob.

    A controller that estimates the mass attributes a lasting vertical force to it, so there is none in its wind.
    """
    policy: Any = quick_controller(name)
    vertical = 0.0 if policy.gains.estimator.mass_time else 0.08
    force, bob_force, torque = (0.1, -0.05, vertical), (0.02, 0.01, 0.0), (0.03, -0.02, 0.01)
    wind = Constant(force=force, bob_force=bob_force, torque=torque)
    _, _, memory = run(policy, make(2, outputs, wind), steps=300)
    estimate = policy.estimated_disturbance(memory)
    assert_allclose(estimate, np.tile([*force, *bob_force, *torque], (2, 1)), atol=1e-3)


def test_controller_of_the_readme_has_the_documented_methods() -> None:
    (block,) = re.findall(r"```python\n(.*?)```", (ROOT / "baselines/README.md").read_text(encoding="utf-8"), re.DOTALL)
    names: dict[str, Any] = {"quadpend_gym": quadpend_gym}
    exec(compile(block, "baselines/README.md", "exec"), names)
    policy = names["MyController"](None)
    assert policy.designed_for(OTHER_SIMULATION).simulation == OTHER_SIMULATION
    for name in ("predict", "estimated_disturbance"):
        assert list(signature(getattr(policy, name)).parameters) == list(signature(getattr(ADRC(), name)).parameters)
