"""Random inputs of a control step, for all plants, interfaces and latencies."""

import numpy as np

from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.plants import plant_of
from quadpend_gym.physics.rigid_kernel import RIGID_SIZE, ROTOR_THRUST
from quadpend_gym.physics.state import ACTION_SIZE, State
from quadpend_gym.tasks.references import REFERENCE_SIZE
from quadpend_gym.wind import WIND_FIELDS, WIND_SIZE
from tests.helpers.physics import random_states

SIMULATIONS = {
    "paper": Simulation(),
    "paper, latency": Simulation(latency=0.015),
    **{interface: Simulation("hummingbird", interface) for interface in ("wrench", "rotors", "body_rates")},
    "latency": Simulation("hummingbird", "body_rates", latency=0.015),
    "longer latency": Simulation("hummingbird", "wrench", latency=0.02, substeps=1),
}


class Inputs:
    """Random inputs of a control step for n rows."""

    def __init__(self, simulation: Simulation, rows: int) -> None:
        rng = np.random.default_rng(0)
        self.state = random_states(rows, 0)
        # At a pitch of ±π/2 the Euler-angle rates are ill-conditioned.
        State(self.state).euler[:, 1] = rng.uniform(-1.2, 1.2, rows)
        vehicle = plant_of(simulation).initial_memory(self.state)
        vehicle[:, ROTOR_THRUST:RIGID_SIZE] *= rng.uniform(0.6, 1.4, (rows, min(4, vehicle.shape[1])))
        periods = -(-simulation.delayed_substeps // simulation.substeps)
        under_way = rng.uniform(-1.0, 1.0, (rows, ACTION_SIZE * periods)).astype(np.float32)
        self.memory = np.hstack([vehicle, under_way])
        self.action = rng.uniform(-1.0, 1.0, (rows, 4)).astype(np.float32)
        self.wind = rng.normal(size=(rows, WIND_SIZE))
        self.wind[:, WIND_FIELDS["torque"]] *= 0.01
        self.parameters = simulation.parameters.as_array() * rng.uniform(0.9, 1.1, (rows, 9))
        self.reference = rng.normal(size=(rows, REFERENCE_SIZE))

    def of_step(self) -> tuple[Floats, ...]:
        """The arguments of the step function."""
        return self.state, self.memory, self.action, self.wind, self.parameters
