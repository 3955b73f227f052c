"""docs/one-policy/tables.md: a public policy of other authors on our vehicles in the X layout, without a pole.

    pip install foundation-policy                # it is in the extra `peers`
    python -m experiments.foundation_policy      # 100 episodes in each scenario, seed 1000000

RAPTOR (Eschmann, Albani and Loianno, 2025, MIT license) commands four rotors at 100 Hz, without the parameters of its
vehicle. The pole hangs, is 0.1 m long and weighs 0.01 g. Episodes of 10 s start up to 0.5 m and 0.5 m/s from hover on
each axis, with Euler angles of up to 0.5 rad; the error counts in their second half. A command u in [-1, 1] stands for
the squared speed ((u + 1)/2)² between the lowest and the highest thrust of a rotor.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from scipy.spatial.transform import Rotation

from experiments.pages import DOCS, fill, made_by, options
from experiments.vehicles import WIND_SHARE
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.plants import plant_of
from quadpend_gym.physics.rigid_kernel import BODY_RATE, QUATERNION
from quadpend_gym.physics.state import State
from quadpend_gym.scenarios import Scenario
from quadpend_gym.tasks.references import ReferenceSettings
from quadpend_gym.tasks.task import TASKS, Limits
from quadpend_gym.vehicles import VEHICLES, Pole, Simulation, Vehicle, hover_thrusts, rotors_of
from quadpend_gym.wind import OrnsteinUhlenbeck
from quadpend_train.evaluation.formatting import markdown_table
from quadpend_train.flights.replay import rotor_actions

PLACE = np.array([0.0, 0.0, 2.0])  # m
CORNERS = (1, -1), (-1, -1), (-1, 1), (1, 1)  # the policy's order: front right, back right, back left, front left
X_LAYOUT = ("crazyflie", "crazyflie-brushless", "crazyflie-brushless-2", "skydio-x2", "racer", "x500")


def scenario(vehicle: Vehicle, is_windy: bool) -> Scenario:
    """Return hover of a vehicle that practically has no pole."""
    hover = ReferenceSettings(circle=0.0, figure_eight=0.0, helix=0.0, height=(2.0, 2.0))
    limits = Limits(pendulum_angle=np.pi, body_angle=np.pi, ground=-50.0)
    wind = (OrnsteinUhlenbeck(force=WIND_SHARE * vehicle.weight / np.sqrt(3.0)),) if is_windy else ()
    task = replace(TASKS["load"], limits=limits, references=hover)
    return Scenario(vehicle=vehicle, interface="rotors", task=task, wind=wind, substeps=8)


def observation(simulation: Simulation, states: Floats, last: Floats) -> Floats:
    """Return what the policy observes: position, rotation matrix, velocity, body rates and its last action, (n, 22)."""
    state, rigid = State(states), plant_of(simulation).initial_memory(states)
    quaternion, rates = rigid[:, QUATERNION : QUATERNION + 4], rigid[:, BODY_RATE : BODY_RATE + 3]
    rotation = Rotation.from_quat(quaternion, scalar_first=True).as_matrix().reshape(-1, 9)
    return np.column_stack([state.position - PLACE, rotation, state.velocity, rates, last]).astype(np.float32)


def fly(policy: Any, vehicle: Vehicle, is_windy: bool, episodes: int, seed: int) -> tuple[float, float]:
    """Return survival (%) and the root mean square of the error of the survivors (mm)."""
    env: Any = scenario(vehicle, is_windy).make_vec(episodes, AutoresetMode.SAME_STEP)
    random, rows = np.random.default_rng(seed), (episodes, 3)
    start = {"position": PLACE + random.uniform(-0.5, 0.5, rows), "velocity": random.uniform(-0.5, 0.5, rows)}
    start |= {"euler": random.uniform(-0.5, 0.5, rows), "direction": np.tile([0.0, 0.0, -1.0], (episodes, 1))}
    none = dict.fromkeys(("euler_rate", "direction_rate"), np.zeros(rows))
    env.reset(seed=seed, options={"state": start | none})
    world = env.unwrapped.world
    hover, (low, high) = hover_thrusts(vehicle), rotors_of(vehicle).thrust
    x, y, _ = np.array(rotors_of(vehicle).positions).T
    order = [int(np.argmax(i * x + j * y)) for i, j in CORNERS]
    alive, last, errors = np.ones(episodes, np.bool_), np.zeros((episodes, 4)), []
    policy.reset()
    for _ in range(999):  # the last step of an episode begins the next one
        last = np.clip(policy.evaluate_step(observation(world.simulation, world.state, last)), -1.0, 1.0)
        thrust = np.empty_like(last)
        thrust[:, order] = low + (high - low) * (0.5 * (last + 1.0)) ** 2
        action = rotor_actions(thrust, hover, (low, high))
        _, _, fell, _, _ = env.step(np.clip(action, -1.0, 1.0).astype(np.float32))
        alive &= ~fell
        errors.append(np.linalg.norm(State(world.state).position - PLACE, axis=1))
    return 100.0 * float(alive.mean()), 1e3 * float(np.sqrt(np.mean(np.array(errors)[500:, alive] ** 2)))


def main() -> None:
    """Fly, and fill the table."""
    from foundation_policy import Raptor

    given, rows, policy = options(__doc__, episodes=100), [], Raptor()
    for name in X_LAYOUT:
        vehicle = replace(VEHICLES[name], pole=Pole(mass=1e-5, length=0.05), pivot=(0.0, 0.0, 0.0))
        found = [fly(policy, vehicle, is_windy, given.episodes, given.seed) for is_windy in (False, True)]
        rows.append([name, *(f"{survival:.4g} %, {error:.3g} mm" for survival, error in found)])
    table = markdown_table(["vehicle", "calm", "wind"], rows)
    line = made_by("foundation_policy", given.episodes, given.seed)
    fill(DOCS / "one-policy/tables.md", {"raptor": f"{line}\n\n{table}"})


if __name__ == "__main__":
    main()
