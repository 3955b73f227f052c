"""Names of `quadpend_gym.vehicles`."""

from quadpend_gym.vehicles import CONTROL_PERIOD as CONTROL_PERIOD
from quadpend_gym.vehicles import INTERFACES as INTERFACES
from quadpend_gym.vehicles import PAPER as PAPER
from quadpend_gym.vehicles import PARAMETER_NAMES as PARAMETER_NAMES
from quadpend_gym.vehicles import Parameters as Parameters
from quadpend_gym.vehicles import Simulation as Simulation
from quadpend_gym.vehicles.parameters import BOB_DRAG_AREA as BOB_DRAG_AREA
from quadpend_gym.vehicles.parameters import BOB_MASS as BOB_MASS
from quadpend_gym.vehicles.parameters import PARAMETERS_SIZE as PARAMETERS_SIZE
from quadpend_gym.vehicles.parameters import QUADROTOR_DRAG_AREA as QUADROTOR_DRAG_AREA
from quadpend_gym.vehicles.parameters import QUADROTOR_MASS as QUADROTOR_MASS
from quadpend_gym.vehicles.parameters import ROD_LENGTH as ROD_LENGTH
from quadpend_gym.vehicles.vehicle import scaled_inertia as scaled_inertia
