"""The inputs of networks, which `quadpend_baselines.hybrid` computes, as CasADi's expressions."""

from functools import partial
from types import SimpleNamespace
from typing import Any

from quadpend_baselines.estimation.estimate import MASS_RATIO, Estimate
from quadpend_baselines.hybrid.deviations import deviation_inputs
from quadpend_baselines.hybrid.innovations import TIMES, filter_shares, innovation_inputs
from quadpend_baselines.hybrid.memory import memory_inputs, memory_numbers
from quadpend_gym import Simulation
from quadpend_gym.engines import columns, lift, vector
from quadpend_gym.physics.plants import plant_of
from quadpend_gym.physics.state import TORQUE


def innovations_of(memory: Any, filtered: Any, period: float) -> Any:
    """Return `innovation_inputs` of an estimate, a (field, lane) buffer, as a vector."""
    shares = filter_shares(period, TIMES)
    return vector(lift(innovation_inputs)(Estimate(memory.T), columns(filtered).T, shares))


def remembered_of(observed: Any, action: Any, remembered: Any, period: float) -> tuple[Any, Any]:
    """Return `memory_inputs`, and the memory, of an observation without velocities, as vectors."""
    rows = (columns(item).T for item in (observed, action, remembered))
    found = lift(memory_inputs)(*rows, (False,), memory_numbers(period))
    return vector(found[0]), vector(found[1])


def nominal_estimate(later: Any, has_mass: bool) -> Estimate:
    """Return a predicted estimate, a (field, lane) buffer, with the forces on the nominal vehicle."""
    nominal = Estimate(later.T.copy())
    if has_mass:
        forces = nominal.disturbance[0, :TORQUE]
        forces[:] = [force / later[MASS_RATIO, 0] for force in forces]
    return nominal


def deviations_of(law: Any, later: Any, has_mass: bool) -> Any:
    """Return `deviation_inputs` of a predicted estimate, a (field, lane) buffer, as a vector."""
    return vector(lift(deviation_inputs, {plant_of: lifted_plant})(law, nominal_estimate(later, has_mass)))


def lifted_plant(simulation: Simulation) -> Any:
    """Return the plant of a simulation for functions that CasADi reads."""
    plant: Any = plant_of(simulation)
    return SimpleNamespace(actions_for=partial(lift(type(plant).actions_for), plant))
