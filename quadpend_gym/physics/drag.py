"""Aerodynamic drag of the quadrotor and the bob, computed from the wind velocity.

    (1)  d_Q = ½ ρ A_Q |v − ζ̇| (v − ζ̇)                      on the quadrotor
    (2)  d_B = ½ ρ A_B |v − ζ̇ − l ṙ| (v − ζ̇ − l ṙ)          on the bob
    (3)  d_R = R D Rᵀ (v − ζ̇)                               of the rotors of rigid vehicles

| symbol   | meaning                   | unit  | default                                                              |
|----------|---------------------------|-------|----------------------------------------------------------------------|
| ρ        | air density               | kg/m³ | 1.225: ISO standard atmosphere at sea level                          |
| A_Q      | drag area C_d A           | m²    | 0.01: a body of about 10 cm × 10 cm with C_d = 1                     |
| A_B      | drag area C_d A           | m²    | 0.0005: a steel ball of 0.2 kg, 36 mm in diameter, with C_d = 0.47   |
| v        | wind velocity, world      | m/s   |                                                                      |
| ζ̇        | velocity of the quadrotor | m/s   |                                                                      |
| l        | length of the rod         | m     |                                                                      |
| ṙ        | rate of the direction     | 1/s   |                                                                      |
| D        | drag of the rotors        | N·s/m | diagonal, in the axes of the body                                    |
| R        | rotation                  |       | from the axes of the body to the world                               |

The plant computes (1) and (2) at the beginning of a control period, and (3) at the beginning of a substep; until the
next one the forces are constant. The quadrotor has the same drag area in all directions. A pole has one drag area; the
velocity that its pivot has by the rotation of the body is neglected. Vehicles without a rigid body have no drag if no
wind model sets a wind velocity, as in the paper's calm simulations; the model `StillAir` adds the drag of air at rest.
Rigid vehicles always have drag.
"""

from typing import Any

from quadpend_gym.core.jit import inlined
from quadpend_gym.physics.attitude import Rotation, to_body, to_world
from quadpend_gym.physics.dynamics import load_physics
from quadpend_gym.physics.state import BOB_FORCE, DIRECTION_RATE, FORCE, VELOCITY
from quadpend_gym.physics.vectors import Vec3, add, axpy, load, norm, scale, store

AIR_DENSITY = 1.225  # kg/m³


@inlined
def drag_force(area: float, relative: Vec3) -> Vec3:
    """Return the drag ½ ρ A |v| v in N, for a drag area A in m² and a relative air velocity v in m/s."""
    return scale(0.5 * AIR_DENSITY * area * norm(relative), relative)


@inlined
def rotor_drag_force(drag: Vec3, rotation: Rotation, relative: Vec3) -> Vec3:
    """Return equation (3) in N, for the diagonal of D and a relative air velocity in m/s."""
    body = to_body(rotation, relative)
    return to_world(rotation, Vec3(drag.x * body.x, drag.y * body.y, drag.z * body.z))


@inlined
def add_drag(wind: Vec3, state: Any, parameters: Any, lane: int, out: Any) -> None:
    """Add the drag of equations (1) and (2) to a disturbance, column `lane` of a (9, n) buffer; `wind` is v."""
    physics = load_physics(parameters, lane)
    on_quadrotor = axpy(-1.0, load(state, VELOCITY, lane), wind)
    on_bob = axpy(-physics.rod_length, load(state, DIRECTION_RATE, lane), on_quadrotor)
    quadrotor_force = drag_force(physics.quadrotor_drag_area, on_quadrotor)
    store(out, FORCE, lane, add(load(out, FORCE, lane), quadrotor_force))
    store(out, BOB_FORCE, lane, add(load(out, BOB_FORCE, lane), drag_force(physics.bob_drag_area, on_bob)))
