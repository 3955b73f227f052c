"""Layout of the step outcome, the array that `step_kernel` writes and the environments read.

The outcome has one column for each sub-environment. Vectors are in the world frame.

| name           | symbol          | rows  | unit   | content                                                         |
|----------------|-----------------|-------|--------|-----------------------------------------------------------------|
| TRACKING_TERM  |                 | 0     | 1      | reward term (1) of `quadpend_gym.tasks.rewards`                 |
| UPRIGHT_TERM   |                 | 1     | 1      | reward term (2)                                                 |
| YAW_TERM       |                 | 2     | 1      | reward term (3)                                                 |
| EFFORT_TERM    |                 | 3     | 1      | reward term (4)                                                 |
| TRACKING_ERROR | e               | 4–6   | m      | error of the flat outputs                                       |
| TILT           | α               | 7     | rad    | angle of the pendulum from its side, by default from upright    |
| REWARD         |                 | 8     | 1      | weighted mean of the terms                                      |
| TERMINATED     |                 | 9     | 1      | cause of an early end, a place in `CAUSES`, else 0              |
| DISTURBANCE    | d_Q, d_B, d_τ   | 10–18 | N, N·m | forces and torque in the step, drag and mean of hand included   |
| AIR_VELOCITY   | v               | 19–21 | m/s    | velocity of the air                                             |
| PARAMETERS     |                 | 22–30 | SI     | physical parameters, in the order of `Parameters`               |
| COMMAND        | u, τφ, τθ, τψ   | 31–34 | N, N·m | mean thrust and torques during the step                         |
| LOOP           |                 | 35–38 | s, 1   | drawn constants of the loop, which `World` writes               |

An outcome array may have fewer rows; `step_kernel` writes the rows that exist.
"""

from typing import Any

from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import COMMAND_SIZE, DISTURBANCE_SIZE
from quadpend_gym.randomization import LOOP_NAMES
from quadpend_gym.vehicles.parameters import PARAMETERS_SIZE

TRACKING_TERM, UPRIGHT_TERM, YAW_TERM, EFFORT_TERM = range(4)
TRACKING_ERROR = slice(EFFORT_TERM + 1, EFFORT_TERM + 4)
TILT, REWARD, TERMINATED = range(TRACKING_ERROR.stop, TRACKING_ERROR.stop + 3)
# What ends an episode early, see `quadpend_gym.tasks.Limits`.
CAUSES = ("none", "tilt of the pole", "tilt of the body", "distance", "ground", "diverged")
POLE, BODY, DISTANCE, GROUND, DIVERGED = 1.0, 2.0, 3.0, 4.0, 5.0
DISTURBANCE = slice(TERMINATED + 1, TERMINATED + 1 + DISTURBANCE_SIZE)
AIR_VELOCITY = slice(DISTURBANCE.stop, DISTURBANCE.stop + 3)
PARAMETERS = slice(AIR_VELOCITY.stop, AIR_VELOCITY.stop + PARAMETERS_SIZE)
COMMAND = slice(PARAMETERS.stop, PARAMETERS.stop + COMMAND_SIZE)
OUTCOME_SIZE = COMMAND.stop  # without LOOP
LOOP = slice(OUTCOME_SIZE, OUTCOME_SIZE + len(LOOP_NAMES))
SCALARS = slice(0, DISTURBANCE.start)  # rows that `StepInfo.read` needs as scalars, REWARD and TERMINATED included


class StepInfo:
    """The fields of `info`, and how many rows of the outcome they need.

    Every info has these fields. Sensors do not change them: they are computed from the true state.

    - ``tracking_error``: error of the flat outputs in the world frame, m.
    - ``tilt``: angle α of the pendulum from its side, by default from upright, rad.
    - ``disturbance``: force on the quadrotor, force on the bob (N, world frame) and torque (N·m) during the step.
    - ``reward_terms``: the four terms of the reward by name.
    - ``cause``: what ended the episode early, a place in `CAUSES`; 0 if it goes on or was truncated.

    Args:
        air_velocity: Whether the info has ``air_velocity``, the velocity of the air, m/s, world frame.
        command: Whether the info has ``command``, mean thrust (N) and torques (N·m) of the step.
        parameters: Whether the info has ``parameters``, the physical parameters in the order of `PARAMETER_NAMES`.
        loop: Whether the info has ``loop``, drawn values in the order of `LOOP_NAMES`: the latency in s, and factors.
    """

    def __init__(self, air_velocity: bool, command: bool, parameters: bool, loop: bool) -> None:
        optional = {"air_velocity": AIR_VELOCITY, "command": COMMAND, "parameters": PARAMETERS, "loop": LOOP}
        included = air_velocity, command, parameters, loop
        self._optional = [item for item, wanted in zip(optional.items(), included, strict=True) if wanted]
        self.outcome_size: int = max((rows.stop for _, rows in self._optional), default=DISTURBANCE.stop)

    def read(self, outcome: Floats, scalars: Any) -> dict[str, Any]:
        """Return the info of one sub-environment or of many.

        Args:
            outcome: The outcome of a step, shape (k,) or (k, n). Array fields of the info have shape (m,) or (m, n).
            scalars: The rows `SCALARS` of the outcome, as an array or a list; scalar fields are taken from it.
        """
        info = {
            "tracking_error": outcome[TRACKING_ERROR],
            "tilt": scalars[TILT],
            "disturbance": outcome[DISTURBANCE],
            "cause": scalars[TERMINATED],
            "reward_terms": {
                "tracking": scalars[TRACKING_TERM],
                "upright": scalars[UPRIGHT_TERM],
                "yaw": scalars[YAW_TERM],
                "effort": scalars[EFFORT_TERM],
            },
        }
        for name, rows in self._optional:
            info[name] = outcome[rows]
        return info
