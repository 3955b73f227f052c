"""Analytic policy gradients (APG): gradients of the tracking cost through the differentiable dynamics.

The rows of the training environment fly windows of H control steps. The policy π receives the environment's
observation, with the noise of the sensors and the errors of the observer, and the environment gives every next state.
The differentiable dynamics f follow the flight, so that the derivatives of the cost reach the policy:

    (1)  o_t  = observation of the environment,     ∂o_t/∂z_t = ∂s(p)/∂z     s: the part that depends on the state
    (2)  a_t  = clip(π(o_t), −1, 1)
    (3)  x_{t+1} = state of the environment,        ∂x_{t+1}/∂(x_t, a_t) = ∂f/∂(x_t, a_t)
    (4)  J    = w_R · mean over scenarios of R  +  mean over rows and steps of c(x_{t+1}, a_t)

z_t = (x_t, y_t, a_{t−1}) has the actions under way and the lagged actions y_t. p(z_t) is the state at the time when
a_t acts, to which an observer carries its estimate forward through the known delays and lags; without them p = x_t. In
(1) s is linear: tracking errors, direction, attitude and their rates; p is linearised at hover.

The error of the observation, o − s(p), the estimated disturbance and the situation are taken to be independent of the
policy. That holds for a linear observer whose model of the vehicle and of the loop is exact. Elsewhere the gradient of
J is biased: where parameters differ from nominal ones, since the observer then takes a part of the action's effect for
a disturbance; where delays or lags are not known (``loop_known = false``); and where measurements are delayed and no
observer predicts. A window of H steps has no terminal value, so the consequences of its last actions are cut off.

R is the root mean square of the tracking error over the rows and steps of a scenario in a window, which is similar to
the measure of the published results; the mean of the squares over all scenarios would be that of the hardest scenario.
The further cost of a step is

    (5)  c = w₁ |e| + w_ψ ψ_e² + w_a |a|² + w_ω |η̇|² + w_l ℓ

    (6)  ℓ = Σ max(0.6 − m, 0)²

with the tracking error e (m), the yaw error ψ_e, the action a, and the margins m to the limits of the tilts of pendulum
and body and of the tracking error (1 far from the limit, 0 at the limit), so that falls have a cost before they happen.
An action outside [−1, 1] has the further cost of the squared excess. States are carried over from window to window,
without gradients. A share of the rows, drawn at random, begins a new episode with each window.

A row that falls begins a new episode at once, so J lacks the cost of the rest of its episode: of a policy that often
falls, J is too small. ``train/falls`` in the log is the number of falls in a window.

Sources: Xu et al., Accelerated policy learning with parallel differentiable simulation, ICLR 2022; Wiedemann et al.,
Training efficient controllers via analytic policy gradient, ICRA 2023.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.policies import ActorCriticPolicy
from torch import Tensor

from quadpend_baselines.controllers.output_feedback import OutputFeedback
from quadpend_baselines.estimation.loop import Loop
from quadpend_gym.physics.state import ACTION_SIZE, STATE_SIZE
from quadpend_gym.scenarios import Scenario
from quadpend_gym.tasks.observation import REFERENCE_START
from quadpend_gym.wind import WIND_SIZE
from quadpend_train.differentiable.dynamics import Motion, as_motion, as_physics, as_state, tensor
from quadpend_train.differentiable.observation import (
    limit_row,
    margins,
    observe_state,
    reference_derivatives,
    tracking_errors,
)
from quadpend_train.differentiable.plant import Plant, check_covered
from quadpend_train.envs.concatenated import worlds
from quadpend_train.training.environment import hybrid_wrappers
from quadpend_train.training.settings import ApgSettings, TrainSettings

# Settings that APG does not use
_UNUSED = ("curriculum", "history", "history_actions", "reward", "reward_scale", "critic_warmup_steps")


class APG(OnPolicyAlgorithm):
    """Analytic policy gradients with the interface of Stable-Baselines3.

    Args:
        policy: As for `OnPolicyAlgorithm`; its critic is not used.
        env: Training environment, an `SB3VecEnv` with the sub-environments of `scenarios`.
        scenarios: The scenarios, which `check_covered` accepts.
        apg: Settings.
        options: As for `OnPolicyAlgorithm`.
    """

    policy_aliases = OnPolicyAlgorithm.policy_aliases | {"MlpPolicy": ActorCriticPolicy}

    def __init__(self, policy: Any, env: Any, scenarios: Sequence[Scenario], apg: ApgSettings, **options: Any) -> None:
        """Make the policy and the differentiable plant."""
        unused: dict[str, Any] = {"n_steps": 1, "gamma": 1.0, "gae_lambda": 1.0, "ent_coef": 0.0, "vf_coef": 0.0}
        unused |= {"use_sde": False, "sde_sample_freq": -1}
        super().__init__(policy, env, max_grad_norm=apg.max_grad_norm, **unused, **options)
        self.apg = apg
        self._plant = Plant(scenarios, self.n_envs)
        tasks = [scenario.task for scenario in scenarios]
        limits = torch.tensor([limit_row(task.limits) for task in tasks])
        self._limits = limits.repeat_interleave(self.n_envs // len(scenarios), dim=0)
        self._memory = self._plant.initial_memory()
        loops = [
            item.hybrid.controller.predicted_loop if isinstance(item.hybrid.controller, OutputFeedback) else Loop()
            for item in hybrid_wrappers(env.env)
            for _ in worlds(item)
        ]
        size, memory_size = self.observation_space.shape[0], self._plant.memory_size  # type: ignore[index]
        self._sensitivity = torch.stack(
            [
                _sensitivity(*pair, size, memory_size)
                for pair in zip(scenarios, loops or [Loop()] * len(scenarios), strict=True)
            ]
        )
        self._cost, self._falls = torch.zeros(()), 0

    def collect_rollouts(self, env: Any, callback: Any, rollout_buffer: Any, n_rollout_steps: int) -> bool:
        """Fly a window and compute its cost, equations (1) to (5)."""
        callback.on_rollout_start()
        self._restart_rows(env)
        everything = worlds(env.env)
        started = torch.as_tensor(np.asarray(self._last_episode_starts))[:, None]
        memory = torch.where(started, torch.zeros_like(self._memory), self._memory.detach())
        state = _gather(everything, "state")
        last, self._falls = torch.zeros(env.num_envs, ACTION_SIZE), 0
        squares, cost = torch.zeros(env.num_envs), torch.zeros(())
        for _ in range(self.apg.window):
            physics, wind = as_physics(_gather(everything, "parameters")), _gather(everything, "wind")
            time = self._plant.simulation.period * (1.0 + _gather(everything, "clock"))
            target = reference_derivatives(_gather(everything, "reference"), time)
            action = self._mean_action(torch.cat([state, memory, last], dim=1))
            last = action.clamp(-1.0, 1.0)
            after, memory = self._plant.step(as_motion(state), last, wind, physics, memory)
            squared, further = self._step_cost(after, action, target, physics.rod_length)
            squares, cost = squares + squared, cost + further
            self._last_obs, rewards, ended, infos = env.step(last.detach().numpy())
            self._last_episode_starts = ended
            self.num_timesteps += env.num_envs
            callback.update_locals(locals())
            if not callback.on_step():
                return False
            if ended.any():
                self._update_info_buffer(infos, ended)
                self._falls += sum(not infos[row]["TimeLimit.truncated"] for row in np.flatnonzero(ended))
            flying = torch.as_tensor(~ended, dtype=state.dtype)[:, None]
            predicted = as_state(after)
            state = _gather(everything, "state") + flying * (predicted - predicted.detach())
            memory, last = flying * memory, flying * last
            if state.requires_grad:
                state.register_hook(self._limit_gradient)  # type: ignore[no-untyped-call]
        rmse = torch.sqrt(squares.view(len(self._sensitivity), -1).mean(dim=1) / self.apg.window + 1e-6)
        self._cost = self.apg.rmse * rmse.mean() + cost / (self.apg.window * env.num_envs)
        self._memory = memory.detach()
        callback.on_rollout_end()
        return True

    def train(self) -> None:
        """Take a step of Adam along the gradient of the cost of the last window."""
        self._update_learning_rate(self.policy.optimizer)
        self.policy.optimizer.zero_grad()
        torch.autograd.backward(self._cost)
        parameters = [item for item in self.policy.parameters() if item.grad is not None]
        norm = torch.nn.utils.clip_grad_norm_(parameters, self.max_grad_norm)
        if torch.isfinite(norm):
            self.policy.optimizer.step()
        self._n_updates += 1
        self.logger.record("train/cost", float(self._cost.detach()))
        self.logger.record("train/gradient_norm", float(norm))
        self.logger.record("train/falls", self._falls)

    def _restart_rows(self, env: Any) -> None:
        """Begin new episodes in a share of the rows of each scenario, drawn at random."""
        window = self.num_timesteps // (self.apg.window * env.num_envs)
        random, count = np.random.default_rng([self.seed or 0, window]), len(self._sensitivity)
        share = env.num_envs // count
        started = np.arange(share) < round(self.apg.restart * share)
        rows = np.concatenate([random.permutation(started) for _ in range(count)])
        if rows.any():
            self._last_obs = env.restart(rows)
            self._last_episode_starts = np.asarray(self._last_episode_starts) | rows

    def _mean_action(self, inputs: Tensor) -> Tensor:
        """Return π(o), with the derivative of equation (1); `inputs` is z, shape (n, 18 + k + 4)."""
        difference = (inputs - inputs.detach()).view(len(self._sensitivity), -1, inputs.shape[1])
        observed = torch.as_tensor(self._last_obs) + (difference @ self._sensitivity).flatten(0, 1)
        distribution: Any = self.policy.get_distribution(observed).distribution
        mean: Tensor = distribution.mean
        return mean

    def _step_cost(self, motion: Motion, action: Tensor, target: Tensor, rod_length: Tensor) -> tuple[Tensor, Tensor]:
        """Return |e|² of each row, shape (n,), and the sum over the rows of equation (5)."""
        w, tracking = self.apg, tracking_errors(motion, rod_length, target)
        squared = (tracking.error**2).sum(dim=1)
        cost = w.error * torch.sqrt(squared + 1e-8)
        cost = cost + w.yaw * tracking.yaw_error[:, 0] ** 2
        cost = cost + w.effort * (action**2).sum(dim=1) + w.rate * (motion.euler_rate**2).sum(dim=1)
        excess = torch.relu(action.abs() - 1.0)
        near = margins(motion, tracking, self._limits)
        lean = torch.relu(0.6 - torch.cat(near, dim=1))
        total: Tensor = (cost + w.lean * (lean**2).sum(dim=1) + (excess**2).sum(dim=1)).sum()
        return squared, total

    def _limit_gradient(self, gradient: Tensor) -> Tensor:
        """Limit the norm of the gradient of each row, which grows without bound while a row falls."""
        norm = torch.linalg.vector_norm(gradient, dim=1, keepdim=True)
        limit = self.apg.max_state_gradient / (self.apg.window * len(gradient))
        limited: Tensor = gradient * (limit / (norm + 1e-12)).clamp(max=1.0)
        return limited

    def save(self, path: Any, *_: Any, **__: Any) -> None:
        """Write everything that training changes to an npz archive, which executes no code when it is loaded."""
        arrays = {f"policy.{name}": value.numpy() for name, value in self.policy.state_dict().items()}
        for number, values in self.policy.optimizer.state_dict()["state"].items():
            arrays |= {f"optimizer.{number}.{name}": value.numpy() for name, value in values.items()}
        counts = np.array([self.num_timesteps, self._n_updates])
        if hasattr(self, "scores"):
            arrays["scores"] = np.array(self.scores, dtype=np.float64).reshape(-1, 4)
            arrays["best"] = np.frombuffer(self.best, dtype=np.uint8)
        with Path(path).open("wb") as file:
            np.savez(file, counts=counts, **arrays)

    def restore(self, path: Path) -> None:
        """Read what `save` has written."""
        with path.open("rb") as file, np.load(file, allow_pickle=False) as data:
            arrays = {name: torch.as_tensor(data[name]) for name in data.files}
        self.num_timesteps, self._n_updates = arrays.pop("counts").tolist()
        if "scores" in arrays:
            self.scores = [(int(steps), *rest) for steps, *rest in arrays.pop("scores").tolist()]
            self.best = arrays.pop("best").numpy().tobytes()
        optimizer = self.policy.optimizer.state_dict()
        weights: dict[str, Tensor] = {}
        for name, value in arrays.items():
            part, _, rest = name.partition(".")
            if part == "policy":
                weights[rest] = value
            else:
                number, _, key = rest.partition(".")
                optimizer["state"].setdefault(int(number), {})[key] = value
        self.policy.load_state_dict(weights)
        self.policy.optimizer.load_state_dict(optimizer)


def check_apg(settings: TrainSettings) -> None:
    """Check that APG covers the settings of a run."""
    if settings.hybrid.mode != "estimate_only":
        raise ValueError(f"mode must be 'estimate_only' with algo 'apg', not {settings.hybrid.mode!r}")
    default = TrainSettings()
    for name in _UNUSED:
        if (value := getattr(settings, name)) != (only := getattr(default, name)):
            raise ValueError(f"{name} must be {only!r} with algo 'apg', not {value!r}")
    for name, scenario in settings.found().items():
        check_covered(name, scenario)
        if scenario.output_feedback and not settings.hybrid.base_controller:
            raise ValueError(
                f"the scenario {name} has no velocities in its observation: algo 'apg' needs a base_controller, which"
                " estimates them"
            )


def _sensitivity(scenario: Scenario, loop: Loop, size: int, memory_size: int) -> Tensor:
    """Return ∂o/∂z of equation (1) at hover, transposed, shape (18 + k + 4, m).

    Args:
        scenario: The scenario.
        loop: The delays and lags through which the observer predicts.
        size: Size m of the observation.
        memory_size: k, at least that of the scenario's actuators.
    """
    s, plant, calm = scenario.simulation, Plant([scenario], 1), torch.zeros(1, WIND_SIZE)
    physics = as_physics(tensor(s.parameters.as_array())[None])
    substep, left = s.period / s.substeps, loop.delay * s.substeps + round(loop.lag * s.substeps / s.period)
    parts = [min(s.substeps, left - begun) for begun in range(0, left, s.substeps)]  # substeps of each period

    def observed(inputs: Tensor) -> Tensor:
        state, memory, action = torch.split(inputs[None], [STATE_SIZE, memory_size, ACTION_SIZE], dim=1)
        motion, memory = as_motion(state), memory[:, : plant.memory_size]
        for part in parts:
            plant.simulation = replace(s, period=part * substep, substeps=part)
            motion, memory = plant.step(motion, action, calm, physics, memory)
        return observe_state(motion, tracking_errors(motion, physics.rod_length, torch.zeros(1, 2, 4)))[0]

    hover = as_state(as_motion(torch.zeros(1, STATE_SIZE))._replace(direction=torch.tensor([[0.0, 0.0, 1.0]])))
    inputs = torch.nn.functional.pad(hover[0], (0, memory_size + ACTION_SIZE))
    jacobian: Tensor = torch.func.jacrev(observed)(inputs)
    return torch.nn.functional.pad(jacobian.T, (0, size - REFERENCE_START))


def _gather(everything: Sequence[Any], name: str) -> Tensor:
    """Return an attribute of all worlds, one below the other."""
    return tensor(np.concatenate([getattr(world, name) for world in everything]))
