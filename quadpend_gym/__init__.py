"""A spherical inverted pendulum balanced on a quadrotor in the wind, as Gymnasium environments.

    import gymnasium as gym
    import quadpend_gym

    env = gym.make("QuadPendulum-v0")

The import registers the environments `QuadPendulum-v0`, `QuadPendulumHover-v0`, `QuadPendulumSwingUp-v0`,
`QuadPendulumLoad-v0` and `QuadPendulumRecovery-v0`. A line ``gym.register_envs(quadpend_gym)`` after it has no effect,
but linters then do not report an unused import. The id ``"quadpend_gym:QuadPendulum-v0"`` needs no import, for example
in worker processes and on command lines.
`QuadPendulumEnv` describes action, observation, reward and episode.
"""

import gymnasium as gym

from quadpend_gym.envs.env import QuadPendulumEnv
from quadpend_gym.envs.vector_env import QuadPendulumVectorEnv
from quadpend_gym.physics.state import Disturbance, State
from quadpend_gym.scenarios.scenario import Scenario
from quadpend_gym.tasks.observation import OBSERVATION_FIELDS, read_observation
from quadpend_gym.tasks.references import ReferenceSettings
from quadpend_gym.tasks.starts import StartSettings
from quadpend_gym.tasks.task import ENVIRONMENTS, Limits, RewardWeights, Task
from quadpend_gym.tasks.trajectories import Reference, Waypoints
from quadpend_gym.vehicles import PAPER, Parameters, Simulation
from quadpend_gym.wind import (
    Constant,
    Drawn,
    Dryden,
    Gusts,
    Hold,
    OrnsteinUhlenbeck,
    PaperGusts,
    Rescaled,
    Sinusoid,
    Step,
    StillAir,
)

__version__ = "0.4.0"
__all__ = [
    "OBSERVATION_FIELDS",
    "PAPER",
    "Constant",
    "Disturbance",
    "Drawn",
    "Dryden",
    "Gusts",
    "Hold",
    "Limits",
    "OrnsteinUhlenbeck",
    "PaperGusts",
    "Parameters",
    "QuadPendulumEnv",
    "QuadPendulumVectorEnv",
    "Reference",
    "ReferenceSettings",
    "Rescaled",
    "RewardWeights",
    "Scenario",
    "Simulation",
    "Sinusoid",
    "StartSettings",
    "State",
    "Step",
    "StillAir",
    "Task",
    "Waypoints",
    "read_observation",
]


for _name, _task in ENVIRONMENTS.items():
    gym.register(
        id=_name,
        entry_point="quadpend_gym.envs.env:QuadPendulumEnv",
        vector_entry_point="quadpend_gym.device:make_vector_env",
        kwargs={} if _task == "track" else {"own_task": _task},
    )
