"""The printed control laws let the pendulum fall in the nonlinear simulation, and the corrected ones converge.

The laws (16), (23), (51) and (52) use the true derivatives at 1 kHz, in calm air and with the gains of Section 5, so
that only the control laws determine the result. The start is 5 cm from the hover position in x and in y.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest

from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.kernel import advance
from quadpend_gym.physics.state import DISTURBANCE_SIZE, STATE_SIZE, State
from quadpend_gym.vehicles import PAPER

PERIOD, SECONDS = 1e-3, 6.0
K = PAPER.chain_stiffness
GK = PAPER.gravity * K
HORIZONTAL = np.polynomial.polynomial.polypow([7.0**2, 2 * 0.9 * 7.0, 1.0], 3)[:-1]  # k₀ … k₅
VERTICAL = np.array([10.0**2, 2 * 0.9 * 10.0])


@dataclass(frozen=True)
class TorqueLaws:
    """A variant of (51) and (52): the signs of v and of F⁽⁴⁾ in each torque, and the meaning of the angles.

    Attributes:
        pitch: Signs in τθ = pitch₀ (I/gK) v + pitch₁ (I/g) F_x⁽⁴⁾.
        roll: Signs in τφ, likewise.
        fourth_y: Returns F_y⁽⁴⁾/(gK) from r_y and φ.
        tilt: Returns the angles of F_x and F_y and their rates from r and ṙ.
    """

    pitch: tuple[float, float] = (-1.0, 1.0)
    roll: tuple[float, float] = (1.0, -1.0)
    fourth_y: Callable[[float, float], float] = field(default=lambda tilt, roll: tilt + roll)
    tilt: Callable[[Floats, Floats], tuple[Floats, Floats]] = field(default=lambda r, r_dot: (r[:2], r_dot[:2]))


def spherical(r: Floats, r_dot: Floats) -> tuple[Floats, Floats]:
    """Return the single α of (30) and (31) and its rate for both axes."""
    alpha = np.hypot(r[0], r[1])
    rate = (r[0] * r_dot[0] + r[1] * r_dot[1]) / max(alpha, 1e-12)
    return np.full(2, alpha), np.full(2, rate)


CORRECTED = TorqueLaws()
PRINTED = {  # with the seconds until the pendulum is tilted by 60°
    "(51)": (TorqueLaws(pitch=(1.0, 1.0)), 0.30),
    "(52)": (TorqueLaws(roll=(-1.0, 1.0)), 0.33),
    "(51) and (52)": (TorqueLaws(pitch=(1.0, 1.0), roll=(-1.0, 1.0)), 0.20),
    "(43), (44) and (52)": (TorqueLaws(roll=(-1.0, 1.0), fourth_y=lambda tilt, roll: roll - tilt), 0.46),
    "(43) and (44)": (TorqueLaws(fourth_y=lambda tilt, roll: roll - tilt), 1.44),
    "(30) and (31)": (TorqueLaws(tilt=spherical), 0.46),
}


def torques(law: TorqueLaws, s: State, target: Floats) -> tuple[float, float]:
    """Return τφ and τθ (N·m), with F⁽ⁱ⁾ from (32)–(37) and (39)–(44)."""
    tilt, tilt_rate = law.tilt(s.direction, s.direction_rate)
    attitude = np.array([-s.euler[1], law.fourth_y(0.0, s.euler[0])])
    attitude_rate = np.array([-s.euler_rate[1], law.fourth_y(0.0, s.euler_rate[0])])
    sign = np.array([1.0, law.fourth_y(1.0, 0.0)])
    chain = [
        s.position[:2] + PAPER.rod_length * tilt - target[:2],
        s.velocity[:2] + PAPER.rod_length * tilt_rate,
        PAPER.gravity * tilt,
        PAPER.gravity * tilt_rate,
        GK * (sign * tilt + attitude),
        GK * (sign * tilt_rate + attitude_rate),
    ]
    v = -sum(k * derivative for k, derivative in zip(HORIZONTAL, chain, strict=True))
    pitch = law.pitch[0] * v[0] / GK + law.pitch[1] * chain[4][0] / PAPER.gravity
    roll = law.roll[0] * v[1] / GK + law.roll[1] * chain[4][1] / PAPER.gravity
    return PAPER.inertia_roll * roll, PAPER.inertia_pitch * pitch


def thrust(s: State, target: Floats) -> float:
    """Return the thrust (23), N, with g_z of (18) corrected and f_z of (19) for ϑ̂_z."""
    roll, pitch, yaw = s.euler
    axis = np.array(
        [
            np.cos(yaw) * np.sin(pitch) * np.cos(roll) + np.sin(yaw) * np.sin(roll),
            np.sin(yaw) * np.sin(pitch) * np.cos(roll) - np.cos(yaw) * np.sin(roll),
            np.cos(pitch) * np.cos(roll),
        ]
    )
    share = PAPER.bob_mass / PAPER.total_mass
    gain = (axis[2] - share * (axis @ s.direction) * s.direction[2]) / PAPER.quadrotor_mass
    drift = share * PAPER.rod_length * (s.direction_rate @ s.direction_rate) * s.direction[2] - PAPER.gravity
    demanded = -VERTICAL[0] * (s.position[2] - target[2]) - VERTICAL[1] * s.velocity[2]
    return float((demanded - drift) / gain)


def simulate(law: TorqueLaws) -> tuple[float, float]:
    """Return the seconds until the pendulum is tilted by 60°, at most 6, and the final error of F_x, F_y, z (m)."""
    array = np.zeros((1, STATE_SIZE))
    s = State(array[0])
    s.direction[2] = 1.0
    s.position[:] = 0.05, -0.05, 2.05
    target = np.array([0.0, 0.0, 2.0])
    physics, calm = PAPER.as_array()[np.newaxis], np.zeros((1, DISTURBANCE_SIZE))
    for step in range(round(SECONDS / PERIOD)):
        roll, pitch = torques(law, s, target)
        yaw = -PAPER.inertia_yaw * (VERTICAL @ [s.euler[2], s.euler_rate[2]])  # (16)
        advance(array, np.array([[thrust(s, target), roll, pitch, yaw]]), calm, physics, PERIOD, 1)
        if not s.direction[2] > 0.5:
            return (step + 1) * PERIOD, np.inf
    flat = np.append(s.position[:2] + PAPER.rod_length * s.direction[:2], s.position[2])
    return SECONDS, float(np.linalg.norm(flat - target))


def test_corrected_laws_converge() -> None:
    duration, error = simulate(CORRECTED)
    assert duration == SECONDS
    assert error < 1e-10


@pytest.mark.parametrize("equations", PRINTED)
def test_printed_laws_fall(equations: str) -> None:
    """All other equations are corrected."""
    law, seconds = PRINTED[equations]
    duration, _ = simulate(law)
    assert duration == pytest.approx(seconds, rel=0.05)
