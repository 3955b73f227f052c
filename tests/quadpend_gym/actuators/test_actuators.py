"""Actuator models: delay, lag, rate limit, rotors and rotor faults, and the order in which they act."""

import copy
import json
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import solve_ivp

from quadpend_gym import PAPER, Actuators, Parameters, Simulation
from quadpend_gym.actuators import (
    KINDS,
    ActionDelay,
    GyroBias,
    MotorLag,
    PacketLoss,
    RateLimit,
    RotorFault,
    Rotors,
    as_actuators,
)
from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.models import ModelBatch
from quadpend_gym.core.streams import Streams
from quadpend_gym.physics.dynamics import momentum
from quadpend_gym.wrappers import ActuatorWrapper, VectorActuatorWrapper
from tests.helpers.bad_input import assert_refused, assert_refused_unchanged
from tests.helpers.envs import AT_REST, ENDLESS, WINDY, assert_same, draw_actions, make_unwrapped, make_vec, run_actions
from tests.helpers.physics import UNEQUAL

PERIOD = Simulation().period
CHAINS: dict[str, Any] = {
    "delay": ActionDelay(3),
    "lag": MotorLag(0.02),
    "rate limit": RateLimit(30.0),
    "rotors": Rotors(),
    "all": [ActionDelay(2), RateLimit(50.0), MotorLag(0.03), RotorFault(2, 0.5, onset=0.05), Rotors()],
}
chains = pytest.mark.parametrize("actuators", CHAINS.values(), ids=CHAINS.keys())


def apply_actuators(actuators: Any, actions: Any, simulation: Simulation | None = None) -> Floats:
    """Return the result of actuators for the actions of an episode, both of shape (steps, rows, 4)."""
    steps, rows = actions.shape[:2]
    batch, simulation = ModelBatch(as_actuators(actuators), rows), simulation or Simulation()
    batch.start_episodes(np.arange(rows), Streams.from_seeds(list(range(rows))), lambda *_: None)
    out = np.zeros((steps, 4, rows)).swapaxes(1, 2)
    out[:] = actions
    for k in range(steps):
        batch.apply(lambda model, *rest, k=k: model.act(out[k], rest[0], np.full(rows, k), simulation, rest[1]))
    return out


def constant_actions(value: float, steps: int) -> Floats:
    """Return `steps` equal actions with equal components, shape (steps, 1, 4)."""
    return np.full((steps, 1, 4), value)


def without_commands(returned: list[Any]) -> list[Any]:
    """Remove the commands from the results of an environment, since only actuators add them to info."""
    for *_, info in returned:
        del info["command"]
        info.pop("_command", None)
    return returned


@chains
def test_an_episode_equals_one_with_the_actions_that_the_actuators_return(actuators: Any) -> None:
    """Physics, observation and reward, including the effort, are equal to the last bit."""
    env, plain = VectorActuatorWrapper(make_vec(3, task=ENDLESS), actuators), make_vec(3, task=ENDLESS)
    assert_same(without_commands([env.reset(seed=0)]), [plain.reset(seed=0)])
    actions = draw_actions(0, 40, 3)
    assert_same(
        without_commands(run_actions(env, actions)),
        run_actions(plain, apply_actuators(actuators, actions).astype(np.float32)),
    )


def test_info_reports_thrust_and_torques() -> None:
    env = ActuatorWrapper(make_unwrapped(), ActionDelay(1))
    _, info = env.reset(seed=0)
    hover = [PAPER.hover_thrust, 0.0, 0.0, 0.0]
    assert_allclose(info["command"], hover)
    action = np.array([0.5, 0.1, -0.2, 0.3], np.float32)
    first, second = (env.step(action)[4]["command"] for _ in range(2))
    assert_allclose(first, hover)
    assert_allclose(second, [1.5 * PAPER.hover_thrust, 0.5, -1.0, 0.3], rtol=1e-6)


@pytest.mark.parametrize("steps", [1, 2, 7])
def test_a_delay_shifts_the_actions_and_begins_with_hover(steps: int) -> None:
    env, plain = ActuatorWrapper(make_unwrapped(wind=WINDY), ActionDelay(steps)), make_unwrapped(wind=WINDY)
    actions = draw_actions(0, 30)
    for seed in (0, None):  # the second episode does not depend on the first
        assert_same(without_commands([env.reset(seed=seed)]), [plain.reset(seed=seed)])
        assert_same(
            without_commands(run_actions(env, actions)),
            run_actions(plain, [np.zeros(4)] * steps + list(actions[:-steps])),
        )


