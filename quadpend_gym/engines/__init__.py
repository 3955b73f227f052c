"""The equations of the environments for other engines: CasADi's functions, their derivatives, and generated C.

The only source is the scalar functions that numba compiles. `lifting` reads them into CasADi's expressions,
`functions` makes functions of them, and `generated_c` compiles functions for batches of rows. Install CasADi with
``pip install 'quadpend-gym[mpc]'``.
"""

from importlib.util import find_spec

if find_spec("casadi") is None:
    raise ImportError("quadpend_gym.engines needs CasADi: pip install 'quadpend-gym[mpc]'")

from quadpend_gym.engines.functions import (
    initial_memory,
    observation_function,
    reference_function,
    step_function,
)
from quadpend_gym.engines.generated_c import CompiledFunction
from quadpend_gym.engines.lifting import columns, lift, vector
from quadpend_gym.engines.scalar_c import scalar_c

__all__ = [
    "CompiledFunction",
    "columns",
    "initial_memory",
    "lift",
    "observation_function",
    "reference_function",
    "scalar_c",
    "step_function",
    "vector",
]
