"""The vector environment on an NVIDIA GPU: its arrays live on the device and leave it by DLPack without a copy.

`import quadpend_gym` does not import this subpackage. It needs the extra ``gpu``, or numba's CUDA simulator:
``NUMBA_ENABLE_CUDASIM=1`` in the environment before numba is imported.
"""

from quadpend_gym.gpu.vector_env import DeviceVectorEnv

__all__ = ["DeviceVectorEnv"]
