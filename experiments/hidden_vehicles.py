"""From one log to a policy that is better for it: hidden vehicles in simulated reality.

    python -m experiments.hidden_vehicles              # 20 vehicles: docs/identification/hidden.csv

A hidden vehicle has mass, geometry and pole of the start file, the preset `hummingbird`. It has its own drags, inertia,
centre of mass, lag of the rotors, rate loop and latency, and thrusts that fall with the voltage of the battery. In the
log, a controller of the start file flies the manoeuvre of `simulated_logs` for 60 s, without the pole, through this
loop, with steps of the commanded rates; motors are means over a row. `quadpend identify` makes the vehicle file, and
with `--loop` the latency and the rate loop. Then `lqg` flies the hidden vehicle in the same held-out episodes, designed
for the start file, for the vehicle file with the loop of the start, for the vehicle file with its own loop, and for the
truth. Each believes a thrust curve, by which it turns thrusts into throttles; that of the start knows no voltage.
"""

import argparse
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from experiments.pages import DOCS
from experiments.simulated_logs import DURATION, Noise, manoeuvre, turn_error
from quadpend_baselines import controller
from quadpend_gym.physics.plants import RigidPlant
from quadpend_gym.physics.rigid_kernel import BODY_RATE, QUATERNION, ROTOR_THRUST
from quadpend_gym.physics.state import STATE_SIZE, State
from quadpend_gym.randomization import LoopRanges
from quadpend_gym.scenarios import Scenario, find_scenario
from quadpend_gym.vehicles import VEHICLES, Simulation, Vehicle, rotors_of
from quadpend_gym.vehicles.vehicle import as_vehicle
from quadpend_train.evaluation.episodes import run_episodes
from quadpend_train.flight_logs.identify import identify
from quadpend_train.flight_logs.log import NOMINAL, Columns, make_log
from quadpend_train.flight_logs.loop import loop_of
from quadpend_train.flight_logs.replay import Thrust, without_pole
from quadpend_train.flight_logs.vehicle_file import write_vehicle

PATH = DOCS / "identification/hidden.csv"
START, LATENCY, CURVE = VEHICLES["hummingbird"], 0.02, Thrust(6.0)
COLUMNS = Columns(velocity=("vx", "vy", "vz"), rate=("wx", "wy", "wz"), motor_unit="1", voltage="vbat")
NAMES = "time exposure x y z qw qx qy qz vx vy vz wx wy wz rate_x rate_y motor1 motor2 motor3 motor4 vbat"
SCENARIOS = (  # held out
    *("flight_windy", "flight_dryden_medium", "flight_gusts", "flight_circle", "flight_waypoints"),
    *("event_jump", "event_dropouts", "event_wind_step", "event_turning", "event_start"),
)
POLICIES = ("start", "file, loop of the start", "file", "truth")
LATENCIES, TIME_CONSTANTS = (0.01, 0.03), (0.013, 0.03)  # s, of the hidden loops; 0.02 of both in the start
FULL, DRAINED, EMPTY, SAG = 4.1, 3.8, 3.5, 0.15  # V of a cell: before and after the log, least, and less in hover
_PERIOD, _SUBSTEPS = 0.01, 4  # s, of control
_STEP = _PERIOD / _SUBSTEPS
_STEPS, _STEP_SIZE = (1.7, 2.3), 0.4  # Hz, rad/s: of steps of the commanded rates about x and y, for the rate loop


@dataclass(frozen=True)
class Loop:
    """What a policy believes, or what is true: the vehicle, the latency (s), and the thrust of a rotor by throttle."""

    vehicle: Vehicle
    latency: float
    curve: Thrust

    def thrust(self, throttle: Any, voltage: Any) -> Any:
        """Return the thrust of a rotor at a throttle and a voltage (V), N."""
        return self.curve.coefficient * self.curve.relative(throttle, voltage / NOMINAL)

    def throttle(self, thrust: Any, voltage: Any) -> Any:
        """Return the throttle for the thrust of a rotor, N."""
        share, linear = np.maximum(thrust, 0.0) / self.thrust(1.0, voltage), self.curve.linear
        return 2.0 * share / (linear + np.sqrt(linear**2 + 4.0 * (1.0 - linear) * share) + 1e-12)

    def scenario(self, name: str) -> Scenario:
        """Return a scenario with this vehicle and latency."""
        return replace(find_scenario(name), vehicle=self.vehicle, latency=_STEP * round(self.latency / _STEP))


