"""Analytic policy gradients (APG): gradients of the tracking cost through the equations of motion and the observer.

The rows of the training environment fly windows of H control steps. The environment and its observer compute all
values, with the noise of the sensors; generated C (`flight`, `observed`) has the derivatives of the same equations:

    (1)  o_t  = observation of the policy,          ∂o_t/∂(z_t, b_t)
    (2)  a_t  = clip(π(o_t), −1, 1)
    (3)  z_{t+1}, b_{t+1} from the environment,     ∂(z_{t+1}, b_{t+1})/∂(z_t, b_t, a_t)
    (4)  J    = w_R · mean over scenarios of R  +  w_L · mean over rows of L
                + mean over rows and steps of c(x_{t+1}, a_t)

z is the state x with what vehicle and actuators remember, b what the observer believes. Not in the gradient are the
disturbance that `adrc` estimates, and values that sensors hold. A window of H steps has no terminal value, so the
consequences of its last actions are cut off.

R is the root mean square of the tracking error over the rows and steps of a scenario in a window, which is similar to
the measure of the published results; the mean of the squares over all scenarios would be that of the hardest scenario.
L = ½ ln(mean of |e|² over the scored steps of a row + ε²) weighs relative errors: 1 mm in light wind as much as 1 cm in
strong wind, and settled flight as much as the first second. Steps that the scenario does not score cost no L.

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
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.policies import ActorCriticPolicy

from quadpend_gym.core.arrays import Booleans, Floats
from quadpend_gym.physics.state import STATE_SIZE
from quadpend_gym.scenarios import Scenario
from quadpend_gym.tasks.observation import FULL, OUTPUT_FEEDBACK
from quadpend_train.envs.concatenated import worlds
from quadpend_train.policies.sb3_models import mean_action
from quadpend_train.training.environment import hybrid_wrappers
from quadpend_train.training.flight import Flights, Step, check_covered, reference_points
from quadpend_train.training.settings import ALONE, ApgSettings, TrainSettings

# Settings that APG does not use
_UNUSED = ("reward", "reward_scale", "critic_warmup_steps")
_SMALLEST_ERROR = 5e-4  # ε of the logarithm, m


class APG(OnPolicyAlgorithm):
    """Analytic policy gradients with the interface of Stable-Baselines3; the critic of the policy is not used.

    The environment is an `SB3VecEnv` with the sub-environments of `scenarios`, which `check_covered` accepts.
    """

    policy_aliases = OnPolicyAlgorithm.policy_aliases | {"MlpPolicy": ActorCriticPolicy}

    def __init__(self, policy: Any, env: Any, scenarios: Sequence[Scenario], apg: ApgSettings, **options: Any) -> None:
        unused: dict[str, Any] = {"n_steps": 1, "gamma": 1.0, "gae_lambda": 1.0, "ent_coef": 0.0, "vf_coef": 0.0}
        unused |= {"use_sde": False, "sde_sample_freq": -1}
        super().__init__(policy, env, max_grad_norm=apg.max_grad_norm, **unused, **options)
        self.apg = apg
        size = self.observation_space.shape[0]  # type: ignore[index]
        self._scenarios = scenarios
        self._flights = Flights(scenarios, hybrid_wrappers(env.env), self.n_envs, size, apg)
        self._flight = self._flights.initial(np.zeros((self.n_envs, STATE_SIZE)))
        self._cost, self._falls, self._log_rmse = torch.zeros(()), 0, 0.0
        self._unscored = np.repeat([scenario.unscored for scenario in scenarios], self.n_envs // len(scenarios))

    def collect_rollouts(self, env: Any, callback: Any, rollout_buffer: Any, n_rollout_steps: int) -> bool:
        """Fly a window and compute its cost, equations (1) to (5)."""
        callback.on_rollout_start()
        self._restart_rows(env)
        everything, hybrid = worlds(env.env), self._flights.hybrid
        flight = torch.as_tensor(self._after_step(everything, self._flight, np.asarray(self._last_episode_starts)))
        observation, (believed, sensing) = torch.as_tensor(self._last_obs), self._flights.beliefs()
        belief, scored = torch.as_tensor(believed), np.zeros(env.num_envs)
        self._falls, costs, settled = 0, torch.zeros(env.num_envs, 2, dtype=torch.float64), []
        for _ in range(self.apg.window):
            action = mean_action(self, observation)
            applied = action if hybrid is None else hybrid.output * action + hybrid.builds_on(observation, 0.0)
            time = everything[0].simulation.period * (1.0 + _gather(everything, "clock"))
            reference = _gather(everything, "reference")
            is_scored = time > self._unscored
            before = [[memory.copy() for memory in world.actuator_memories] for world in everything]
            wind, parameters = _gather(everything, "wind"), _gather(everything, "parameters")
            self._last_obs, rewards, ended, infos = env.step(action.detach().clamp(-1.0, 1.0).numpy())
            self._last_episode_starts = ended
            self.num_timesteps += env.num_envs
            callback.update_locals(locals())
            if not callback.on_step():
                return False
            if ended.any():
                self._update_info_buffer(infos, ended)
                self._falls += sum(not infos[row]["TimeLimit.truncated"] for row in np.flatnonzero(ended))
            jumped = np.where(ended[:, np.newaxis], reference, _gather(everything, "reference"))
            point = reference_points(self._scenarios, jumped, time)
            constants = wind, parameters, self._flights.drawn(everything, before), point, self._flights.weights
            after, step_costs = self._flights.step(flight.detach().numpy(), applied.detach().numpy(), *constants)
            noise = _gather(everything, "measured") - self._flights.delayed(flight.detach().numpy(), after)
            noise[ended] = 0.0
            after = self._after_step(everything, after, ended)
            given = self._flights, constants, sensing, noise, ended
            believed, sensing = self._flights.beliefs()
            values = after, step_costs, believed, self._last_obs
            results = Step.apply(flight, belief, applied, given, values)  # type: ignore[no-untyped-call]
            flight, added, belief, observation = results
            costs = costs + added
            settled.append(added[:, 0] * torch.as_tensor(is_scored))
            scored += is_scored
        squares, further = costs.unbind(dim=1)
        rmse = torch.sqrt(squares.view(len(self._scenarios), -1).mean(dim=1) / self.apg.window + 1e-6)
        self._cost = self.apg.rmse * rmse.mean() + further.sum() / (self.apg.window * env.num_envs)
        if self.apg.log_rmse:
            mean = torch.stack(settled).sum(dim=0) / torch.as_tensor(np.maximum(scored, 1.0))
            logs = 0.5 * torch.log(mean + _SMALLEST_ERROR**2)[torch.as_tensor(scored > 0.5 * self.apg.window)]
            self._cost = self._cost + self.apg.log_rmse * logs.sum() / env.num_envs
            self._log_rmse = float(logs.detach().mean()) if len(logs) else float("nan")
        self._flight = flight.detach().numpy()
        callback.on_rollout_end()
        return True

    def _after_step(self, everything: Sequence[Any], flight: Floats, begun: Booleans) -> Floats:
        """Return flights with the states of the environment, and new ones in rows whose episode has begun."""
        state, after = _gather(everything, "state"), flight.copy()
        after[:, :STATE_SIZE] = state
        if begun.any():
            after[begun] = self._flights.initial(state)[begun]
        return after

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
        if self.apg.log_rmse:
            self.logger.record("train/log_rmse", self._log_rmse)

    def _restart_rows(self, env: Any) -> None:
        """Begin new episodes in a share of the rows of each scenario, drawn at random."""
        window = self.num_timesteps // (self.apg.window * env.num_envs)
        random, count = np.random.default_rng([self.seed or 0, window]), len(self._scenarios)
        share = env.num_envs // count
        started = np.arange(share) < round(self.apg.restart * share)
        rows = np.concatenate([random.permutation(started) for _ in range(count)])
        if rows.any():
            self._last_obs = env.restart(rows)
            self._last_episode_starts = np.asarray(self._last_episode_starts) | rows

    def save(self, path: Any, *_: Any, **__: Any) -> None:
        """Write everything that training changes; loading it executes no code."""
        counts = self.num_timesteps, self._n_updates
        torch.save((counts, self.policy.state_dict(), self.policy.optimizer.state_dict()), path)

    def restore(self, path: Path) -> None:
        """Read what `save` has written."""
        (self.num_timesteps, self._n_updates), weights, optimizer = torch.load(path, weights_only=True)
        self.policy.load_state_dict(weights)
        self.policy.optimizer.load_state_dict(optimizer)


def check_apg(settings: TrainSettings) -> None:
    """Check that APG covers the settings of a run."""
    if settings.hybrid.mode not in ALONE:
        raise ValueError(f"mode must be one of {', '.join(ALONE)} with algo 'apg', not {settings.hybrid.mode!r}")
    default = TrainSettings()
    for name in _UNUSED:
        if (value := getattr(settings, name)) != (only := getattr(default, name)):
            raise ValueError(f"{name} must be {only!r} with algo 'apg', not {value!r}")
    for scenario in settings.scenarios:
        check_covered(scenario.name, scenario)
        if not set(FULL) - set(OUTPUT_FEEDBACK) <= set(scenario.observation) and not settings.hybrid.base_controller:
            raise ValueError(
                f"the scenario {scenario.name} has no velocities in its observation: algo 'apg' needs a"
                " base_controller, which estimates them"
            )


def _gather(everything: Sequence[Any], name: str) -> Floats:
    """Return an attribute of all worlds, one below the other."""
    return np.concatenate([getattr(world, name) for world in everything])