@pytest.mark.parametrize("period", [0.005, 0.02])
@pytest.mark.parametrize("time_constant", [0.003, 0.05, 1.0])
def test_a_motor_lag_solves_its_differential_equation(time_constant: float, period: float) -> None:
    """The result is the mean over each period of a numerical solution of T ẏ = a − y."""
    actions, y, means = draw_actions(0, 12, 1), np.zeros(4), []
    for action in actions[:, 0].astype(np.float64):

        def rates(_: float, values: Floats, a: Floats = action) -> Floats:
            return np.concatenate([(a - values[:4]) / time_constant, values[:4]])

        solution = solve_ivp(rates, (0.0, period), np.concatenate([y, np.zeros(4)]), rtol=1e-10, atol=1e-12)
        y, integral = np.split(solution.y[:, -1], 2)
        means.append(integral / period)
    assert_allclose(
        apply_actuators(MotorLag(time_constant), actions, Simulation(period=period))[:, 0], means, atol=1e-8
    )


@pytest.mark.parametrize("period", [0.002, 0.01, 0.05])
def test_the_time_constant_and_the_impulse_of_a_lag_do_not_depend_on_the_control_period(period: float) -> None:
    time_constant, simulation = 0.04, Simulation(period=period)
    step = apply_actuators(MotorLag(time_constant), constant_actions(1.0, round(2.0 / period)), simulation)
    # ∫ (1 − y) dt = T for the response to a step.
    assert_allclose(period * np.sum(1.0 - step, axis=0), time_constant, rtol=1e-9)
    pulse = np.concatenate([constant_actions(0.7, 5), constant_actions(0.0, round(2.0 / period))])
    assert_allclose(
        apply_actuators(MotorLag(time_constant), pulse, simulation).sum(axis=0), pulse.sum(axis=0), rtol=1e-9
    )


def test_a_rate_limit_bounds_the_slope_and_reaches_the_action() -> None:
    max_change = 12.0 * PERIOD
    actions = np.concatenate([draw_actions(0, 40, 5), constant_actions(0.9, 20) + np.zeros((20, 5, 4))])
    out = apply_actuators(RateLimit(12.0), actions)
    slopes = np.diff(out, axis=0, prepend=np.zeros((1, 5, 4)))  # from hover
    assert np.abs(slopes).max() <= max_change + 1e-15
    assert_allclose(out[-1], 0.9, rtol=1e-15)
    # Where the action is not reached, the slope is at the limit.
    limited = np.abs(out - actions) > 1e-12
    assert_allclose(np.abs(slopes[limited]), max_change, rtol=1e-12)
    assert 0.2 < limited.mean() < 0.9


def test_a_rate_limit_does_not_change_slow_actions() -> None:
    slow = np.linspace(0.0, 0.8, 50)[:, np.newaxis, np.newaxis] * np.ones((1, 2, 4))
    assert_allclose(apply_actuators(RateLimit(2.0), slow), slow, atol=1e-15)


def test_a_lost_command_is_replaced_by_the_last_one_that_arrived() -> None:
    actions = draw_actions(0, 300, 20).astype(np.float64)
    out = apply_actuators(PacketLoss(0.2), actions)
    arrived = (out == actions).all(axis=-1)
    before = np.concatenate([np.zeros((1, 20, 4)), out[:-1]])  # hover before the first command
    assert_array_equal(out[~arrived], before[~arrived])
    assert (~arrived).mean() == pytest.approx(0.2, abs=5.0 * np.sqrt(0.2 * 0.8 / arrived.size))
    assert not apply_actuators(PacketLoss(1.0), actions).any()
    assert_array_equal(apply_actuators(PacketLoss(0.0), actions), actions)


# Positions of the rotors (m) and signs of their drag torques: front, left, back, right.
ARM, DRAG_RATIO = 0.15, 0.03
POSITIONS = ARM * np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
DRAG_SIGNS = np.array([1.0, -1.0, 1.0, -1.0])


def thrust_and_torques(forces: Floats) -> Floats:
    """Return the sum of four upward forces (N) at the rotors, and their moments about the centre (N·m), shape (4,)."""
    upward = np.multiply.outer(forces, [0.0, 0.0, 1.0])
    moments = np.cross(POSITIONS, upward) + (DRAG_SIGNS * DRAG_RATIO)[:, np.newaxis] * upward
    return np.array([forces.sum(), *moments.sum(axis=0)])


@pytest.mark.parametrize("action", [*np.eye(4), *-np.eye(4), *draw_actions(1, 4)])
def test_rotors_act_on_the_body_like_forces_at_their_positions(action: Floats) -> None:
    """Thrust and torques are measured as the change of momentum and body rates in a short step from rest."""
    simulation = Simulation(UNEQUAL, Actuators(roll_pitch_torque=4.0, yaw_torque=0.7), period=1e-4)
    env = ActuatorWrapper(make_unwrapped(simulation=simulation), Rotors(ARM, DRAG_RATIO))
    env.reset(seed=0, options={"state": AT_REST})
    env.step(action)
    p, state = UNEQUAL, env.unwrapped.state  # type: ignore[attr-defined]
    lift = momentum(state.array, p)[2] / simulation.period + p.hover_thrust
    torques = state.euler_rate / simulation.period * [p.inertia_roll, p.inertia_pitch, p.inertia_yaw]
    forces = p.hover_thrust / 4.0 * (1.0 + action)  # 0 … W/2 each
    assert_allclose([lift, *torques], thrust_and_torques(forces), rtol=1e-6, atol=1e-6)