def hidden_loop(seed: int) -> Loop:
    """Return a hidden vehicle and its loop."""
    random, rotors = np.random.default_rng((seed, 53)), rotors_of(START)

    def factor(most: float) -> float:
        return float(most ** random.uniform(-1.0, 1.0))

    roll, pitch, yaw = np.diag(START.inertia_matrix).tolist()
    inertia = roll * factor(1.4), pitch * factor(1.4)
    centre = 0.005 * np.append(random.uniform(-1.0, 1.0, 2), 0.0)
    positions: Any = tuple(map(tuple, np.array(rotors.positions) - centre))
    drag: Any = tuple(each * factor(1.5) for each in START.drag.rotor)
    low, high = TIME_CONSTANTS
    vehicle = replace(
        START,
        name="hidden",
        inertia=(*inertia, sum(inertia) * yaw / (roll + pitch)),
        rotors=replace(
            rotors,
            positions=positions,
            lag_up=rotors.lag_up * factor(1.6),
            torque_per_thrust=rotors.torque_per_thrust * factor(1.3),
        ),
        drag=replace(START.drag, rotor=drag, height=0.02 * factor(3.0)),
        rate_loop=replace(START.rate_loop, time_constant=low * (high / low) ** random.uniform()),
    )
    curve = Thrust(CURVE.coefficient * factor(1.1), 0.3 * random.uniform(), random.uniform(1.0, 2.0))
    return Loop(vehicle, random.uniform(*LATENCIES), curve)


def flown_log(true: Loop, believed: Loop, seed: int) -> pd.DataFrame:
    """Return the log of a flight without the pole, with columns of `quadpend fly` (the loop) and of `identify`."""
    random, noise, vehicle = np.random.default_rng((seed, 1)), Noise(), without_pole(true.vehicle)
    simulation = Simulation(vehicle=vehicle, interface="body_rates", period=_STEP, substeps=1)
    plant, scale, parameters = RigidPlant(simulation), simulation.command_scale, simulation.parameters.as_array()[None]
    state, disturbance, rows, missed = np.zeros((1, STATE_SIZE)), np.zeros((1, 9)), list[Any](), np.zeros(3)
    view = State(state)
    view.direction[:, 2] = 1.0
    view.velocity[:] = manoeuvre(0.0)[1]
    memory, decay = plant.initial_memory(state), np.exp(-_STEP / rotors_of(vehicle).lag_up)
    pending, weight = [np.zeros(4)] * round(true.latency / _STEP), np.array([0.0, 0.0, vehicle.gravity])
    for time in _PERIOD * np.arange(round(DURATION / _PERIOD)):
        p, v, a, yaw = manoeuvre(time)
        position = view.position[0] + noise.position * random.standard_normal(3)
        turn = Rotation.from_rotvec(0.001 * random.standard_normal(3))
        rotation = Rotation.from_quat(memory[0, QUATERNION:BODY_RATE], scalar_first=True) * turn
        missed += _PERIOD * (p - position)
        lift = vehicle.mass * (a + weight + 2.5 * (p - position) + 2.5 * (v - view.velocity[0]) + missed)
        steps = [*(_STEP_SIZE * np.sign(np.sin(2.0 * np.pi * np.array(_STEPS) * time))), 0.0]
        rates = 7.0 * turn_error(rotation.as_matrix(), lift, yaw) * [1.0, 1.0, 3.0] + steps
        voltage = FULL + (DRAINED - FULL) * time / DURATION - SAG * memory[0, ROTOR_THRUST:].sum() / vehicle.weight
        throttle = believed.throttle(0.25 * float(lift @ rotation.as_matrix()[:, 2]), voltage)
        command = np.append(4.0 * true.thrust(throttle, voltage) - scale[0], rates) / scale
        pending += [np.clip(command, -1.0, 1.0)] * _SUBSTEPS
        gyro = memory[0, BODY_RATE:ROTOR_THRUST] + noise.rate * random.standard_normal(3)
        row = [time, time, *position, *rotation.as_quat(scalar_first=True), *view.velocity[0], *gyro, *rates[:2]]
        squares = np.zeros(4)
        for _ in range(_SUBSTEPS):
            before = memory[0, ROTOR_THRUST:].copy()
            plant.advance(state, memory, pending.pop(0)[np.newaxis], disturbance, parameters)
            wanted = (memory[0, ROTOR_THRUST:] - decay * before) / (1.0 - decay)
            squares += true.throttle(wanted, voltage) ** 2 / _SUBSTEPS
        motors = np.sqrt(squares) * (1.0 + noise.motors * random.standard_normal(4))
        rows.append([*row, *motors, voltage])
    return pd.DataFrame(rows, columns=NAMES.split()).assign(stage="FLY")


