"""The nonlinear model is differentially flat: the bob's position and the yaw determine the state and the command.

The tests represent a function of time by its Taylor coefficients at t = 0. Derivatives are then exact, and each one
shortens the series by one coefficient.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import solve_triangular, toeplitz

from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.dynamics import accelerations
from quadpend_gym.physics.state import DISTURBANCE_SIZE, STATE_SIZE, State
from tests.helpers.physics import UNEQUAL

UP = np.array([0.0, 0.0, 1.0])


def rate(series: Floats) -> Floats:
    """Return the time derivative; coefficients of shape (n,) or (3, n)."""
    return series[..., 1:] * np.arange(1, series.shape[-1])


def integral(series: Floats, start: float) -> Floats:
    """Return the integral of a series with the value `start` at t = 0."""
    return np.append(start, series / np.arange(1, series.size + 1))


def times(a: Floats, b: Floats) -> Floats:
    """Return a b."""
    return np.convolve(a, b)[: min(a.size, b.size)]


def over(a: Floats, b: Floats) -> Floats:
    """Return a / b."""
    return np.asarray(solve_triangular(toeplitz(b, np.zeros(b.size))[: a.size, : a.size], a, lower=True))


def root(a: Floats) -> Floats:
    """Return √a."""
    out = np.zeros(a.size)
    out[0] = np.sqrt(a[0])
    for k in range(1, a.size):
        out[k] = (a[k] - times(out, out)[k]) / (2.0 * out[0])
    return out


def angle(sine: Floats, cosine: Floats) -> Floats:
    """Return atan2(sine, cosine); both may be scaled by a common factor."""
    size = sine.size - 1
    numerator = times(rate(sine), cosine[:size]) - times(sine[:size], rate(cosine))
    squared = times(sine, sine)[:size] + times(cosine, cosine)[:size]
    return integral(over(numerator, squared), float(np.arctan2(sine[0], cosine[0])))


def unit(vector: Floats) -> tuple[Floats, Floats]:
    """Return the norm of a (3, n) vector and the unit vector along it."""
    norm = root(np.sum([times(component, component) for component in vector], axis=0))
    return norm, np.array([over(component, norm) for component in vector])


def with_weight(acceleration: Floats) -> Floats:
    """Return a + g e₃."""
    out = acceleration.copy()
    out[:, 0] += UNEQUAL.gravity * UP
    return out


@pytest.mark.parametrize("seed", range(20))
def test_state_and_command_follow_from_the_bobs_position_and_the_yaw(seed: int) -> None:
    """The position p of the bob and six derivatives, and the yaw ψ and two derivatives, are random."""
    p = UNEQUAL
    rng = np.random.default_rng([4, seed])
    orders = np.cumprod([1.0, *range(1, 7)])
    bob, yaw = rng.normal(size=(3, 7)) / orders, rng.normal(size=3)
    bob[:, 2:] *= 3.0

    lift = with_weight(rate(rate(bob)))  # p̈ + g e₃ = N r / m_c, since only the rod and gravity act on the bob
    _, direction = unit(lift)
    quadrotor = bob[:, :5] - p.rod_length * direction
    force = p.quadrotor_mass * with_weight(rate(rate(quadrotor))) + p.bob_mass * lift[:, :3]
    thrust, axis = unit(force)  # u, R e₃
    heading = np.exp(1j * yaw[0]) * np.array([1.0, 1j * yaw[1], 1j * yaw[2] - 0.5 * yaw[1] ** 2])  # e^(iψ)
    cosine, sine = heading.real, heading.imag
    # In the frame rotated by the yaw, the axis is (sθ cφ, −sφ, cθ cφ).
    ahead = times(cosine, axis[0]) + times(sine, axis[1])
    left = times(cosine, axis[1]) - times(sine, axis[0])
    level = root(np.append(1.0, np.zeros(2)) - times(left, left))
    euler = np.array([angle(-left, level), angle(ahead, axis[2]), yaw])

    parts = [quadrotor, rate(quadrotor), euler, rate(euler), direction, rate(direction)]
    state = np.concatenate([part[:, 0] for part in parts])
    assert state.shape == (STATE_SIZE,)
    assert_allclose(np.linalg.norm(State(state).direction), 1.0, rtol=1e-12)
    inertia = np.array([p.inertia_roll, p.inertia_pitch, p.inertia_yaw])
    command = np.append(thrust[0], inertia * rate(rate(euler))[:, 0])
    actual = accelerations(state, command, np.zeros(DISTURBANCE_SIZE), p)
    for name, series in (("position", quadrotor), ("euler", euler), ("direction", direction)):
        assert_allclose(getattr(actual, name), rate(rate(series))[:, 0], rtol=1e-9, atol=1e-9, err_msg=name)
