"""Layout of the outcome of a control step: the arrays that `step_kernel` writes and the environments read."""

from itertools import accumulate

from quadpend_gym.physics.parameters import PARAMETERS_SIZE
from quadpend_gym.physics.state import COMMAND_SIZE, DISTURBANCE_SIZE, STATE_SIZE
from quadpend_gym.tasks.observation import (
    TARGET_SIZE,
)

# Rows of the outcome of a step, of which it has as many as are asked for: the four reward terms, the tracking error and
# so on, and what acted.
_ROWS = (4, 3, 1, 1, 1, DISTURBANCE_SIZE, 3, PARAMETERS_SIZE, COMMAND_SIZE)


_, TRACKING_ERROR, TILT, REWARD, TERMINATED, DISTURBANCE, AIR_VELOCITY, PARAMETERS, COMMAND, OUTCOME_SIZE = (
    0,
    *accumulate(_ROWS),
)


# What sensors see: the target and the rod's length, which a tracking error is made of, and from here on the state.
SEEN_STATE = TARGET_SIZE + 1


SENSED_SIZE = SEEN_STATE + STATE_SIZE
