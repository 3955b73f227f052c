"""Properties that hold for all actions, seeds and winds, checked with Hypothesis."""

from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from quadpend_gym import Constant, OrnsteinUhlenbeck, PaperGusts, Sinusoid
from quadpend_gym.core.arrays import Floats32
from tests.helpers.envs import ENDLESS, assert_same, draw_actions, make_vec, run_actions

STEPS, ROWS = 40, 5
many_examples = settings(deadline=None, max_examples=40)

mostly_constant = arrays(
    np.float32, (STEPS, ROWS, 4), elements=st.floats(-1.0, 1.0, width=32), fill=st.floats(-1.0, 1.0, width=32)
)
random_actions = st.integers(0, 2**32).map(lambda seed: draw_actions(seed, STEPS, ROWS))
bang_bang = random_actions.map(np.sign)
action_sequences = mostly_constant | random_actions | bang_bang
seeds = st.integers(0, 2**64)
magnitudes = st.floats(-10.0, 10.0) | st.floats(-1e12, 1e12)
loads = st.fixed_dictionaries({"force": magnitudes, "bob_force": magnitudes, "torque": magnitudes})
winds = st.one_of(
    st.none(),
    loads.map(lambda load: Constant(**load)),
    loads.map(lambda load: Sinusoid(**load, frequency=20.0)),
    loads.map(lambda load: OrnsteinUhlenbeck(**{key: abs(value) for key, value in load.items()}, time_constant=0.1)),
    magnitudes.map(lambda force: PaperGusts(force=abs(force), yaw_torque=abs(force), onset=0.0, hold=0.1)),
)


@many_examples
@given(actions=action_sequences, seed=seeds, wind=winds, task=st.sampled_from(["track", "hover", ENDLESS]))
def test_observations_are_finite_and_rewards_between_zero_and_one(
    actions: Floats32, seed: int, wind: Any, task: Any
) -> None:
    env = make_vec(ROWS, wind=wind, task=task)
    assert env.observation_space.contains(env.reset(seed=seed)[0])
    for observation, reward, *_, info in run_actions(env, actions):
        assert env.observation_space.contains(observation)
        assert np.isfinite(observation).all()
        assert ((reward >= 0.0) & (reward <= 1.0)).all()
        assert np.isfinite(info["disturbance"]).all()
        assert ((info["tilt"] >= 0.0) & (info["tilt"] <= np.pi)).all()


@many_examples
@given(actions=action_sequences, seed=seeds, wind=winds)
def test_direction_stays_a_unit_vector_and_its_rate_perpendicular(actions: Floats32, seed: int, wind: Any) -> None:
    env = make_vec(ROWS, wind=wind)
    env.reset(seed=seed)
    run_actions(env, actions)
    direction, rate = env.state.direction, env.state.direction_rate
    np.testing.assert_allclose(np.linalg.norm(direction, axis=-1), 1.0, rtol=1e-12)
    np.testing.assert_allclose(
        np.sum(direction * rate, axis=-1) / (1.0 + np.linalg.norm(rate, axis=-1)), 0.0, atol=1e-12
    )


@many_examples
@given(actions=action_sequences, seed=seeds, wind=winds)
def test_the_same_seed_and_actions_give_identical_results(actions: Floats32, seed: int, wind: Any) -> None:
    one, other = make_vec(ROWS, wind=wind), make_vec(ROWS, wind=wind)
    assert_same(one.reset(seed=seed), other.reset(seed=seed))
    assert_same(run_actions(one, actions), run_actions(other, actions))
