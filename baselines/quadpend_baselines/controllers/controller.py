"""The base class of the classical controllers: designed for a nominal simulation and the known part of its loop."""

from quadpend_baselines.controllers.hanging import Hanging, mirror_simulation
from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.policy.protocol import Policy
from quadpend_baselines.policy.rotors import allocate_rotors
from quadpend_gym import Simulation
from quadpend_gym.scenarios import Scenario


class Controller(Policy):
    """A classical controller of thrust and torques.

    Attributes:
        simulation: Nominal plant, torque limits and control period for which the controller is designed.
        flies_load: Whether the controller, designed for a mirrored simulation, also flies a hanging pendulum.
    """

    simulation: Simulation
    flies_load: bool = False

    def designed_for(self, simulation: Simulation, loop: Loop | None = None) -> "Controller":
        """Return the same controller, designed for another nominal simulation and loop; None: a loop without delays."""
        raise NotImplementedError

    def adapt(self, scenario: Scenario) -> Policy:
        """Return the controller designed for a scenario, its known loop, a hanging pendulum and rotors."""
        simulation, loop = scenario.simulation, Loop.known(scenario)
        if scenario.task.pendulum != "hanging":
            return allocate_rotors(self.designed_for(simulation, loop), scenario)
        if not self.flies_load:
            raise ValueError("of the classical controllers, only flatness, lqr, lqi, dual-mode and mppi fly a load")
        return allocate_rotors(Hanging(self.designed_for(mirror_simulation(simulation), loop)), scenario)
