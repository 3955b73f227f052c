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

import casadi as ca
import numpy as np
import torch
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.policies import ActorCriticPolicy
from torch import Tensor

from quadpend_baselines.controllers.output_feedback import OutputFeedback
from quadpend_baselines.estimation.loop import Loop
from quadpend_gym import engines
from quadpend_gym.core.arrays import Booleans, Floats
from quadpend_gym.physics.state import ACTION_SIZE, DIRECTION, STATE_SIZE
from quadpend_gym.scenarios import Scenario
from quadpend_gym.tasks.observation import REFERENCE_START
from quadpend_gym.wind import WIND_SIZE
from quadpend_train.envs.concatenated import worlds
from quadpend_train.training.environment import hybrid_wrappers
from quadpend_train.training.flight import (
    POINT_SIZE,
    Flights,
    Kind,
    Step,
    check_covered,
    control_step,
    reference_points,
)
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
        self._scenarios, self._flights = scenarios, Flights(scenarios, self.n_envs, apg)
        self._flight = self._flights.initial(np.zeros((self.n_envs, STATE_SIZE)))
        loops = [
            item.hybrid.controller.predicted_loop if isinstance(item.hybrid.controller, OutputFeedback) else Loop()
            for item in hybrid_wrappers(env.env)
            for _ in worlds(item)
        ]
        size = self.observation_space.shape[0]  # type: ignore[index]
        self._sensitivity = torch.stack(
            [
                _sensitivity(*pair, size, self._flights.size)
                for pair in zip(scenarios, loops or [Loop()] * len(scenarios), strict=True)
            ]
        )
        self._cost, self._falls = torch.zeros(()), 0

    def collect_rollouts(self, env: Any, callback: Any, rollout_buffer: Any, n_rollout_steps: int) -> bool:
        """Fly a window and compute its cost, equations (1) to (5)."""
        callback.on_rollout_start()
        self._restart_rows(env)
        everything = worlds(env.env)
        flight = torch.as_tensor(self._after_step(everything, self._flight, np.asarray(self._last_episode_starts)))
        last, self._falls = torch.zeros(env.num_envs, ACTION_SIZE), 0
        costs = torch.zeros(env.num_envs, 2, dtype=torch.float64)
        for _ in range(self.apg.window):
            action = self._mean_action(torch.cat([flight, last], dim=1))
            last = action.clamp(-1.0, 1.0)
            time = everything[0].simulation.period * (1.0 + _gather(everything, "clock"))
            point = reference_points(self._scenarios, _gather(everything, "reference"), time)
            wind, parameters = _gather(everything, "wind"), _gather(everything, "parameters")
            others = action.detach().numpy().astype(np.float64), wind, parameters, point, self._flights.weights
            after, step_costs = self._flights.step(flight.detach().numpy(), *others)
            self._last_obs, rewards, ended, infos = env.step(last.detach().numpy())
            self._last_episode_starts = ended
            self.num_timesteps += env.num_envs
            callback.update_locals(locals())
            if not callback.on_step():
                return False
            if ended.any():
                self._update_info_buffer(infos, ended)
                self._falls += sum(not infos[row]["TimeLimit.truncated"] for row in np.flatnonzero(ended))
                last = last * torch.as_tensor(~ended)[:, None]
            after = self._after_step(everything, after, ended)
            arguments = flight, action, self._flights, others, after, step_costs, ended
            flight, added = Step.apply(*arguments)  # type: ignore[no-untyped-call]
            costs = costs + added
        squares, further = costs.unbind(dim=1)
        rmse = torch.sqrt(squares.view(len(self._sensitivity), -1).mean(dim=1) / self.apg.window + 1e-6)
        self._cost = self.apg.rmse * rmse.mean() + further.sum() / (self.apg.window * env.num_envs)
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
        """Return π(o), with the derivative of equation (1); `inputs` is z, shape (n, k + 4)."""
        difference = (inputs - inputs.detach()).float().view(len(self._sensitivity), -1, inputs.shape[1])
        observed = torch.as_tensor(self._last_obs) + (difference @ self._sensitivity).flatten(0, 1)
        policy: Any = self.policy
        features = policy.extract_features(observed, policy.pi_features_extractor)
        mean: Tensor = policy.action_net(policy.mlp_extractor.forward_actor(features))
        return mean

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


def _sensitivity(scenario: Scenario, loop: Loop, size: int, flight_size: int) -> Tensor:
    """Return ∂o/∂z of equation (1) at hover, transposed, shape (k + 4, m).

    Args:
        scenario: The scenario.
        loop: The delays and lags through which the observer predicts.
        size: Size m of the observation.
        flight_size: k, at least that of the scenario's flights.
    """
    s, kind = scenario.simulation, Kind.of(scenario)
    left = loop.delay * s.substeps + round(loop.lag * s.substeps / s.period)
    hover = np.zeros((1, STATE_SIZE))
    hover[0, DIRECTION + 2] = 1.0
    begin, parameters = kind.initial(hover)[0], s.parameters.as_array()
    flight, action = ca.SX.sym("flight", begin.size), ca.SX.sym("action", ACTION_SIZE)
    after = flight
    for begun in range(0, left, s.substeps):
        substeps = min(s.substeps, left - begun)
        part = s if s.latency else replace(s, period=substeps * s.period / s.substeps, substeps=substeps)
        after = control_step(kind._replace(simulation=part))(after, action, np.zeros(WIND_SIZE), parameters)
    observed, _ = engines.observation_function()(after[:STATE_SIZE], parameters, np.zeros(POINT_SIZE))
    jacobian = ca.Function(
        "s", [flight, action], [ca.jacobian(observed[:REFERENCE_START], x) for x in (flight, action)]
    )
    by_flight, by_action = jacobian(begin, np.zeros(ACTION_SIZE))
    out = np.zeros((flight_size + ACTION_SIZE, size))
    out[: begin.size, :REFERENCE_START] = np.array(by_flight).T
    out[flight_size:, :REFERENCE_START] = np.array(by_action).T
    return torch.as_tensor(out, dtype=torch.float32)


def _gather(everything: Sequence[Any], name: str) -> Floats:
    """Return an attribute of all worlds, one below the other."""
    return np.concatenate([getattr(world, name) for world in everything])
