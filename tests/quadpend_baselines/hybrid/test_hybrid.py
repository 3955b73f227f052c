"""A companion knows what it knows, does what it is steered to, and is told what acted."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from quadpend_baselines.hybrid.companion import Companion

from quadpend_baselines import CONTROLLERS, controller
from quadpend_baselines.controllers.flatness import Flatness
from quadpend_baselines.controllers.output_feedback import OutputFeedback
from quadpend_baselines.estimation.estimator import measurement_from_observation, observation_from_state
from quadpend_baselines.gains import GAINS
from quadpend_baselines.policy.protocol import replace_rows, to_action, to_command
from quadpend_gym import OBSERVATION_FIELDS, Actuators, Constant, Parameters, Reference, Simulation
from quadpend_gym.core.arrays import Floats, Floats32
from quadpend_gym.physics.state import STATE_SIZE, State
from quadpend_gym.tasks.observation import OUTPUT_FEEDBACK_COLUMNS, REFERENCE_START
from quadpend_gym.wrappers import VectorOutputFeedbackWrapper
from tests.helpers.bad_input import assert_refused
from tests.helpers.envs import assert_same, draw_actions, make_vec
from tests.helpers.hybrid import Steered, constant, flown, idle
from tests.helpers.wrappers import SHORT

ROD = Parameters().rod_length
SAME_STEP = {"autoreset_mode": "SameStep"}
FORCES = (0.1, -0.2, 0.1)  # N
observers = pytest.mark.parametrize("name", ["flatness", "lqi", "adrc-matched"])
feedbacks = pytest.mark.parametrize("outputs", [False, True], ids=["whole", "outputs"])


def random_states(rows: int) -> Floats:
    """States in the reference's frame, with directions of unit length, shape (rows, 18)."""
    state = np.random.default_rng(0).normal(size=(rows, STATE_SIZE))
    direction = State(state).direction
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return state


def random_observations(rows: int, outputs: bool) -> Floats32:
    """Observations, of which the reference counts, shape (rows, 36) or (rows, 27)."""
    observation = np.random.default_rng(1).normal(size=(rows, 36)).astype(np.float32)
    return observation[:, OUTPUT_FEEDBACK_COLUMNS] if outputs else observation


@feedbacks
def test_what_is_written_is_what_would_have_been_read(outputs: bool) -> None:
    """Beside any yaw reference; written upon a whole observation or upon one without velocities."""
    state, measured = random_states(200), random_observations(200, outputs)
    observation = observation_from_state(state, measured, ROD)
    assert observation.shape == (200, 36)
    assert observation.dtype == np.float32
    again = measurement_from_observation(observation, ROD)
    assert_allclose(again.state, state, atol=3e-6)
    assert_array_equal(again.reference, measurement_from_observation(measured, ROD).reference)
    assert_array_equal(again.yaw_reference, measurement_from_observation(measured, ROD).yaw_reference)
    assert_allclose(observation_from_state(again.state, observation, ROD), observation, atol=1e-5)


def test_writing_changes_none_of_what_is_written_from() -> None:
    state, measured = random_states(5), random_observations(5, False)
    kept = state.copy(), measured.copy()
    observation_from_state(state, measured, ROD)
    assert_same((state, measured), kept)


@pytest.mark.parametrize("name", ["flatness", "lqr", "lqi"])
def test_perfect_sensors_in_calm_air_are_believed(name: str) -> None:
    policy: Any = controller(name)
    env = make_vec(6, **SAME_STEP, **SHORT)
    observation, memory, started = env.reset(seed=0)[0], None, np.ones(6, np.bool_)
    for _ in range(60):
        action, memory = policy.predict(observation, memory, started)
        assert_allclose(policy.estimated_observation(observation, memory), observation, atol=1e-6)
        observation, _, terminated, truncated, _ = env.step(action)
        started = terminated | truncated