def test_the_torques_of_each_rotor_have_the_signs_of_the_paper() -> None:
    """The paper's τφ = (f₂ − f₄) d, τθ = (f₃ − f₁) d, τψ = κ (f₁ − f₂ + f₃ − f₄)."""
    signs = np.sign(np.round(apply_actuators(Rotors(), np.eye(4)[:, np.newaxis]), 12))[:, 0]
    assert signs.tolist() == [[1, 0, -1, 1], [1, 1, 0, -1], [1, 0, 1, 1], [1, -1, 0, -1]]


def test_a_zero_action_of_the_rotors_is_hover() -> None:
    env = ActuatorWrapper(make_unwrapped(), Rotors())
    env.reset(seed=0, options={"state": AT_REST})
    run_actions(env, np.zeros((20, 4)))
    assert_allclose(env.unwrapped.state.array, np.concatenate(list(AT_REST.values())), atol=1e-12)  # type: ignore[attr-defined]


def test_the_rotors_range_from_no_thrust_to_twice_the_weight() -> None:
    assert_allclose(apply_actuators(Rotors(), constant_actions(-1.0, 1))[0, 0], [-1.0, 0.0, 0.0, 0.0], atol=1e-15)
    assert_allclose(apply_actuators(Rotors(), constant_actions(1.0, 1))[0, 0], [1.0, 0.0, 0.0, 0.0], atol=1e-15)


@pytest.mark.parametrize("rotor", [1, 2, 3, 4])
def test_a_rotor_fault_reduces_the_thrust_after_its_onset(rotor: int) -> None:
    onset_step, effectiveness = 6, 0.6
    actions = draw_actions(0, 20, 2).astype(np.float64)
    thrusts = 1.0 + actions  # in quarters of the weight
    thrusts[onset_step:, :, rotor - 1] *= effectiveness
    faulty = apply_actuators([RotorFault(rotor, effectiveness, onset=onset_step * PERIOD), Rotors()], actions)
    assert_allclose(faulty, apply_actuators(Rotors(), thrusts - 1.0), atol=1e-14)


@pytest.mark.parametrize("onset", [0.0, 0.07, 0.29, 0.57])
def test_a_rotor_fault_takes_effect_in_the_step_of_its_onset(onset: float) -> None:
    env: Any = ActuatorWrapper(make_unwrapped(), [RotorFault(1, 0.9, onset), Rotors()])
    env.reset(seed=0, options={"state": AT_REST})
    still = []
    for action in np.zeros((round(onset / PERIOD) + 1, 4)):
        env.step(action)
        still.append(np.abs(env.unwrapped.state.euler_rate).max() < 1e-9)
    assert all(still[:-1])
    assert not still[-1]


def test_actuators_act_in_the_order_of_the_list() -> None:
    actions, one, other = draw_actions(0, 30, 2), RateLimit(20.0), MotorLag(0.05)
    one_first, other_first = apply_actuators([one, other], actions), apply_actuators([other, one], actions)
    assert_array_equal(one_first, apply_actuators(other, apply_actuators(one, actions)))
    assert_array_equal(other_first, apply_actuators(one, apply_actuators(other, actions)))
    assert np.abs(one_first - other_first).max() > 0.1


def test_the_actuators_of_an_outer_wrapper_act_first() -> None:
    one, *others = CHAINS["all"]
    nested = ActuatorWrapper(ActuatorWrapper(make_unwrapped(), others), one)
    flat = ActuatorWrapper(make_unwrapped(), [one, *others])
    assert_same(nested.reset(seed=0), flat.reset(seed=0))
    actions = draw_actions(0, 30)
    assert_same(run_actions(nested, actions), run_actions(flat, actions))


def test_the_effort_reward_is_computed_from_the_result_of_the_actuators() -> None:
    env = ActuatorWrapper(make_unwrapped(), [ActionDelay(1), MotorLag(0.02)])
    env.reset(seed=0)
    efforts = [info["reward_terms"]["effort"] for *_, info in run_actions(env, np.full((3, 4), 0.5))]
    mean = 0.5 * (1.0 - (0.02 / PERIOD) * (1.0 - np.exp(-PERIOD / 0.02)))  # over the first period that moves
    assert efforts[0] == 1.0
    assert efforts[1] == pytest.approx(1.0 / (1.0 + 4.0 * mean**2), rel=1e-6)
    assert efforts[2] < efforts[1]


