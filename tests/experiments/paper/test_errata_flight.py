"""The printed control laws let the pendulum fall in the nonlinear simulation, and the corrected ones converge.

The laws (16), (23), (51) and (52) use the true derivatives at 1 kHz, in calm air and with the gains of Section 5, so
that only the control laws determine the result. The start is 5 cm from the hover position in x and in y.
"""

from typing import NamedTuple

import numpy as np
import pytest

from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.dynamics import thrust_axis
from quadpend_gym.physics.euler_kernel import advance
from quadpend_gym.physics.state import DISTURBANCE_SIZE, STATE_SIZE, State
from quadpend_gym.physics.vectors import Vec3
from quadpend_gym.vehicles import PAPER

PERIOD, SECONDS = 1e-3, 6.0
GK = PAPER.gravity * PAPER.chain_stiffness
HORIZONTAL = np.polynomial.polynomial.polypow([7.0**2, 2 * 0.9 * 7.0, 1.0], 3)[:-1]  # k₀ … k₅
VERTICAL = np.array([10.0**2, 2 * 0.9 * 10.0])
TARGET = np.array([0.0, 0.0, 2.0])


class Laws(NamedTuple):
    """A variant of the laws: signs of v and of F⁽⁴⁾ in τθ and in τφ, sign of α in F_y⁽⁴⁾, and whether x, y share α."""

    pitch: tuple[float, float] = (-1.0, 1.0)
    roll: tuple[float, float] = (1.0, -1.0)
    fourth_y: float = 1.0
    one_tilt: bool = False


# With the seconds until the pendulum is tilted by 60°; all other equations are corrected.
PRINTED = {
    "(51)": (Laws(pitch=(1.0, 1.0)), 0.30),
    "(52)": (Laws(roll=(-1.0, 1.0)), 0.33),
    "(51) and (52)": (Laws(pitch=(1.0, 1.0), roll=(-1.0, 1.0)), 0.20),
    "(43), (44) and (52)": (Laws(roll=(-1.0, 1.0), fourth_y=-1.0), 0.46),
    "(43) and (44)": (Laws(fourth_y=-1.0), 1.44),
    "(30) and (31)": (Laws(one_tilt=True), 0.46),
}


def torques(law: Laws, s: State) -> tuple[float, float]:
    """Return τφ and τθ (N·m), with F⁽ⁱ⁾ from (32)–(37) and (39)–(44)."""
    tilt, tilt_rate = s.direction[:2], s.direction_rate[:2]
    if law.one_tilt:
        size = np.hypot(*tilt)
        tilt, tilt_rate = np.full(2, size), np.full(2, tilt @ tilt_rate / max(size, 1e-12))
    attitude, attitude_rate = (angles[[1, 0]] * [-1.0, 1.0] for angles in (s.euler, s.euler_rate))
    sign = np.array([1.0, law.fourth_y])
    chain = [
        s.position[:2] + PAPER.rod_length * tilt - TARGET[:2],
        s.velocity[:2] + PAPER.rod_length * tilt_rate,
        PAPER.gravity * tilt,
        PAPER.gravity * tilt_rate,
        GK * (sign * tilt + attitude),
        GK * (sign * tilt_rate + attitude_rate),
    ]
    v = -sum(k * derivative for k, derivative in zip(HORIZONTAL, chain, strict=True)) / GK
    fourth = chain[4] / PAPER.gravity
    roll, pitch = np.dot(law.roll, [v[1], fourth[1]]), np.dot(law.pitch, [v[0], fourth[0]])
    return PAPER.inertia_roll * roll, PAPER.inertia_pitch * pitch


def thrust(s: State) -> float:
    """Return the thrust (23), N, with g_z of (18) corrected and f_z of (19) for ϑ̂_z."""
    axis, share = np.array(thrust_axis(Vec3(*s.euler))), PAPER.bob_mass / PAPER.total_mass
    gain = (axis[2] - share * (axis @ s.direction) * s.direction[2]) / PAPER.quadrotor_mass
    drift = share * PAPER.rod_length * (s.direction_rate @ s.direction_rate) * s.direction[2] - PAPER.gravity
    return float((-VERTICAL @ [s.position[2] - TARGET[2], s.velocity[2]] - drift) / gain)


def simulate(law: Laws) -> tuple[float, Floats]:
    """Return the seconds until the pendulum is tilted by 60°, at most 6, and the final error of F_x, F_y, z (m)."""
    array = np.zeros((1, STATE_SIZE))
    s = State(array[0])
    s.direction[2] = 1.0
    s.position[:] = 0.05, -0.05, 2.05
    physics, calm = PAPER.as_array()[np.newaxis], np.zeros((1, DISTURBANCE_SIZE))
    for step in range(round(SECONDS / PERIOD)):
        yaw = -PAPER.inertia_yaw * (VERTICAL @ [s.euler[2], s.euler_rate[2]])  # (16)
        advance(array, np.array([[thrust(s), *torques(law, s), yaw]]), calm, physics, PERIOD, 1)
        if not s.direction[2] > 0.5:
            return (step + 1) * PERIOD, np.full(3, np.inf)
    return SECONDS, s.position + PAPER.rod_length * s.direction * [1.0, 1.0, 0.0] - TARGET


def test_corrected_laws_converge() -> None:
    assert np.linalg.norm(simulate(Laws())[1]) < 1e-10


@pytest.mark.parametrize("equations", PRINTED)
def test_printed_laws_fall(equations: str) -> None:
    law, seconds = PRINTED[equations]
    assert simulate(law)[0] == pytest.approx(seconds, rel=0.05)
