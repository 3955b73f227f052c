"""Random settings of environments, drawn from the whole declared ranges and from their ends."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any, get_args, get_type_hints

import numpy as np

from quadpend_gym import (
    Actuators,
    Constant,
    Limits,
    Parameters,
    QuadPendulumVectorEnv,
    ReferenceSettings,
    RewardWeights,
    Simulation,
    Sinusoids,
    StartSettings,
    Task,
    Waypoints,
)
from quadpend_gym.actuators import KINDS as ACTUATORS
from quadpend_gym.core.settings import Range, declared
from quadpend_gym.physics.parameters import CONTROL_PERIOD, INTERFACES, MOST_DELAYED
from quadpend_gym.physics.state import STATE_FIELDS
from quadpend_gym.randomization import Around
from quadpend_gym.sensors import KINDS as SENSORS
from quadpend_gym.sensors import Channel, Noise
from quadpend_gym.tasks.trajectories import SHORTEST_INTERVAL, SinusoidTerm
from quadpend_gym.vehicles import VEHICLES, Vehicle
from quadpend_gym.wind import KINDS as WINDS
from tests.helpers import rigid
from tests.helpers.envs import ENDLESS
from tests.helpers.wrappers import STACKS, Layers, wrapped

TASK_PARTS = {"references": ReferenceSettings, "start": StartSettings, "limits": Limits, "reward": RewardWeights}
SIMULATION_PARTS: dict[str, Any] = {"parameters": Parameters, "actuators": Actuators}
NEEDED = {"drawn": {"wind": Constant()}, "rescaled": {"wind": Constant()}, "rotor_fault": {}}  # fields without default
VEHICLE_PARTS = ("pole", "drag", "rate_loop", "rotors")
WIND_PRESETS = ("breeze", "windy", "storm")
_TRIALS = 20
_MOST_SUBSTEPS = 10  # of a vector environment, so that a step of thousands of rows is fast

Draw = Callable[[Range], float]


def ranges_of(kind: Any) -> dict[str, Range]:
    """Return the declared ranges of the fields of a settings class by name."""
    return {name: bounds for name, _, bounds in declared(kind)}


def value_of(kind: Any, name: str, draw: Draw) -> Any:
    """Return a value of a field, made of numbers that `draw` returns: a number, or a pair in order."""
    bounds, hint = ranges_of(kind)[name], get_type_hints(kind)[name]
    if get_args(hint) == (float, float):
        return tuple(sorted((draw(bounds), draw(bounds))))
    return int(draw(bounds)) if hint is int else draw(bounds)


def random_draw(random: np.random.Generator) -> Draw:
    """Return a function that draws an end of a range, or a number between: uniform, or of a uniform logarithm."""

    def draw(bounds: Range) -> float:
        choice = random.integers(4)
        if choice < 2:
            return (bounds.low, bounds.high)[choice]
        if choice == 2 and bounds.low > 0.0:
            drawn = float(np.exp(random.uniform(np.log(bounds.low), np.log(bounds.high))))
            return min(max(drawn, bounds.low), bounds.high)
        return float(random.uniform(bounds.low, bounds.high))

    return draw


def random_values(kind: Any, random: np.random.Generator, share: float = 0.5) -> dict[str, Any]:
    """Return values of about this share of the fields."""
    draw = random_draw(random)
    return {name: value_of(kind, name, draw) for name in ranges_of(kind) if random.random() < share}


def random_task(random: np.random.Generator) -> Task:
    """Return a task with random settings; half of the tasks end only at the limits of the simulation."""
    task = Task(**{name: kind(**random_values(kind, random)) for name, kind in TASK_PARTS.items()})
    task = replace(task, trajectory=random_trajectory(random)) if random.random() < 0.2 else task
    return replace(task, limits=ENDLESS.limits) if random.random() < 0.5 else task


def random_simulation(random: np.random.Generator, most_substeps: int = 10_000) -> dict[str, Any]:
    """Return random settings of a simulation as a mapping, of the paper's vehicle or of a real one."""
    parts = {name: random_values(kind, random) for name, kind in SIMULATION_PARTS.items()}
    values = random_values(Simulation, random) | parts
    values["substeps"] = min(values.get("substeps", 2), most_substeps)
    values["latency"] = 0.0
    vehicle = random_vehicle(random) if random.random() < 0.5 else None
    if vehicle is not None and vehicle.attitude == "rigid":
        values["vehicle"], values["interface"] = vehicle, INTERFACES[random.integers(len(INTERFACES))]
        if random.random() < 0.5:
            step = values.get("period", CONTROL_PERIOD) / values["substeps"]
            longest = min(1.0, MOST_DELAYED * values["substeps"] * step)
            values["latency"] = step * int(random.uniform(0.0, longest / step))
    return values


def random_vehicle(random: np.random.Generator) -> Any:
    """Return a real vehicle, or a random one of similar size; of most, some numbers are from the declared ranges."""
    vehicle = VEHICLES[sorted(VEHICLES)[random.integers(len(VEHICLES))]]
    if random.random() < 0.5:
        vehicle = rigid.random_vehicle(int(random.integers(2**32)), bool(random.random() < 0.7))
    for _ in range(_TRIALS if vehicle.attitude == "rigid" else 0):
        with suppress(ValueError):  # the numbers do not fit together
            return replace(vehicle, **_changed_fields(vehicle, random))
    return vehicle


