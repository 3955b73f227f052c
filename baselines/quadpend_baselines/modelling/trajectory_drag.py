"""The drag of a vehicle that follows a reference, as Taylor series.

That of the pole acts on its centre of mass, whose velocity is v_B = Ḟ_d. That of the body is quadratic; the rotors add
a linear one, which depends on the thrust axis b:

    (1)  d_B = −k_B |v_B| v_B
    (2)  d_Q = −(k_Q |v_Q| + c) v_Q − (c_z − c) (b · v_Q) b,      v_Q = Ḟ_d − l ṡ,   s = (F̈_d − d_B/m)/g
    (3)  b = (t, 1)/√(1 + |t|²),                                  t = s − s̈/K + (M/m d_B − d_Q)/((M + m) g)

M, m and l are those of the vehicle, K is that of `equivalent`, k_Q and k_B are ρ/2 times the drag areas of body and
pole, c and c_z the coefficients of the rotors across and along b. In (3), d_Q is without its last term. Of |v| the
first derivative is taken into account. s and t are those of F_d in place of F, without vertical acceleration and height
of the pivot. But for these, d_Q is right to order 2, and d_B to order 4.

`equivalent` takes orders 3 and 4 of d_Q too, although they lack terms: with zeros in their place, `lqg` follows circles
of the hummingbird slightly worse, and figure eights alike.
"""

import numpy as np

from quadpend_baselines.modelling.quantities import Derivatives, Forces
from quadpend_baselines.modelling.taylor import (
    Series,
    Triple,
    derivative,
    from_derivatives,
    plus,
    product,
    quotient,
    shift,
    times,
)
from quadpend_gym.core.jit import inlined
from quadpend_gym.physics.vectors import Vec3
from quadpend_gym.vehicles import Parameters

_STILL = 1e-3  # m/s, below which the rate of |v| is less


@inlined
def no_drag() -> tuple[Triple, Triple]:
    """Return the drag of a law that takes it for a disturbance."""
    zero = Series(0.0, 0.0, 0.0, 0.0, 0.0)
    return Triple(zero, zero, zero), Triple(zero, zero, zero)


@inlined
def trajectory_drag(reference: Derivatives, p: Parameters, stiffness: float) -> tuple[Triple, Triple]:
    """Return d_Q and d_B of equations (1) and (2), N, for the parameters of the vehicle and K (1/s²)."""
    d1, d2, d3, d4, d5, d6 = reference.d1, reference.d2, reference.d3, reference.d4, reference.d5, reference.d6
    across, along_axis, of_body, of_bob = reference.drag
    bob = Triple(
        from_derivatives(d1.x, d2.x, d3.x, d4.x, d5.x),
        from_derivatives(d1.y, d2.y, d3.y, d4.y, d5.y),
        from_derivatives(d1.z, d2.z, d3.z, d4.z, d5.z),
    )
    on_bob = _resisted(times(of_bob, _speed(bob)), bob)
    s_x = _lean(from_derivatives(d2.x, d3.x, d4.x, d5.x, d6.x), on_bob.x, p)
    s_y = _lean(from_derivatives(d2.y, d3.y, d4.y, d5.y, d6.y), on_bob.y, p)
    body = Triple(
        plus(bob.x, times(-p.rod_length, derivative(s_x))), plus(bob.y, times(-p.rod_length, derivative(s_y))), bob.z
    )
    on_body = _resisted(shift(across, times(of_body, _speed(body))), body)
    x, y = _tilt(s_x, on_body.x, on_bob.x, p, stiffness), _tilt(s_y, on_body.y, on_bob.y, p, stiffness)
    along = plus(plus(product(x, body.x), product(y, body.y)), body.z)
    along = times(across - along_axis, quotient(along, shift(1.0, plus(product(x, x), product(y, y)))))
    on_body = Triple(plus(on_body.x, product(along, x)), plus(on_body.y, product(along, y)), plus(on_body.z, along))
    return on_body, on_bob


@inlined
def _speed(velocity: Triple) -> Series:
    """Return |v| and its rate."""
    x, y, z = velocity
    speed = np.sqrt(x.a * x.a + y.a * y.a + z.a * z.a)
    return Series(speed, (x.a * x.b + y.a * y.b + z.a * z.b) / max(speed, _STILL), 0.0, 0.0, 0.0)


@inlined
def _resisted(coefficient: Series, velocity: Triple) -> Triple:
    against = times(-1.0, coefficient)
    return Triple(product(against, velocity.x), product(against, velocity.y), product(against, velocity.z))


@inlined
def _lean(acceleration: Series, on_bob: Series, p: Parameters) -> Series:
    """Return s of an axis, equation (2)."""
    return times(1.0 / p.gravity, plus(acceleration, times(-1.0 / p.bob_mass, on_bob)))


@inlined
def _tilt(s: Series, on_body: Series, on_bob: Series, p: Parameters, stiffness: float) -> Series:
    """Return t of an axis, equation (3)."""
    relative = plus(times(p.quadrotor_mass / p.bob_mass, on_bob), times(-1.0, on_body))
    bent = times(-1.0 / stiffness, derivative(derivative(s)))
    return plus(plus(s, bent), times(1.0 / ((p.quadrotor_mass + p.bob_mass) * p.gravity), relative))


@inlined
def plus_constant(forces: tuple[Triple, Triple], constant: Forces) -> tuple[Triple, Triple]:
    """Return forces on quadrotor and bob plus constant ones, N."""
    (body, bob), force, bob_force = forces, constant.force, constant.bob_force
    return (
        Triple(shift(force.x, body.x), shift(force.y, body.y), shift(force.z, body.z)),
        Triple(shift(bob_force.x, bob.x), shift(bob_force.y, bob.y), shift(bob_force.z, bob.z)),
    )


@inlined
def forces_now(forces: tuple[Triple, Triple], constant: Forces) -> Forces:
    """Return the present forces of series of those on quadrotor and bob, N, and the torque of the constant ones."""
    body, bob = forces
    return Forces(Vec3(body.x.a, body.y.a, body.z.a), Vec3(bob.x.a, bob.y.a, bob.z.a), constant.torque)
