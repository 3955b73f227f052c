"""What the linear models of scenarios tell, where python-control and CasADi are installed.

They give the margins of the loops of policies, and the references of errors in the ranking: what is possible.
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
from typing import Any

from gymnasium import logger

from quadpend_baselines import Policy
from quadpend_gym.actuators import GyroBias
from quadpend_gym.scenarios import Scenario
from quadpend_gym.sensors import Noise
from quadpend_gym.tasks.task import TASKS
from quadpend_gym.wind import OrnsteinUhlenbeck
from quadpend_train.evaluation.metrics import Cell

BREEZE = 0.02224  # share of the weight: 0.12 N for the vehicle of the flight benchmark
_INSTALLED = bool(find_spec("control") and find_spec("casadi"))


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
    for name, scenario in scenarios.items() if _INSTALLED else ():
        with suppress(ValueError):
            found[name] = reference(scenario)[0]
    return found


def loop_margins(learners: Mapping[str, list[Policy]], scenarios: Mapping[str, Scenario]) -> dict[Cell, Any]:
    """Return the `Margins` of policies with a linear model by scenario and policy, and warn about unstable loops.

    Those of a learner are of its first training seed. They are computed once for scenarios with the same loop.
    """
    if not _INSTALLED:
        return {}
    from quadpend_baselines.modelling.linear_loop import is_slower, linear_policy, margins, vehicle_model

    scenarios = {  # those with a linear model, which an autopilot's rate loop does not have
        name: scenario for name, scenario in scenarios.items() if not (is_slower(scenario) or scenario.autopilot)
    }
    vehicles: dict[str, Any] = {}
    loops: dict[tuple[str, str], Any] = {}
    for scenario in scenarios.values():
        key = _loop(scenario)
        vehicles[key] = vehicles.get(key) or vehicle_model(scenario)
        for name, (policy, *_) in learners.items():
            if (key, name) in loops:
                continue
            adapted, model = policy.adapt(scenario), None
            with suppress(Exception):  # own code may raise exceptions of any type; the episodes report it
                model = linear_policy(adapted, scenario)
            loops[key, name] = found = model and margins(vehicles[key], model)
            if found and found.spectral_radius >= 1.0:
                factor = found.spectral_radius ** (1.0 / scenario.period)
                text = "%s is unstable on %s: small deviations from hover grow by a factor of %.3g each second"
                logger.warn(text, name, scenario.vehicle.name, factor)
    cells = {(scenario, name): loops[_loop(scenarios[scenario]), name] for scenario in scenarios for name in learners}
    return {cell: found for cell, found in cells.items() if found}


def _loop(scenario: Scenario) -> str:
    """Return a text that is the same for scenarios with the same linear loop."""
    delays = scenario.sensors, scenario.actuators, scenario.observation, scenario.loop_known
    return repr((scenario.simulation, scenario.task.side, scenario.task.pendulum, *delays))
