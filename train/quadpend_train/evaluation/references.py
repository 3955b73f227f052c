"""The references of errors in the ranking: what is possible in the linear model of each scenario.

`linear_reference` applies to hover in Gaussian wind with white noise. Any other scenario has the reference of the
nearest one to which it applies: without biases and losses, with the nominal vehicle and loop, at hover, and in a
fluctuating force of `BREEZE` of the weight if its wind is not Gaussian. So the multiples of all scenarios have one
scale. Those of such a scenario may be below 1.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from importlib.util import find_spec

from quadpend_gym.actuators import GyroBias
from quadpend_gym.scenarios import Scenario
from quadpend_gym.sensors import Noise
from quadpend_gym.tasks.task import TASKS
from quadpend_gym.wind import OrnsteinUhlenbeck

BREEZE = 0.02224  # share of the weight: 0.12 N for the vehicle of the flight benchmark


def _white(model: Noise) -> Noise:
    channels = ("position", "velocity", "euler", "euler_rate", "direction", "direction_rate")
    return Noise(**{name: getattr(model, name).white for name in channels})


@lru_cache(maxsize=64)
def reference(scenario: Scenario) -> tuple[float, bool]:
    """Return the linear reference of a scenario or of the nearest one, m, and whether it is its own but for biases.

    The extras `mpc` and `control` are needed. A scenario whose sensors or vehicle have no linear model is a ValueError.
    """
    from quadpend_baselines.modelling.linear_reference import linear_reference

    sensors = [_white(model) if isinstance(model, Noise) else model for model in scenario.sensors]
    actuators = [model for model in scenario.actuators if not isinstance(model, GyroBias)]
    unbiased = replace(scenario, wind_rise=0.0, sensors=sensors, actuators=actuators)
    nominal = replace(unbiased, task=TASKS["hover"], actuators=(), parameters=None, loop=None)
    for linear in (unbiased, nominal):
        with suppress(ValueError):  # it does not apply
            return linear_reference(linear), linear is unbiased
    breeze = OrnsteinUhlenbeck(force=BREEZE * scenario.vehicle.weight)
    return linear_reference(replace(nominal, wind=breeze)), False


def references(scenarios: Mapping[str, Scenario]) -> dict[str, float]:
    """Return the references of scenarios, m, where there are any and python-control and CasADi are installed."""
    found = {}
    for name, scenario in scenarios.items() if find_spec("control") and find_spec("casadi") else ():
        with suppress(ValueError):
            found[name] = reference(scenario)[0]
    return found
