"""Wrappers for non-ideal conditions and for other observations.

Each wrapper exists for a single environment and, with the prefix ``Vector``, for a vector environment.

| wrapper                 | effect                                                   | models                       |
|-------------------------|----------------------------------------------------------|------------------------------|
| `WindWrapper`           | adds forces, torques and moving air                      | `quadpend_gym.wind`          |
| `SensorWrapper`         | adds noise, delay and dropout to the measured state      | `quadpend_gym.sensors`       |
| `ActuatorWrapper`       | adds rotors, lag, delay, rate limits and faults          | `quadpend_gym.actuators`     |
| `ParameterWrapper`      | draws the physical parameters of each episode            | `quadpend_gym.randomization` |
| `OutputFeedbackWrapper` | removes the velocities from the observation              |                              |
| `HistoryWrapper`        | stacks the latest observations and actions               |                              |

The specification of a single environment contains its wrappers and can be converted to JSON with them. The
specification of a vector environment contains no wrappers, as with Gymnasium's own vector wrappers, but it contains the
wind that the environment was made with.
"""

from quadpend_gym.wrappers.observation import (
    HistoryWrapper,
    OutputFeedbackWrapper,
    VectorHistoryWrapper,
    VectorOutputFeedbackWrapper,
)
from quadpend_gym.wrappers.world import (
    ActuatorWrapper,
    ParameterWrapper,
    SensorWrapper,
    VectorActuatorWrapper,
    VectorParameterWrapper,
    VectorSensorWrapper,
    VectorWindWrapper,
    WindWrapper,
)

__all__ = [
    "ActuatorWrapper",
    "HistoryWrapper",
    "OutputFeedbackWrapper",
    "ParameterWrapper",
    "SensorWrapper",
    "VectorActuatorWrapper",
    "VectorHistoryWrapper",
    "VectorOutputFeedbackWrapper",
    "VectorParameterWrapper",
    "VectorSensorWrapper",
    "VectorWindWrapper",
    "WindWrapper",
]