def test_velocities_that_are_not_measured_are_estimated() -> None:
    policy: Any = controller("flatness")
    whole = make_vec(4)
    hidden = VectorOutputFeedbackWrapper(make_vec(4))
    true, observation, memory = whole.reset(seed=0)[0], hidden.reset(seed=0)[0], None
    for _ in range(200):
        action, memory = policy.predict(observation, memory)
        true, observation = whole.step(action)[0], hidden.step(action)[0]
    known = policy.update(observation, memory, None)
    assert_allclose(policy.estimated_observation(observation, known), true, atol=1e-4)


@observers
@feedbacks
def test_the_learner_sees_state_disturbance_and_where_it_corrects_the_action(name: str, outputs: bool) -> None:
    env: Any = make_vec(5, wind="windy", **SAME_STEP)
    env = VectorOutputFeedbackWrapper(env) if outputs else env
    observation, _ = env.reset(seed=0)
    policy: Any = controller(name)
    action, known = policy.predict(observation)
    whole = isinstance(policy, OutputFeedback)
    state = policy.estimated_observation(observation, known) if whole else observation
    disturbance = policy.estimated_disturbance(known)
    near = np.full(state.shape[1], 1.0)
    near[: state.shape[1] - 18] = 10.0
    expected = {
        "alone": [state, disturbance],
        "action": [near * state, disturbance, 10.0 * action],
        "pace": [near * state, disturbance],
    }
    for steers in ("alone", "action", *(["pace"] if name == "flatness" else [])):
        companion = Companion(policy, steers)
        seen, _ = companion.watch(observation, None, np.ones(5, np.bool_))
        assert seen.dtype == np.float32
        assert seen.shape == (5, companion.size(observation.shape[1]))
        assert_allclose(seen, np.concatenate(expected[steers], axis=1), rtol=1e-6, atol=1e-7)


def test_the_disturbance_is_seen_as_the_info_has_it() -> None:
    env = make_vec(3, wind=Constant(FORCES, torque=0.02), max_episode_steps=None)
    policy = Steered(Companion(controller("flatness")), lambda seen: bare)
    bare = np.zeros((3, 4), np.float32)
    teacher, observation, memories = controller("flatness"), env.reset(seed=0)[0], [None, None]
    for _ in range(300):
        bare, memories[0] = teacher.predict(observation, memories[0])
        action, memories[1] = policy.predict(observation, memories[1])
        assert_array_equal(action, bare)
        observation, *_, info = env.step(action)
    assert_allclose(policy.seen[-1][:, 36:], info["disturbance"], atol=1e-3)


@observers
@feedbacks
def test_a_learner_that_corrects_nothing_leaves_the_flight_as_it_is(name: str, outputs: bool) -> None:
    """To the bit, row by row, through the ends of episodes."""
    flights = []
    for policy in (controller(name), Steered(Companion(controller(name), "action", 0.7))):
        env: Any = make_vec(6, wind="windy", **SAME_STEP, **SHORT)
        flights.append(flown(policy, VectorOutputFeedbackWrapper(env) if outputs else env, 70))
    assert_same(flights[0][0], flights[1][0])
    assert_same([part[:4] for part in flights[0][1]], [part[:4] for part in flights[1][1]])
    assert np.sum([part[2] | part[3] for part in flights[0][1]]) >= 12


def test_a_learner_that_hurries_nothing_leaves_the_flight_as_it_is() -> None:
    flights = [
        flown(policy, make_vec(6, wind="windy", **SAME_STEP, **SHORT), 70)
        for policy in (controller("flatness"), Steered(Companion(controller("flatness"), "pace", 2.0)))
    ]
    assert_allclose(flights[1][0], flights[0][0], atol=1e-12)
    assert_array_equal([part[0] for part in flights[1][1]], [part[0] for part in flights[0][1]])


