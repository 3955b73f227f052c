"""Random scenarios, drawn from the whole declared ranges and from their ends."""

from contextlib import suppress
from typing import Any, get_args

import numpy as np

from quadpend_gym import Limits, ReferenceSettings, RewardWeights, StartSettings
from quadpend_gym.actuators import KINDS as ACTUATORS
from quadpend_gym.core.settings import Range, declared
from quadpend_gym.scenarios import Scenario
from quadpend_gym.sensors import KINDS as SENSORS
from quadpend_gym.tasks.task import TASKS
from quadpend_gym.vehicles import VEHICLES
from quadpend_gym.wind import KINDS as WINDS

TASK_PARTS = {"references": ReferenceSettings, "start": StartSettings, "limits": Limits, "reward": RewardWeights}
INTERFACES = ("wrench", "rotors", "body_rates")
_TRIALS = 1000


def draw(bounds: Range, random: np.random.Generator) -> float:
    """Return an end of a range, or a number between: uniform, or of a uniform logarithm."""
    low, high = float(bounds.low), float(bounds.high)
    kind = random.integers(4)
    if kind == 0:
        return float(random.choice((low, high)))
    if kind == 1 or low < 0.0:
        return float(random.uniform(low, high))
    return float(np.clip(np.exp(random.uniform(np.log(max(low, 1e-6)), np.log(max(high, 1e-6)))), low, high))


def random_values(kind: Any, random: np.random.Generator, share: float = 0.3) -> dict[str, Any]:
    """Return random values for a share of the fields of a settings class that declare a range."""
    values: dict[str, Any] = {}
    for name, hint, bounds in declared(kind):
        numbers = [item for item in get_args(hint) if item in (float, int)]
        if random.random() < share:
            drawn = sorted(draw(bounds, random) for _ in numbers or [None])
            values[name] = tuple(drawn) if len(numbers) > 1 else int(drawn[0]) if hint is int else drawn[0]
    return values


def random_model(kinds: dict[str, Any], random: np.random.Generator) -> dict[str, Any]:
    """Return a random kind of wind, sensor or actuator with random settings, as a mapping."""
    kind = sorted(kinds)[random.integers(len(kinds))]
    return {"kind": kind, **random_values(kinds[kind], random)}


def random_scenario(random: np.random.Generator) -> Scenario:
    """Return a random scenario, usual or extreme. Settings that are refused are drawn again."""
    for _ in range(_TRIALS):
        task = {name: random_values(part, random) for name, part in TASK_PARTS.items() if random.random() < 0.3}
        parts: dict[str, Any] = {
            "task": task or list(TASKS)[random.integers(len(TASKS))],
            "wind": random_model(WINDS, random),
            "vehicle": list(VEHICLES)[random.integers(len(VEHICLES))],
            "interface": str(random.choice(INTERFACES)),
            "sensors": [random_model(SENSORS, random)],
            "actuators": [random_model(ACTUATORS, random)],
            "period": float(random.choice((0.002, 0.005, 0.02, 0.1))),
            "substeps": int(random.integers(1, 11)),
            "duration": float(random.uniform(0.1, 20.0)),
        }
        kept = {name: part for name, part in parts.items() if random.random() < 0.6}
        with suppress(ValueError):
            return Scenario(**kept)
    raise AssertionError("no settings were accepted")
