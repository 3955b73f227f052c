"""What every controller keeps to: the `predict` protocol, rows of their own, returned memory, turned worlds."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from numpy.testing import assert_allclose, assert_array_equal
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor

from quadpend_baselines import CONTROLLERS, controller
from quadpend_baselines.controllers.output_feedback import OutputFeedback
from quadpend_baselines.gains import GAINS
from quadpend_gym import (
    Actuators,
    Constant,
    OrnsteinUhlenbeck,
    Parameters,
    QuadPendulumVectorEnv,
    Reference,
    Simulation,
)
from quadpend_gym.core.arrays import Floats, Floats32
from quadpend_gym.physics.state import STATE_FIELDS
from quadpend_gym.tasks.observation import (
    OBSERVATION_FIELDS,
    OBSERVATION_SCALE,
    OBSERVATION_SIZE,
    OUTPUT_FEEDBACK_COLUMNS,
)
from quadpend_gym.wrappers import VectorOutputFeedbackWrapper
from tests.helpers.controllers import rotate_states, rotate_vectors

every = pytest.mark.parametrize("name", CONTROLLERS)
SEEING = [name for name in CONTROLLERS if isinstance(controller(name), OutputFeedback)]  # with the estimator in front
# ADRC looks at outputs alone, whatever it is shown.
feedbacks = pytest.mark.parametrize(
    ("name", "outputs"), [*((name, False) for name in CONTROLLERS), *((name, True) for name in SEEING)]
)
BREEZE = OrnsteinUhlenbeck(force=0.1, bob_force=0.01, torque=0.01)
OTHER = Simulation(
    Parameters(quadrotor_mass=0.6, bob_mass=0.25, rod_length=0.4, inertia_pitch=0.08), Actuators(4.0, 2.0), period=0.02
)


def make(rows: int, outputs: bool = False, wind: Any = BREEZE, **kwargs: Any) -> Any:
    """Rows that end only when they fall."""
    env = QuadPendulumVectorEnv(
        rows, wind=wind, autoreset_mode=AutoresetMode.DISABLED, max_episode_steps=None, **kwargs
    )
    return VectorOutputFeedbackWrapper(env) if outputs else env


def fly(policy: Any, env: Any, seed: int = 5, steps: int = 100, **options: Any) -> tuple[Floats, Floats, Any]:
    """Observations, actions, shape (steps, rows, …), and the last memory."""
    observation, _ = env.reset(seed=seed, options=options)
    seen, done, memory = [], [], None
    for _ in range(steps):
        action, memory = policy.predict(observation, memory)
        seen.append(observation)
        done.append(action)
        observation, _, terminated, _, _ = env.step(action)
        assert not terminated.any()
    return np.array(seen), np.array(done), memory


@every
@pytest.mark.parametrize("outputs", [False, True])
def test_one_observation_or_many_give_one_action_or_many(name: str, outputs: bool) -> None:
    policy = controller(name)
    seen, _, _ = fly(policy, make(3, outputs), steps=3)
    assert seen.shape[-1] == (27 if outputs else 36)
    single = many = None
    for observation in seen:
        action, single = policy.predict(observation[0], single)
        actions, many = policy.predict(observation, many)
        assert action.shape == (4,)
        assert actions.shape == (3, 4)
        assert action.dtype == actions.dtype == np.float32
        assert_allclose(action, actions[0], atol=1e-6)


@every
def test_sb3_evaluates_it_as_it_is(name: str) -> None:
    env = Monitor(gym.make("quadpend_gym:QuadPendulumHover-v0", max_episode_steps=60))
    returns, lengths = evaluate_policy(
        controller(name),  # type: ignore[arg-type]
        env,
        n_eval_episodes=2,
        return_episode_rewards=True,
    )
    assert lengths == [60, 60]
    assert min(returns) > 25.0  # type: ignore[type-var, operator]


@feedbacks
def test_a_row_flies_in_a_batch_as_it_flies_alone(name: str, outputs: bool) -> None:
    policy = controller(name)
    _, together, _ = fly(policy, make(3, outputs), seed=5)
    for row in range(3):
        _, alone, _ = fly(policy, make(1, outputs), seed=5 + row)
        assert_allclose(alone[:, 0], together[:, row], atol=1e-6)


@feedbacks
def test_a_new_episode_has_forgotten_the_last(name: str, outputs: bool) -> None:
    """Row 1 begins another flight and flies it as if it were the first, while row 0 flies on undisturbed."""
    policy, steps = controller(name), 30
    seen, done, _ = fly(policy, make(2, outputs), steps=2 * steps)
    other, fresh, _ = fly(policy, make(2, outputs), seed=50, steps=steps)
    memory = None
    for step in range(2 * steps):
        again = step >= steps
        observation = np.stack([seen[step, 0], other[step - steps, 1] if again else seen[step, 1]])
        action, memory = policy.predict(observation, memory, np.array([False, step == steps]))
        assert_allclose(action[0], done[step, 0], atol=1e-6)
        assert_allclose(action[1], fresh[step - steps, 1] if again else done[step, 1], atol=1e-6)


@every
def test_its_memory_is_what_it_returns(name: str) -> None:
    """Twice from the same memory is twice the same, whatever has been predicted between."""
    policy = controller(name)
    seen, done, _ = fly(policy, make(2), steps=10)
    memory = None
    for observation in seen[:-1]:
        _, memory = policy.predict(observation, memory)
    for _ in range(2):
        assert_array_equal(policy.predict(seen[-1], memory)[0], done[-1])
        policy.predict(seen[0])


@every
def test_told_of_another_plant_it_is_the_controller_made_for_it(name: str) -> None:
    """With the gains that it had, and it does not change itself."""
    policy: Any = controller(name)
    told, made = policy.with_simulation(OTHER), controller(name, OTHER)
    seen, before, _ = fly(policy, make(2), steps=5)
    memories: list[Any] = [None] * 3
    differ = False
    for step, observation in enumerate(seen):
        actions = []
        for i, each in enumerate((told, made, policy)):
            action, memories[i] = each.predict(observation, memories[i])
            actions.append(action)
        assert_array_equal(actions[0], actions[1])
        assert_array_equal(actions[2], before[step])
        differ |= not np.allclose(actions[0], actions[2], atol=1e-3)
    assert differ
    assert told.simulation == OTHER
    assert told.gains == policy.gains == GAINS[name]
    assert type(told) is type(policy)


def absurd(sound: Floats32) -> Floats32:
    """Observations as no flight has them, five for each row of sound ones, shape (5 n, 36)."""
    rng, rows = np.random.default_rng(19), len(sound)
    azimuth, tilt = rng.uniform(0.0, 6.0, rows), np.deg2rad(80.0)
    lying = np.stack([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.full(rows, np.cos(tilt))], -1)
    kinds = (
        {"tracking_error": rng.uniform(-100.0, 100.0, (rows, 3))},
        {"direction": lying},
        {"attitude": rng.choice([-1.0, 1.0], (rows, 3)) * np.deg2rad([70.0, 70.0, 180.0])},
        {
            "tracking_error_rate": rng.uniform(-20.0, 20.0, (rows, 3)),
            "euler_rate": rng.uniform(-20.0, 20.0, (rows, 3)),
        },
        {f"reference_{order}": rng.uniform(-30.0, 30.0, (rows, 3)) for order in range(2, 7)},
    )
    out = []
    for values in kinds:
        wild = sound.copy()
        for field, value in values.items():
            part = OBSERVATION_FIELDS[field]
            wild[:, part] = value / OBSERVATION_SCALE[part]
        out.append(wild)
    return np.concatenate(out)


@feedbacks
def test_absurd_observations_give_actions_in_range(name: str, outputs: bool) -> None:
    """100 m away, the pendulum or the body lying, at 20 m/s, or along a reference of 3 g: for 20 steps on end."""
    policy, memory = controller(name), None
    wild = absurd(make(20).reset(seed=6)[0])[:, OUTPUT_FEEDBACK_COLUMNS if outputs else np.arange(OBSERVATION_SIZE)]
    for _ in range(20):
        action, memory = policy.predict(wild, memory)
        assert np.isfinite(action).all()
        assert (np.abs(action) <= 1.0).all()


@feedbacks
def test_a_turned_world_is_flown_the_same(name: str, outputs: bool) -> None:
    """Start, circle, heading and wind turned about the vertical: for a second, every action stays what it is.

    ADRC's sign terms saturate in x and in y, so that it can be turned by right angles alone, and observers of 500 rad/s
    see the rounding of single precision.
    """
    angle = np.deg2rad(70.0 if name in SEEING else 90.0)
    rounding = 0.03 if name in ("adrc-paper", "adrc-matched") else 1e-4
    policy, force, torque = controller(name), np.array([0.1, -0.05, 0.05]), (0.02, -0.01, 0.01)
    env = make(3)
    env.reset(seed=7, options={"reference": circle(0.0)})
    start, actions = env.world.state.copy(), []
    for turn in (0.0, angle):
        state = rotate_states(start, turn)
        fields = {field: state[:, part] for field, part in STATE_FIELDS.items()}
        wind = Constant(force=tuple(rotate_vectors(force, turn)), torque=torque)
        actions.append(fly(policy, make(3, outputs, wind), state=fields, reference=circle(turn))[1])
    assert_allclose(actions[0], actions[1], atol=rounding)


def circle(angle: float) -> Reference:
    """A circle beside the origin, turned about it."""
    x, y, z = rotate_vectors(np.array([0.4, -0.2, 2.0]), angle)
    return Reference(
        offset=(x, y, z, 0.3 + angle),
        amplitude=(0.8, 0.8, 0.1, 0.2),
        frequency=(0.9, 0.9, 0.5, 0.7),
        phase=(np.pi / 2 + angle, angle, 0.0, 0.5),
    )


@pytest.mark.parametrize("name", SEEING)
@pytest.mark.parametrize("outputs", [False, True])
def test_the_estimated_disturbance_is_the_true_one_in_steady_wind(name: str, outputs: bool) -> None:
    """Forces and torques, that on the bob among them, after 3 s."""
    policy: Any = controller(name)
    force, bob, torque = (0.1, -0.05, 0.08), (0.02, 0.01, 0.0), (0.03, -0.02, 0.01)
    wind = Constant(force=force, bob_force=bob, torque=torque)
    _, _, memory = fly(policy, make(2, outputs, wind), steps=300)
    found = policy.estimated_disturbance(memory)
    assert_allclose(found, np.tile([*force, *bob, *torque], (2, 1)), atol=1e-3)


@pytest.mark.parametrize("outputs", [False, True], ids=["full", "outputs"])
@pytest.mark.parametrize("name", CONTROLLERS)
def test_a_few_mad_readings_are_no_lasting_harm(name: str, outputs: bool) -> None:
    """Positions that jump by 100 m and back leave numbers behind, not nan."""
    env = QuadPendulumVectorEnv(3)
    policy, memory = controller(name), None
    observation, _ = env.reset(seed=0)
    for step in range(60):
        seen = observation.copy()
        if 10 <= step < 14:
            seen[0, OBSERVATION_FIELDS["tracking_error"]] += 50.0 * (-1) ** step
            seen[1, OBSERVATION_FIELDS["direction"]] = [4.0, 0.0, -1.0]
        action, memory = policy.predict(seen[:, OUTPUT_FEEDBACK_COLUMNS] if outputs else seen, memory)
        assert np.isfinite(action).all()
        assert (np.abs(action) <= 1.0).all()
        observation, *_ = env.step(action)


def test_unknown_controllers_are_refused_by_name() -> None:
    with pytest.raises(ValueError, match="there is no controller 'pid'; there are adrc-paper, adrc-matched"):
        controller("pid")