@observers
def test_a_correction_is_added_with_its_authority_and_keeps_to_the_limits(name: str) -> None:
    observation, _ = make_vec(4).reset(seed=0)
    bare, _ = controller(name).predict(observation)
    for learner, authority in (((0.5, -0.5, 1.0, -1.0), 0.2), ((1.0, -1.0, 1.0, -1.0), 3.0)):
        action, memory = Steered(Companion(controller(name), "action", authority), constant(*learner)).predict(
            observation
        )
        assert_allclose(action, np.clip(bare + authority * np.float32(learner), -1.0, 1.0), atol=1e-6)
        size = Simulation().command_scale
        assert_allclose(memory.controller.command, size * (action + np.eye(4)[0]), rtol=1e-6)


@pytest.mark.parametrize("told", [True, False])
@pytest.mark.parametrize("name", ["flatness", "adrc-matched"])
def test_the_observer_is_told_what_acted(name: str, told: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a push of the learner's at every step, it still finds the wind; untold, it takes the push for wind."""
    policy: Any = controller(name)
    if not told:
        monkeypatch.setattr(policy, "acted", lambda memory, action: memory)
    env = make_vec(2, wind=Constant(FORCES), max_episode_steps=None)
    steered = Steered(Companion(policy, "action", 1.0), constant(0.02, 0.0, 0.0, 0.2))
    observation, memory = env.reset(seed=0, options={"reference": Reference.hover()})[0], None
    for _ in range(400):
        action, memory = steered.predict(observation, memory)
        observation, *_, info = env.step(action)
    off = np.abs(policy.estimated_disturbance(memory.controller) - info["disturbance"])
    if told:
        assert off.max() < 0.005
    else:
        assert (off[:, 2] > 0.1).all()  # 0.02 of 6.86 N
        assert (off[:, 8] > 0.1).all()  # 0.2 of 1 N·m


def test_a_learner_that_flies_alone_is_followed_by_the_observer() -> None:
    """The observer of ADRC finds the wind while another controller flies."""
    pilot = controller("flatness")
    policy: Any = controller("adrc-matched")
    companion = Companion(policy)
    env = make_vec(3, wind=Constant(FORCES), max_episode_steps=None)
    memories: list[Any] = [None, None]
    observation, _ = env.reset(seed=0, options={"reference": Reference.hover()})
    for _ in range(400):
        action, memories[0] = pilot.predict(observation, memories[0])
        _, memory = companion.watch(observation, memories[1], np.full(3, memories[1] is None))
        acting, memories[1] = companion.act(action, memory)
        assert_array_equal(acting, action)
        observation, *_, info = env.step(acting)
    found = policy.estimated_disturbance(memories[1].controller)
    assert_allclose(found, info["disturbance"], atol=0.01)


@pytest.mark.parametrize(
    ("number", "names"),
    [
        (0, ["position_bandwidth"]),
        (1, ["pendulum_bandwidth", "far_pendulum_bandwidth"]),
        (2, ["attitude_bandwidth", "far_attitude_bandwidth"]),
        (3, ["vertical_bandwidth"]),
    ],
)
@pytest.mark.parametrize(("asked", "factor"), [(1.0, 1.5), (-1.0, 1.0 / 1.5), (0.5, np.sqrt(1.5))])
def test_a_pace_multiplies_a_bandwidth(number: int, names: list[str], asked: float, factor: float) -> None:
    """By (1 + authority)^a: it flies as gains do that are scaled by hand, and not as the bare ones."""
    gains: Any = GAINS["flatness"]
    scaled = replace(gains, **{name: factor * getattr(gains, name) for name in names})
    learner = constant(*(asked * np.eye(4)[number]))
    pilots = [
        Steered(Companion(controller("flatness"), "pace", 0.5), learner),
        OutputFeedback(Flatness, scaled),
        OutputFeedback(Flatness, gains),
    ]
    steered, by_hand, bare = (flown(pilot, make_vec(3, wind="windy", **SAME_STEP), 30)[0] for pilot in pilots)
    assert_allclose(steered, by_hand, atol=1e-5)
    assert np.abs(np.subtract(steered, bare)).max() > 1e-3


def test_rows_that_begin_anew_do_and_the_others_go_on() -> None:
    companion = Companion(controller("flatness"), "action")
    observation, _ = make_vec(4, wind="windy").reset(seed=0)
    _, memory = companion.act(idle(observation), companion.watch(observation, None, np.ones(4, np.bool_))[1])
    later, _ = make_vec(4).reset(seed=9)
    started = np.array([False, True, False, True])
    seen, _ = companion.watch(later, memory, started)
    fresh, _ = companion.watch(later, None, started)
    going, _ = companion.watch(later, memory, np.zeros(4, np.bool_))
    assert_array_equal(seen[started], fresh[started])
    assert_array_equal(seen[~started], going[~started])
    assert (fresh != going).any(axis=1).all()


class Mute:
    """A controller that says nothing of the wind."""

    def predict(self, *_: Any) -> Any:
        return None

    def __repr__(self) -> str:
        return "Mute()"


@pytest.mark.parametrize(
    ("make", "message", "kind"),
    [
        (lambda: Companion(Mute()), r"estimates the disturbance, not Mute\(\)", TypeError),
        (lambda: Companion("flatness"), "estimates the disturbance, not 'flatness'", TypeError),
        (
            lambda: Companion(controller("lqr"), "all"),
            "steers must be one of alone, action, pace, not 'all'",
            ValueError,
        ),
        (lambda: Companion(controller("lqr"), "action", 0.0), "authority must be above zero", ValueError),
        (lambda: Companion(controller("lqr"), "action", 4.0), r"authority .* \[0, 3\], not 4.0", ValueError),
        (lambda: Companion(controller("lqr"), "action", np.nan), "authority .* not nan", ValueError),
        (lambda: Companion(controller("lqr"), "action", "much"), "authority must be a number, not 'much'", TypeError),
        *(
            (lambda name=name: Companion(controller(name), "pace"), "only the flatness-based .* has a pace", TypeError)
            for name in CONTROLLERS
            if name != "flatness"
        ),
    ],
)
def test_an_impossible_companion_is_refused(make: Any, message: str, kind: Any) -> None:
    assert_refused(make, message, kind)


def test_a_command_is_what_an_action_stands_for() -> None:
    """And back, to the bit."""
    for simulation in (Simulation(), Simulation(Parameters(bob_mass=0.3), Actuators(yaw_torque=2.0))):
        actions = draw_actions(0, 50)
        command = to_command(actions, simulation)
        thrust = simulation.parameters.hover_thrust
        assert_allclose(command[:, 0], thrust * (1.0 + actions[:, 0]), rtol=1e-6)
        assert_array_equal(to_command(np.zeros((1, 4), np.float32), simulation), [[thrust, 0.0, 0.0, 0.0]])
        again, really = to_action(command, simulation)
        assert_array_equal(again, actions)
        assert_array_equal(really, command)


def test_rows_are_placed_through_tuples_of_arrays() -> None:
    policy: Any = controller("flatness")
    memories = [policy.predict(make_vec(rows).reset(seed=rows)[0])[1] for rows in (5, 2)]
    kept = [tuple(memory.estimate) for memory in memories]
    whole = replace_rows(np.array([3, 1]), memories[1], memories[0])
    assert type(whole) is type(memories[0])
    assert_array_equal(whole.command[[3, 1]], memories[1].command)
    assert_array_equal(whole.command[[0, 2, 4]], memories[0].command[[0, 2, 4]])
    assert_array_equal(whole.estimate.state[[3, 1]], memories[1].estimate.state)
    assert_same([tuple(memory.estimate) for memory in memories], kept)


def test_the_layout_of_the_state_part_is_that_of_the_table() -> None:
    """What is seen ten times as large is what comes of the state, and nothing of the reference."""
    assert REFERENCE_START == OBSERVATION_FIELDS["reference_2"].start == 18
