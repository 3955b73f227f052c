"""The margins of the linear loops of policies, where python-control and CasADi are installed."""

from collections.abc import Mapping
from contextlib import suppress
from importlib.util import find_spec
from typing import Any

from gymnasium import logger

from quadpend_baselines import Policy
from quadpend_gym.scenarios import Scenario
from quadpend_train.evaluation.table import Cell


def loop_margins(learners: Mapping[str, list[Policy]], scenarios: Mapping[str, Scenario]) -> dict[Cell, Any]:
    """Return the `Margins` of policies with a linear model by scenario and policy, and warn about unstable loops.

    Those of a learner are of its first training seed. They are computed once for scenarios with the same loop.
    """
    if not (find_spec("control") and find_spec("casadi")):
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