def _changed_fields(vehicle: Vehicle, random: np.random.Generator) -> dict[str, Any]:
    """Return other values of about one number in each of half of the parts."""
    draw = random_draw(random)

    def change(instance: Any) -> Any:
        names = [name for name in ranges_of(type(instance)) if name not in ("positions", "torque")]
        name = names[random.integers(len(names))]
        return {name: value_of(type(instance), name, draw)}

    parts = {name: part for name in VEHICLE_PARTS if (part := getattr(vehicle, name)) is not None}
    changed = {name: replace(part, **change(part)) for name, part in parts.items() if random.random() < 0.4}
    changed |= change(vehicle) if random.random() < 0.4 else {}
    if random.random() < 0.3:
        bounds = ranges_of(Vehicle)["torque"]
        changed["torque"] = draw(bounds), draw(bounds)
    return changed


def random_trajectory(random: np.random.Generator) -> Waypoints | Sinusoids:
    """Return waypoints or a sum of sinusoids with random numbers."""
    if random.random() < 0.5:
        terms = [SinusoidTerm(**random_values(SinusoidTerm, random)) for _ in range(random.integers(1, 6))]
        return Sinusoids(**random_values(Sinusoids, random), terms=tuple(terms))
    number = int(random.integers(2, 12))
    longest = random.choice((2.0 * SHORTEST_INTERVAL, 1.0, 80.0))
    times = np.cumsum([0.0, *random.uniform(max(SHORTEST_INTERVAL, longest / 900.0), longest, number - 1)])
    points = random.uniform(-1.0, 1.0, (number, 4)) * random.choice((0.01, 3.0, 1000.0))
    closed = bool(random.random() < 0.5)
    points[-1] = points[0] if closed else points[-1]
    return Waypoints(tuple(times.tolist()), tuple(map(tuple, points.tolist())), closed)


def random_wind(random: np.random.Generator) -> dict[str, Any]:
    """Return a random kind of wind with random settings as a mapping."""
    kind = sorted(WINDS)[random.integers(len(WINDS))]
    return {"kind": kind, **NEEDED.get(kind, {}), **random_values(WINDS[kind], random)}


def random_sensor(random: np.random.Generator) -> Any:
    """Return a random kind of sensor error with random settings."""
    kind = SENSORS[sorted(SENSORS)[random.integers(len(SENSORS))]]
    if kind is Noise:
        return Noise(**{name: Channel(**random_values(Channel, random)) for name in STATE_FIELDS})
    return kind(**random_values(kind, random))


def random_actuator(random: np.random.Generator) -> Any:
    """Return a random kind of actuator error with random settings."""
    kind = ACTUATORS[sorted(ACTUATORS)[random.integers(len(ACTUATORS))]]
    return kind(**random_values(kind, random))


def extreme_env(random: np.random.Generator, make: Callable[..., Any], most_substeps: int = 10_000) -> Any:
    """Return an environment with settings from the whole declared ranges, half of the time with wrappers.

    Args:
        random: Random numbers.
        make: Makes the environment from ``task``, ``simulation`` and ``wind``.
        most_substeps: Largest number of substeps.

    Raises:
        TypeError: If the settings do not fit together.
        ValueError: If the settings contradict each other.
    """
    task, simulation = random_task(random), random_simulation(random, most_substeps)
    layers: Layers = [("SensorWrapper", random_sensor(random))] if random.random() < 0.5 else []
    layers += [("ActuatorWrapper", random_actuator(random))] if random.random() < 0.5 else []
    layers += [("ParameterWrapper", Around(**random_values(Around, random, 1.0)))] if random.random() < 0.2 else []
    return wrapped(make(task=task, simulation=simulation, wind=random_wind(random)), layers)


def extreme_vector_env(random: np.random.Generator, rows: int) -> Any:
    """Return a vector environment with settings from the whole declared ranges, see `extreme_env`."""
    length = int(random.integers(1, 2000))
    make = partial(QuadPendulumVectorEnv, rows, autoreset_mode="SameStep", max_episode_steps=length)
    return extreme_env(random, make, _MOST_SUBSTEPS)


def usual_vector_env(random: np.random.Generator, rows: int) -> Any:
    """Return a vector environment as users make it: a task, wind, sometimes a real vehicle, sometimes wrappers."""

    def choose(values: Any) -> Any:
        return list(values)[random.integers(len(values))]

    rigid = random.random() < 0.5
    return wrapped(
        QuadPendulumVectorEnv(
            rows,
            task=choose(("track", "hover")),
            wind=choose((None, *WIND_PRESETS)),
            autoreset_mode=choose(("NextStep", "SameStep")),
            max_episode_steps=choose((50, 200, 1000)),
            **({"vehicle": choose(VEHICLES), "interface": choose(INTERFACES)} if rigid else {}),
        ),
        [] if rigid else choose([[], *STACKS.values()]),
    )
