"""Wrappers that bring the real world: each for a single environment and, as ``Vector…``, for a vector of them.

| wrapper                 | what it brings                                    | models                        |
|-------------------------|---------------------------------------------------|-------------------------------|
| `WindWrapper`           | forces, torques, moving air                       | `quadpend_gym.wind`           |
| `SensorWrapper`         | noise, delay, dropout                             | `quadpend_gym.sensors`        |
| `ActuatorWrapper`       | rotors, lag, delay, rate limits, faults           | `quadpend_gym.actuators`      |
| `ParameterWrapper`      | other physical parameters in each episode         | `quadpend_gym.randomization`  |
| `OutputFeedbackWrapper` | no velocities                                     |                               |
| `HistoryWrapper`        | the latest observations and actions side by side  |                               |

The specification of a single environment holds its wrappers, and goes to JSON with them. That of a vector environment
holds no wrappers (Gymnasium's neither), only the wind that it was made with.
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
