"""The vector environment on a GPU, and its build for the CPU: ``gymnasium.make_vec(…, device="cuda")``.

`control_step` generates its control step from the functions of the other environments, so its episodes are
those of `QuadPendulumVectorEnv` with the same seeds, up to the rounding of its type of numbers.
"""

import ctypes
import json
from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from quadpend_gym import __version__
from quadpend_gym.core.streams import Streams
from quadpend_gym.device.library import Library
from quadpend_gym.envs.spaces import spaces_of
from quadpend_gym.physics.state import ACTION_SIZE, STATE_SIZE
from quadpend_gym.scenarios.library import as_scenario
from quadpend_gym.scenarios.scenario import Scenario, scenario_data

Tensor = torch.Tensor


@dataclass(frozen=True)
class Kernel:
    """The generated C source of a scenario and the sizes of its arrays."""

    source: str
    sizes: dict[str, int]

    @classmethod
    def of(cls, scenario: Scenario, file: str | Path | None = None) -> "Kernel":
        """Return the kernel of a scenario, from the file if there is one, else new; then it is written there."""
        generator = [
            Path(__file__).with_name(f"control_step.{kind}").read_text(encoding="utf-8") for kind in ("py", "c")
        ]
        data = [json.dumps(scenario_data(scenario), sort_keys=True), __version__, *generator]
        digest = sha256("".join(data).encode()).hexdigest()[:16]
        path = None if file is None else Path(file)
        if path is not None and path.exists():
            head, _, source = path.read_text(encoding="utf-8").partition("\n")
            found = json.loads(head[3:-3])
            if found.pop("scenario") != digest:
                raise ValueError(
                    f"{path} is the kernel of another scenario or version: remove it, or give another file"
                )
            return cls(source, found)
        from quadpend_gym.device.control_step import control_step

        made = control_step(scenario)
        if path is not None:
            head = json.dumps({"scenario": digest, **made.sizes})
            path.write_text(f"/* {head} */\n{made.source}", encoding="utf-8")
        return cls(made.source, made.sizes)


