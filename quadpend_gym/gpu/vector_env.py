"""The vector environment whose arrays live on an NVIDIA GPU."""

from collections.abc import Callable
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np
from gymnasium.error import DependencyNotInstalled, ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numba import cuda

from quadpend_gym.core.streams import Streams
from quadpend_gym.envs.kernel_layout import (
    MEMORY_PARAMETERS,
    MEMORY_SIZE,
    MEMORY_STATE,
    RIGID_MEMORY_SIZE,
    make_settings,
    pack_rigid_settings,
    pack_settings,
)
from quadpend_gym.envs.spaces import action_space, check_options, observation_space
from quadpend_gym.envs.vector_env import QuadPendulumVectorEnv
from quadpend_gym.envs.world import World
from quadpend_gym.gpu.device_functions import SIMULATED
from quadpend_gym.gpu.kernels import NO_ROW, make_kernels
from quadpend_gym.gpu.rows import EpisodeSettings
from quadpend_gym.physics.rigid_settings import hover_thrusts_of
from quadpend_gym.physics.state import ACTION_SIZE
from quadpend_gym.tasks import EPISODE_STEPS, flatten
from quadpend_gym.tasks.observation import OBSERVATION_SIZE
from quadpend_gym.tasks.references import REFERENCE_SIZE, Reference
from quadpend_gym.tasks.starts import start_pole
from quadpend_gym.wind import Constant, StillAir, as_wind

_THREADS = 128  # of a block
_METADATA = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}


class _Outputs(NamedTuple):
    """What a step writes: observations, last observations, rewards, and (terminated, truncated, either)."""

    observation: Any
    final: Any
    reward: Any
    ended: Any