def from_log(table: pd.DataFrame, start: Vehicle, path: Path) -> Loop:
    """Return what `quadpend identify`, and the same with `--loop`, say after a log; `path`: the vehicle file."""
    found = identify([make_log("flight", table, COLUMNS)], start, training=1.0)
    write_vehicle(found, start, path)
    vehicle = as_vehicle(path)
    loop = loop_of(table, rotors_of(vehicle).lag_up)
    vehicle = replace(vehicle, rate_loop=replace(vehicle.rate_loop, time_constant=loop.time_constant))
    return Loop(vehicle, loop.latency, found.thrust)


def flights(seed: int, episodes: int) -> pd.DataFrame:
    """Return one row for each policy: its loop, survival, and error as a multiple of that with the truth."""
    true, start = hidden_loop(seed), Loop(START, LATENCY, CURVE)
    with TemporaryDirectory() as folder:
        found = from_log(flown_log(true, start, seed), START, Path(folder) / "mine.toml")
    constant = max(START.rate_loop.time_constant, 0.5 * rotors_of(found.vehicle).lag_up)
    plain = replace(found.vehicle, rate_loop=replace(START.rate_loop, time_constant=constant))
    loops = dict(zip(POLICIES, (start, replace(found, vehicle=plain, latency=LATENCY), found, true), strict=True))
    policy, errors, survival = controller("lqg"), dict[str, Any](), dict[str, float]()
    for name, known in loops.items():
        hover, ends = 0.25 * START.weight, np.array([EMPTY, FULL]) - SAG
        thrust = np.sort(true.thrust(known.throttle(hover, ends), ends) / hover)
        flown = [
            run_episodes(
                [policy],
                replace(true.scenario(each), loop=LoopRanges(thrust=tuple(thrust.tolist()))),
                episodes,
                known=known.scenario(each),
            )
            for each in SCENARIOS
        ]
        errors[name] = np.log([each.penalised_rmse.mean() for each in flown])
        survival[name] = float(np.mean([each.survived.mean() for each in flown]))
    rows = [
        {
            "vehicle": seed,
            "policy": name,
            "latency": known.latency,
            "rate_loop": known.vehicle.rate_loop.time_constant,
            "survival": survival[name],
            "error": float(np.exp((errors[name] - errors["truth"]).mean())),
        }
        for name, known in loops.items()
    ]
    return pd.DataFrame(rows)


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Return for each policy the survival, the multiple of the error, and how much less excess than the start it has.

    Intervals are those of 95 %, from a bootstrap over vehicles, in which all policies of a vehicle stay together.
    """
    logs = np.log(table.pivot(index="vehicle", columns="policy", values="error")[list(POLICIES)].to_numpy())
    drawn = np.random.default_rng(0).integers(len(logs), size=(10_000, len(logs)))
    samples = np.exp(np.concatenate([logs.mean(axis=0)[None], logs[drawn].mean(axis=1)]))
    falls = 1.0 - (samples - 1.0) / (samples[:, :1] - 1.0)

    def shown(values: Any) -> str:
        low, high = np.quantile(values[1:], [0.025, 0.975])
        return f"{values[0]:.3f} [{low:.3f}, {high:.3f}]"

    survival = table.groupby("policy").survival.mean()
    rows = [(name, survival[name], shown(samples[:, i]), shown(falls[:, i])) for i, name in enumerate(POLICIES)]
    return pd.DataFrame(rows, columns=["policy", "survival", "error", "fall of the excess"])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicles", type=int, default=20, help="number of vehicles")
    parser.add_argument("--episodes", type=int, default=10, help="episodes in each scenario")
    given = parser.parse_args()
    parts = list[pd.DataFrame]()
    for seed in range(given.vehicles):
        parts.append(flights(seed, given.episodes))
        print(parts[-1].to_string(header=not seed, index=False), flush=True)
    found = pd.concat(parts)
    found.to_csv(PATH, index=False, float_format="%.5g")
    print(summary(found).to_string(index=False))