class QuadPendulumDeviceEnv(VectorEnv[Any, Any, Any]):
    """Many `QuadPendulumEnv`s in one kernel, which takes and returns tensors of PyTorch on its device.

    A step returns the first observation of the next episode where one ends (same-step autoreset). Nothing waits for
    the GPU, and `step` can be captured in a CUDA graph. The tensors that `step` returns are new, except
    ``info["final_obs"]``. The info of a step has ``tracking_error`` (m, world frame, shape (num_envs, 3)) of the state
    that the action led to, ``final_obs``, shape (num_envs, m), valid where ``_final_obs`` is true: where an episode
    ended. Components of an action outside [−1, 1] count as −1 or 1, since a check would wait for the GPU.

    Args:
        num_envs: Number of sub-environments.
        scenario: As in `QuadPendulumEnv`. What this engine does not cover raises ValueError.
        device: ``"cuda"``, ``"cuda:1"``, …; ``"c"`` computes the same with the system's C compiler on one core.
        dtype: ``"float32"`` or ``"float64"``.
        max_episode_steps: Control steps after which an episode is truncated; None: the duration of the scenario.
        kernel: File of the generated source, written if it does not exist; with it, CasADi is not needed.
        autoreset_mode: ``"SameStep"``.
        parts: Fields of the scenario, as in `QuadPendulumEnv`.

    Attributes:
        keys: The random streams of the sub-environments, shape (num_envs,), int64.
        clock: Control steps since each episode began, shape (num_envs,), int32.
    """

    def __init__(
        self,
        num_envs: int = 1,
        scenario: Any = None,
        device: str = "cuda",
        dtype: str = "float32",
        max_episode_steps: int | None = None,
        kernel: str | Path | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        **parts: Any,
    ) -> None:
        """Build the environment; the class documents the arguments."""
        if AutoresetMode(autoreset_mode) is not AutoresetMode.SAME_STEP:
            raise ValueError(f"autoreset_mode must be 'SameStep' with device={device!r}, not {autoreset_mode!r}")
        self.scenario, self.num_envs = as_scenario(scenario, **parts), num_envs
        self.max_episode_steps = self.scenario.steps if max_episode_steps is None else max_episode_steps
        for name in ("num_envs", "max_episode_steps"):
            if not isinstance(number := getattr(self, name), int) or number < 1:
                raise ValueError(f"{name} must be a whole number of at least 1, not {number!r}")
        self.metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}
        self.device, self.dtype = torch.device("cpu" if device == "c" else device), _dtype(dtype)
        made = Kernel.of(self.scenario, kernel)
        self.library, self.sizes = Library(made.source, device, self.dtype), made.sizes
        self.single_observation_space, self.single_action_space = spaces_of(self.scenario)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._size = self.sizes["observation"]
        self.keys = self._zeros(torch.int64)
        self.clock = self._zeros(torch.int32)
        self._episode = self._zeros(torch.int64) - 1
        self._memory = self._zeros(self.dtype, self.sizes["memory"])
        self._final, self._out = self._zeros(self.dtype, self._size), self._zeros(self.dtype, self._size)
        self._seeded = False

    def _zeros(self, dtype: torch.dtype, *shape: int) -> Tensor:
        return torch.zeros(*shape, self.num_envs, dtype=dtype, device=self.device)

    @property
    def state(self) -> Tensor:
        """View of the true states, shape (num_envs, 18), see `quadpend_gym.physics.state`."""
        return self._memory[:STATE_SIZE].T

    def reset(
        self, *, seed: int | Sequence[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Tensor, dict[str, Any]]:
        """Start an episode in every sub-environment: the first episode of its seed, or without a seed the next one.

        Args:
            seed: An integer s for the seeds s, s + 1, …, or one integer for each sub-environment, or None.
            options: ``reset_mask``, a boolean tensor of shape (num_envs,): which sub-environments are reset.
        """
        if unknown := set(options or {}) - {"reset_mask"}:
            raise ValueError(f"the environment on a device has the option 'reset_mask' only, not {min(unknown)!r}")
        if seed is not None or not self._seeded:
            super().reset(seed=seed if isinstance(seed, int) else None)
            first = int(self.np_random.integers(2**62)) if seed is None else seed
            seeds = range(first, first + self.num_envs) if isinstance(first, int) else first
            keys = Streams.from_seeds(list(seeds)).keys.astype(np.int64)
            self.keys.copy_(torch.from_numpy(keys))
            self._episode.fill_(-1)
            self._seeded = True
        mask = torch.as_tensor((options or {}).get("reset_mask", self.keys == self.keys), device=self.device)
        self._run("reset_rows", mask, self.keys, self._episode, self.clock, self._memory, self._out)
        return self._out.clone().T, {}

    def step(self, actions: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, dict[str, Any]]:
        """Apply one action in each sub-environment for one control period.

        Args:
            actions: Shape (num_envs, 4), on the device, with any strides.
        """
        actions = self._checked(actions)
        out = torch.empty(self._size + 4, self.num_envs, dtype=self.dtype, device=self.device)
        ends = torch.empty(2, self.num_envs, dtype=torch.bool, device=self.device)
        strides = map(ctypes.c_longlong, actions.stride())
        state = self.keys, self._episode, self.clock, self._memory
        limit = ctypes.c_int(self.max_episode_steps)
        self._run("step_rows", actions, *strides, limit, *state, out, self._final, ends)
        terminated, truncated = ends
        info = {
            "tracking_error": out[self._size + 1 :].T,
            "final_obs": self._final.T,
            "_final_obs": terminated | truncated,
        }
        return out[: self._size].T, out[self._size], terminated, truncated, info

    def drawn(self, actions: Tensor) -> dict[str, Tensor]:
        """Return what the next step draws if it takes these actions, as `step` takes them and `Motion` takes it.

        The tensors are views of shape (size, num_envs): ``action`` (4), what the actuators make of it; ``arrival`` (1),
        when it acts, in substeps from now, 0 without a drawn loop; ``loop``; ``wind`` (12, or 16 with a hand).
        """
        actions = self._checked(actions)
        parts = {"action": ACTION_SIZE, "arrival": 1, "loop": self.sizes["loop"], "wind": self.sizes["blown"]}
        out = torch.empty(sum(parts.values()), self.num_envs, dtype=self.dtype, device=self.device)
        strides = map(ctypes.c_longlong, actions.stride())
        self._run("draw_rows", actions, *strides, self.keys, self._episode, self.clock, self._memory, out)
        return dict(zip(parts, torch.split(out, list(parts.values())), strict=True))

    def _checked(self, actions: Tensor) -> Tensor:
        if actions.shape != (self.num_envs, ACTION_SIZE) or actions.device.type != self.device.type:
            raise ValueError(
                f"actions must be a tensor of shape ({self.num_envs}, 4) on {self.device}, not of shape"
                f" {tuple(actions.shape)} on {actions.device}"
            )
        return actions.detach().to(self.dtype)

    def part(self, name: str) -> Tensor:
        """Return a part of the memory, a view of shape (size, num_envs), see `control_step`."""
        first = self.sizes[f"{name}_at"]
        return self._memory[first : first + self.sizes[name]]

    def _run(self, name: str, *arguments: Any) -> None:
        self.library(name, self.num_envs, *arguments)


def _dtype(name: str) -> torch.dtype:
    if name not in ("float32", "float64"):
        raise ValueError(f"dtype must be 'float32' or 'float64', not {name!r}")
    return torch.float32 if name == "float32" else torch.float64


class Motion:
    """The motion during a control step, without wind models, sensors and ends, as a function with derivatives.

    A call returns x and the actions under way at the end of the control step. PyTorch differentiates both with respect
    to x, the actions under way and the action; the states between the substeps are stored for it. The arguments have
    the shape (size, n): x, state and memory of the vehicle (18, or 29 of rigid vehicles, see
    `quadpend_gym.engines.functions`); the actions under way, the oldest first; action (4); wind (12, or 16 of a wind
    that can hold the pole); parameters (9). Where the scenario draws the loop, further arguments are the loop (11) and
    when each action acts, the new one last, in substeps from now; `QuadPendulumDeviceEnv.drawn` returns both.

    Args:
        scenario: As in `QuadPendulumEnv`.
        device: As in `QuadPendulumDeviceEnv`, like `dtype` and `kernel`.
        parts: Fields of the scenario.
    """

    def __init__(
        self, scenario: Any = None, device: str = "cuda", dtype: str = "float32", kernel: Any = None, **parts: Any
    ) -> None:
        self.scenario = as_scenario(scenario, **parts)
        made = Kernel.of(self.scenario, kernel)
        self.sizes, self.library = made.sizes, Library(made.source, device, _dtype(dtype), motion=True)

    def __call__(
        self,
        x: Tensor,
        under_way: Tensor,
        action: Tensor,
        wind: Tensor,
        parameters: Tensor,
        loop: Tensor | None = None,
        arrival: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Return x and the actions under way after the control step."""
        if (loop is None or arrival is None) and self.sizes["drawn"]:
            raise ValueError(
                "the scenario draws the loop: give Motion loop and arrival, see QuadPendulumDeviceEnv.drawn"
            )
        queue = torch.cat([under_way, action])
        none = x.new_empty(0)
        given = (wind, parameters, none if loop is None else loop, none if arrival is None else arrival)
        after: Tensor = _Motion.apply(  # type: ignore[no-untyped-call]
            self, x.contiguous(), queue, *(item.contiguous() for item in given)
        )
        return after, queue[ACTION_SIZE:]


class _Motion(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, motion: Motion, x: Tensor, queue: Tensor, wind: Tensor, p: Tensor, loop: Tensor, arrival: Tensor
    ) -> Tensor:
        rows, path = x.shape[1], x.new_empty(motion.sizes["substeps"], *x.shape)
        after = torch.empty_like(x)
        motion.library("move_rows", rows, x, queue, arrival, wind, p, loop, path, after)
        ctx.motion = motion
        ctx.save_for_backward(path, after, queue, arrival, wind, p, loop)
        return after

    @staticmethod
    def backward(ctx: Any, *bars: Tensor) -> Any:
        path, after, queue, *given = ctx.saved_tensors
        bar, bar_x, bar_queue = bars[0].contiguous(), torch.empty_like(path[0]), torch.empty_like(queue)
        ctx.motion.library("move_rows_back", bar.shape[1], path, after, queue, *given, bar, bar_x, bar_queue)
        return None, bar_x, bar_queue, None, None, None, None