class DeviceVectorEnv(VectorEnv[Any, Any, Any]):
    """As `QuadPendulumVectorEnv` with same-step autoreset, with all arrays on the device.

    A sub-environment with seed s has the same episodes as a `QuadPendulumEnv` with seed s, up to the rounding of the
    device. The method `step` launches one kernel on CUDA's default stream and does not wait for it. It returns arrays
    that other libraries read by DLPack without a copy; they keep their values until the step after the next one.

    Not available on the device are sensors, actuators, random parameters, waypoints and sums of sinusoids, latencies of
    one control period or more, and winds other than `Constant` and `StillAir`.

    Args:
        num_envs: Number of sub-environments.
        task: As in `QuadPendulumEnv`; a trajectory must be a `Reference`.
        simulation: As in `QuadPendulumEnv`.
        wind: As in `QuadPendulumEnv`; only `Constant` and `StillAir`.
        max_episode_steps: Control steps after which an episode is truncated, or None for no truncation.
        vehicle: As in `QuadPendulumEnv`.
        interface: As in `QuadPendulumEnv`.
        from_dlpack: Function that converts the arrays once, such as ``torch.from_dlpack``; None returns objects that
            have the method ``__dlpack__``.

    Raises:
        DependencyNotInstalled: If numba-cuda is not installed.
        RuntimeError: If there is no CUDA device.
        TypeError: If an argument has the wrong type.
        ValueError: If an argument has an unknown name or field, a value out of range, or one that is not available on
            the device.
    """

    metadata: dict[str, Any] = _METADATA

    def __init__(
        self,
        num_envs: int = 1,
        task: Any = "track",
        simulation: Any = None,
        wind: Any = None,
        max_episode_steps: int | None = EPISODE_STEPS,
        vehicle: Any = None,
        interface: str | None = None,
        from_dlpack: Callable[[Any], Any] | None = None,
    ) -> None:
        """Build the environment; the class documents the arguments."""
        _check_device()
        if not isinstance(num_envs, int) or num_envs < 1:
            raise ValueError(f"num_envs must be a whole number of at least 1, not {num_envs!r}")
        # A sub-environment on the CPU checks the arguments and computes what all sub-environments have in common.
        mode, wind = AutoresetMode.SAME_STEP, as_wind(wind)
        host = QuadPendulumVectorEnv(1, task, simulation, wind, max_episode_steps, mode, None, vehicle, interface)
        world = host.world
        _check_available(world, wind)
        host.reset(seed=0)
        self.num_envs = num_envs
        self.max_episode_steps = max_episode_steps
        self.single_observation_space, self.single_action_space = observation_space(), action_space()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._kernels = make_kernels(world.simulation.is_rigid)
        self._settings, self._episodes = (cuda.to_device(item) for item in _packed(world, wind, max_episode_steps))
        size = RIGID_MEMORY_SIZE if world.simulation.is_rigid else MEMORY_SIZE
        memory = np.zeros((num_envs, size), order="F")
        memory[:, MEMORY_PARAMETERS] = world.parameters
        self._memory = cuda.to_device(memory)
        self._counters = cuda.to_device(np.zeros((2, num_envs), np.int64))  # clock and number of the episode
        self._keys: Any = None
        self._invalid = cuda.to_device(np.array([NO_ROW]))
        self._outputs = [self._allocate() for _ in range(2)]
        convert = _has_dlpack if from_dlpack is None else lambda array: from_dlpack(_has_dlpack(array))
        self._views = [
            _Outputs(
                convert(item.observation),
                convert(item.final),
                convert(item.reward),
                [convert(item.ended[i]) for i in range(3)],
            )
            for item in self._outputs
        ]
        self.state = convert(self._memory[:, MEMORY_STATE])
        self._turn = 0

    def _allocate(self) -> _Outputs:
        n, zeros = self.num_envs, np.zeros
        arrays = (
            zeros((n, OBSERVATION_SIZE), np.float32, order="F"),
            zeros((n, OBSERVATION_SIZE), np.float32, order="F"),
            zeros(n),
            zeros((3, n), np.bool_),
        )
        return _Outputs(*(cuda.to_device(array) for array in arrays))

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode in every sub-environment: the first episode of its seed, or without a seed the next one.

        Args:
            seed: An integer s for the seeds s, s + 1, …; or None.
            options: There are none.

        Returns:
            The observations, shape (num_envs, 36), float32, and an empty info.

        Raises:
            ValueError: If the seed is not a non-negative integer, an option is given, or an action was invalid.
        """
        check_options(options, ())
        self.check_actions()
        if seed is not None and (not isinstance(seed, int | np.integer) or seed < 0):
            raise ValueError(f"seed must be None or an integer of at least 0, not {seed!r}")
        if seed is not None or self._keys is None:
            super().reset(seed=None if seed is None else int(seed))
            if seed is None:
                seeds = self.np_random.integers(2**63, size=self.num_envs).tolist()
            else:
                seeds = [int(seed) + row for row in range(self.num_envs)]
            self._keys = cuda.to_device(Streams.from_seeds(seeds).keys)
            self._counters[1] = -1
        self._turn = 1 - self._turn
        observation = self._outputs[self._turn].observation
        arrays = self._memory, self._counters, self._keys, self._settings, self._episodes, observation
        self._kernels.start[self._grid](*arrays)
        return self._views[self._turn].observation, {}

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Apply one action in each sub-environment for one control period.

        A sub-environment whose action is invalid does not advance, and its reward is NaN; `check_actions` raises the
        exception, since it must wait for the device.

        Args:
            actions: Array on the device with ``__cuda_array_interface__``, such as a tensor, shape (num_envs, 4),
                float32, components in [−1, 1].

        Returns:
            Observation, shape (num_envs, 36), reward (float64), terminated, truncated and info, all on the device. The
            info has ``final_obs``, the last observation of each episode that this step has ended, and ``_final_obs``,
            the mask of these sub-environments. Elsewhere ``final_obs`` has no meaning.

        Raises:
            ResetNeeded: If `reset` was never called.
            TypeError: If the actions are not an array on the device.
            ValueError: If the actions do not have the shape or the type above.
        """
        if self._keys is None:
            raise ResetNeeded("call reset before step")
        given = _on_device(actions)
        if given.shape != (self.num_envs, ACTION_SIZE) or given.dtype != np.float32:
            raise ValueError(
                f"actions must have shape ({self.num_envs}, {ACTION_SIZE}) and type float32, not {given.shape} and"
                f" {given.dtype}"
            )
        self._turn = 1 - self._turn
        arrays = self._memory, self._counters, self._keys, self._settings, self._episodes, given
        self._kernels.step[self._grid](*arrays, *self._outputs[self._turn], self._invalid)
        observation, final, reward, (terminated, truncated, ended) = self._views[self._turn]
        return observation, reward, terminated, truncated, {"final_obs": final, "_final_obs": ended}

    def check_actions(self) -> None:
        """Wait for the device.

        Raises:
            ValueError: If an action since the last call was out of range or not finite.
        """
        row = int(self._invalid.copy_to_host()[0])
        if row != NO_ROW:
            self._invalid.copy_to_device(np.array([NO_ROW]))
            raise ValueError(f"action of sub-environment {row} must be four numbers in [-1, 1]")

    @property
    def _grid(self) -> tuple[int, int]:
        """Blocks and threads of a kernel."""
        threads = min(_THREADS, self.num_envs)
        return -(-self.num_envs // threads), threads


def _check_device() -> None:
    """Raise an exception if the kernels cannot run."""
    if SIMULATED:
        return
    if find_spec("numba_cuda") is None:
        raise DependencyNotInstalled("numba-cuda is not installed: pip install 'quadpend-gym[gpu]'")
    if not cuda.is_available():
        raise RuntimeError(
            "there is no CUDA device: use QuadPendulumVectorEnv, or set NUMBA_ENABLE_CUDASIM=1 for numba's simulator"
        )


def _check_available(world: World, wind: tuple[Any, ...]) -> None:
    """Raise an exception for settings that the device kernels do not have."""
    trajectory, simulation = world.task.trajectory, world.simulation
    if trajectory is not None and not isinstance(trajectory, Reference):
        raise ValueError(f"task.trajectory must be a Reference on the device, not {type(trajectory).__name__}")
    for model in wind:
        if not isinstance(model, Constant | StillAir):
            raise ValueError(f"wind must consist of Constant and StillAir on the device, not {type(model).__name__}")
    if simulation.delayed_substeps >= simulation.substeps:
        raise ValueError(
            f"latency must be shorter than a control period ({simulation.period:g} s) on the device, not"
            f" {simulation.latency:g} s"
        )


def _packed(world: World, wind: tuple[Any, ...], max_episode_steps: int | None) -> tuple[Any, Any]:
    """Return the packed settings of a step, and the packed `EpisodeSettings`."""
    task, simulation = world.task, world.simulation
    settings = make_settings(task, simulation, any(model.moves_air for model in wind), simulation.substeps)
    fixed = isinstance(task.trajectory, Reference)
    episodes = EpisodeSettings(
        flatten(task.references),
        flatten(task.start),
        start_pole(simulation, task.side),
        hover_thrusts_of(simulation) if simulation.is_rigid else np.zeros(ACTION_SIZE),
        task.trajectory.as_array() if fixed else np.zeros(REFERENCE_SIZE),
        float(fixed),
        np.array(world.wind[0]),
        np.inf if max_episode_steps is None else float(max_episode_steps),
    )
    packed = pack_rigid_settings(settings, simulation) if simulation.is_rigid else pack_settings(settings)
    return packed, episodes.packed()


def _has_dlpack(array: Any) -> Any:
    """Return an object with the method ``__dlpack__`` for an array on the device."""
    if hasattr(array, "__dlpack__"):
        return array
    from cuda.core.utils import StridedMemoryView

    return StridedMemoryView.from_cuda_array_interface(array, stream_ptr=-1)


def _on_device(array: Any) -> Any:
    """Return an array of another library as one that a kernel takes."""
    if SIMULATED:
        return np.asarray(array)
    if not hasattr(array, "__cuda_array_interface__"):
        raise TypeError(f"actions must be an array on the device, not {type(array).__name__}")
    return cuda.as_cuda_array(array)