@dataclass(frozen=True)
class ReversesEveryOtherStep:
    """An actuator that reverses the action in every other step."""

    memory_size: int = 1

    def initial_memory(self, streams: Any) -> Floats:
        return np.ones((streams.keys.size, 1))

    def act(self, action: Floats, memory: Floats, step: Any, simulation: Any, streams: Any) -> None:
        action *= memory
        memory *= -1.0


def test_an_actuator_needs_no_base_class() -> None:
    env, plain = ActuatorWrapper(make_unwrapped(), ReversesEveryOtherStep()), make_unwrapped()
    assert_same(without_commands([env.reset(seed=0)]), [plain.reset(seed=0)])
    actions = draw_actions(0, 10)
    assert_same(
        without_commands(run_actions(env, actions)), run_actions(plain, actions * np.tile([[1.0], [-1.0]], (5, 1)))
    )


@chains
def test_actuators_are_plain_data(actuators: Any) -> None:
    models = as_actuators(actuators)
    assert as_actuators(json.loads(json.dumps([asdict(model) for model in models]))) == models


def test_every_kind_is_created_from_its_name() -> None:
    for kind, model in KINDS.items():
        assert as_actuators({"kind": kind}) == (model(),)


BAD_CHAINS: dict[str, tuple[Any, str]] = {
    "rotors twice": ([Rotors(), Rotors(0.1)], "only once"),
    "a fault without rotors": (RotorFault(), "a RotorFault needs rotors"),
    "a fault after rotors": ([Rotors(), RotorFault()], "a RotorFault needs rotors"),
    "a gyro without body rates": (GyroBias(), 'GyroBias needs the interface "body_rates", not "wrench"'),
    "long arms": (Rotors(arm=2.0), r"torque of up to 6.86 N·m exceeds the simulation's limit of 5 N·m"),
    "strong drag": (Rotors(drag_ratio=0.5), r"torque of up to 3.43 N·m exceeds the simulation's limit of 1 N·m"),
}


@pytest.mark.parametrize(("chain", "names"), BAD_CHAINS.values(), ids=BAD_CHAINS.keys())
def test_bad_combinations_in_one_wrapper_are_refused(chain: Any, names: str) -> None:
    single, rows = make_unwrapped(), make_vec(2)
    single.reset(seed=0), rows.reset(seed=0)
    assert_refused_unchanged(single, lambda: ActuatorWrapper(single, chain), names, ValueError)
    assert_refused_unchanged(rows, lambda: VectorActuatorWrapper(rows, chain), names, ValueError)


def test_bad_combinations_of_several_wrappers_are_refused() -> None:
    env = ActuatorWrapper(make_unwrapped(), [MotorLag(), Rotors()])
    assert_refused(lambda: ActuatorWrapper(copy.deepcopy(env), Rotors()), "only once", ValueError)
    inside = ActuatorWrapper(make_unwrapped(), MotorLag())
    assert_refused(lambda: ActuatorWrapper(inside, RotorFault()), "needs rotors", ValueError)
    ActuatorWrapper(env, RotorFault()).reset(seed=0)


def test_the_torque_limit_bounds_the_length_of_the_arms() -> None:
    """The largest torque is 2 f d with the nominal weight W, f = W/4, one rotor at full and one at zero thrust."""
    limit = 2.0 * 5.0 / Parameters().hover_thrust
    ActuatorWrapper(make_unwrapped(), Rotors(arm=limit))
    assert_refused(
        lambda: ActuatorWrapper(make_unwrapped(), Rotors(arm=1.01 * limit)),
        "exceeds the simulation's limit",
        ValueError,
    )
    raised = Simulation(actuators=Actuators(roll_pitch_torque=6.0))
    ActuatorWrapper(make_unwrapped(simulation=raised), Rotors(arm=1.01 * limit))


@dataclass(frozen=True)
class RandomAction:
    """An actuator that replaces the action by random numbers."""

    memory_size: int = 0

    def initial_memory(self, streams: Streams) -> Floats:
        return np.empty((streams.keys.size, 0))

    def act(self, action: Floats, memory: Floats, step: Any, simulation: Simulation, streams: Streams) -> None:
        action[:] = 0.1 * streams.uniform(step + 1, 4)


def test_an_added_outer_actuator_does_not_change_the_random_numbers_of_the_others() -> None:
    alone = ActuatorWrapper(make_unwrapped(), RandomAction())
    behind = ActuatorWrapper(ActuatorWrapper(make_unwrapped(), RandomAction()), MotorLag())
    for env in (alone, behind):
        env.reset(seed=0)
    assert_same(run_actions(behind, draw_actions(0, 5)), run_actions(alone, draw_actions(0, 5)))
