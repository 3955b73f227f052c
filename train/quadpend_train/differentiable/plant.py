"""One control step of sub-environments of several scenarios in PyTorch, with gradients.

A step is that of `quadpend_gym.envs.step_kernel` after the actuators `ActionDelay` and `MotorLag`:

    (1)  ā = y + (a′ − y) (1 − (T/h) (1 − e^(−h/T))),   y ← a′ + e^(−h/T) (y − a′)     a′: the delayed action
    (2)  u = s_u (1 + ā₀),   τᵢ = sᵢ āᵢ
    (3)  d ← d + drag, if the wind moves the air
    (4)  x ← f(x, u, τ, d)                                                              `dynamics.advance`
"""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from quadpend_gym.actuators import ActionDelay, MotorLag
from quadpend_gym.physics.state import ACTION_SIZE, DISTURBANCE_SIZE
from quadpend_gym.scenarios import Scenario
from quadpend_gym.tasks.trajectories import Reference
from quadpend_gym.wind import WIND_FIELDS
from quadpend_train.differentiable.dynamics import Forces, Motion, Physics, advance, drag


def check_covered(name: str, scenario: Scenario) -> None:
    """Check that the differentiable dynamics covers a scenario."""
    if scenario.vehicle.attitude == "rigid":
        raise ValueError(
            f"algo 'apg' cannot fly the vehicle {scenario.simulation.vehicle.name!r}: the differentiable dynamics"
            f" covers only the paper's vehicle (scenario {name})"
        )
    for model in scenario.actuators:
        if not isinstance(model, ActionDelay | MotorLag):
            raise ValueError(
                f"algo 'apg' cannot have the actuator {model.kind!r}: the differentiable dynamics covers only"
                f" 'action_delay' and 'motor_lag' (scenario {name})"
            )
    if scenario.task.pendulum != "upright" or scenario.task.reward.pendulum_first > 0.0:
        raise ValueError(f"algo 'apg' balances an upright pendulum only, not the task of the scenario {name}")
    trajectory = scenario.task.trajectory
    if not isinstance(trajectory, Reference | None):
        raise ValueError(
            f"algo 'apg' cannot follow a trajectory of the kind {trajectory.kind!r}: the differentiable dynamics covers"
            f" only references (scenario {name})"
        )


class Plant:
    """One control step of n sub-environments, an equal number of each of several scenarios, in their order.

    Args:
        scenarios: The scenarios, which `check_covered` accepts and which have the same simulation.
        rows: Number n of sub-environments, a multiple of the number of scenarios.
        dtype: Type of the numbers.

    Attributes:
        simulation: The nominal simulation.
        memory_size: Number of floats that the actuators store for each row.
    """

    def __init__(self, scenarios: Sequence[Scenario], rows: int, dtype: torch.dtype = torch.float32) -> None:
        """Find which rows have which actuators, and which have drag."""
        self.simulation = scenarios[0].simulation
        self._share = rows // len(scenarios)
        self._chains = [scenario.actuators for scenario in scenarios]
        self._scale = torch.as_tensor(self.simulation.command_scale, dtype=dtype)
        self._hover = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=dtype)
        moves_air = [float(any(model.moves_air for model in scenario.wind_models)) for scenario in scenarios]
        self._moves_air = torch.tensor(moves_air, dtype=dtype).repeat_interleave(self._share)[:, None]
        self.memory_size = max(sum(int(model.memory_size) for model in chain) for chain in self._chains)

    def initial_memory(self) -> Tensor:
        """Return the memory of the actuators at the start of an episode, shape (n, k)."""
        return torch.zeros(self._share * len(self._chains), self.memory_size, dtype=self._scale.dtype)

    def step(
        self, motion: Motion, action: Tensor, wind: Tensor, physics: Physics, memory: Tensor
    ) -> tuple[Motion, Tensor]:
        """Return the motion one control period later, and the memory of the actuators.

        Args:
            motion: The motion at the beginning of the period.
            action: Components in [−1, 1], shape (n, 4).
            wind: Wind over the period, laid out as in `quadpend_gym.wind`, shape (n, 12).
            physics: The parameters of each row.
            memory: The memory of the actuators.
        """
        action, memory = self._act(action, memory)
        command = self._scale * (self._hover + action)
        force, bob_force, torque = torch.split(wind[:, :DISTURBANCE_SIZE], 3, dim=1)
        if self._moves_air.any():
            on_quadrotor, on_bob = drag(motion, wind[:, WIND_FIELDS["velocity"]], physics)
            force, bob_force = force + self._moves_air * on_quadrotor, bob_force + self._moves_air * on_bob
        forces, s = Forces(force, bob_force, torque), self.simulation
        return advance(motion, command, forces, physics, s.period, s.substeps), memory

    def _act(self, action: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
        """Return the action after the actuators and their memory."""
        if not self.memory_size:
            return action, memory
        actions, memories = [], []
        rows = zip(self._chains, torch.split(action, self._share), torch.split(memory, self._share), strict=True)
        for chain, out, stored in rows:
            sizes = [int(model.memory_size) for model in chain]
            *parts, unused = torch.split(stored, [*sizes, self.memory_size - sum(sizes)], dim=1)
            for i, model in enumerate(chain):
                out, parts[i] = _actuate(model, out, parts[i], self.simulation.period)
            actions.append(out)
            memories.append(torch.cat([*parts, unused], dim=1))
        return torch.cat(actions), torch.cat(memories)


def _actuate(model: ActionDelay | MotorLag, action: Tensor, memory: Tensor, period: float) -> tuple[Tensor, Tensor]:
    """Return the action after an actuator and the memory of the actuator: of a delay the oldest action first."""
    if isinstance(model, ActionDelay):
        under_way = torch.cat([memory, action], dim=1)
        return under_way[:, :ACTION_SIZE], under_way[:, ACTION_SIZE:]
    ratio = period / model.time_constant
    gap = memory - action
    return action - math.expm1(-ratio) / ratio * gap, action + math.exp(-ratio) * gap
