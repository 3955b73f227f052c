"""Ablations of the paper's controller: a table of the cases in which it fails and of remedies.

In every case the task is to hover at 100 Hz control rate, in 50 episodes of 10 s. The controller is the paper's: with
its misprints corrected or, if the name of the case says so, as printed or matched (`AdrcGains.mismatch` = 1). The cases
vary the control law, the observers, bandwidth and noise, the torque limit, and the wind.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from tqdm.auto import tqdm

from quadpend_baselines.controllers.adrc import ADRC
from quadpend_baselines.estimation.chains import AdrcMeasurement
from quadpend_baselines.estimation.observers import LUENBERGER_INPUT, chain, current_gain, input_gain
from quadpend_baselines.gains import ADRC_GAINS, AdrcGains, ObserverGains
from quadpend_baselines.policy.rollout import rollout
from quadpend_gym import Constant, OrnsteinUhlenbeck, QuadPendulumVectorEnv, Simulation, Sinusoid
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import COMMAND_TORQUE
from quadpend_gym.sensors import Noise
from quadpend_gym.tasks import EPISODE_STEPS
from quadpend_gym.vehicles import VEHICLES
from quadpend_gym.wrappers import VectorSensorWrapper

EPISODES, SEED = 50, 0
SETTLING_STEPS = EPISODE_STEPS // 2  # steps at the beginning of an episode that the settled RMSE leaves out
STEADY_FORCE = 0.1  # N
_ROLL_TORQUE, _PITCH_TORQUE = COMMAND_TORQUE, COMMAND_TORQUE + 1
_HEADER = (
    "group",
    "case",
    "survival (%)",
    "duration (s)",
    "settled RMSE (mm)",
    "offset (m/N)",
    "predicted offset (m/N)",
    "RMS torque (N·m)",
)
_PAPER, _MATCHED = ADRC_GAINS["paper"], ADRC_GAINS["matched"]


class PrintedADRC(ADRC):
    """ADRC with the control laws (51) and (52) as printed, valid at ψ = 0."""

    def command(self, measurement: AdrcMeasurement, estimate: Floats) -> Floats:
        """Return thrust and torques, shape (n, 4).

        The sign of v in τθ and the sign of τφ are wrong, as in the paper.
        """
        command = super().command(measurement, estimate)
        p = self.simulation.parameters
        feedforward = p.inertia_pitch / p.gravity * self.fourth_derivative(measurement)[:, 0]
        command[:, _PITCH_TORQUE] = 2.0 * feedforward - command[:, _PITCH_TORQUE]
        command[:, _ROLL_TORQUE] *= -1.0
        return command


@dataclass(frozen=True)
class AblationCase:
    """One case of the table.

    Attributes:
        group: Group of cases that vary the same thing.
        name: Name of the case.
        gains: Gains of the controller.
        controller: Class of the controller.
        wind: Wind model; None: calm air.
        noise: Standard deviation of white noise on the measured positions (m), angles (rad) and direction.
        torque_limit: Limit of the roll and pitch torques, N·m.
        start_offset: Offset of the start along x, m.
        plot_position: Position in the plots: x coordinate ``"x"``, colour ``"line"`` and line style ``"dash"``.
    """

    group: str
    name: str
    gains: AdrcGains = _PAPER
    controller: type[ADRC] = ADRC
    wind: Any = None
    noise: float = 0.0
    torque_limit: float = 5.0
    start_offset: float = 0.0
    plot_position: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class AblationResult:
    """Result of a case.

    Attributes:
        survival: Share of the episodes that reach their time limit of 10 s.
        duration: Mean duration of the episodes, s.
        rmse: Root mean square of the tracking error over the last 5 s of the surviving episodes, m; nan if none
            survives.
        offset_per_newton: Mean error along x per newton of steady wind, m/N; nan without steady wind.
        predicted_offset: The same error according to linear theory, m/N.
        rms_torque: Root mean square of the roll and pitch torques, N·m.
    """

    survival: float
    duration: float
    rmse: float
    offset_per_newton: float
    predicted_offset: float
    rms_torque: float


def _with_observers(gains: AdrcGains, observer: ObserverGains) -> AdrcGains:
    return replace(gains, luenberger=observer, horizontal=observer, vertical=observer)


def cases() -> Iterator[AblationCase]:
    """Yield all cases of the table."""
    steady = Constant((STEADY_FORCE, 0.0, 0.0))
    yield AblationCase("law", "as printed", controller=PrintedADRC, wind=steady)
    yield AblationCase("law", "corrected", wind=steady)
    yield AblationCase("law", "matched", _MATCHED, wind=steady)
    for name, switching, layer in (
        ("linear ESO", np.inf, None),
        ("DESO, saturation, ρ = 5e6", 5e6, None),
        ("DESO, sign, ρ = 1e3", 1e3, 0.0),
        ("DESO, sign, ρ = 1e5", 1e5, 0.0),
        ("DESO, sign, ρ = 5e6", 5e6, 0.0),
    ):
        gains = replace(_MATCHED, horizontal=ObserverGains(switching=switching, layer=layer))
        yield AblationCase("observer", f"matched, {name}", gains, wind=OrnsteinUhlenbeck(0.3))
    for noise in (0.0, 1e-4, 1e-3):
        for bandwidth in (500.0, 100.0, 50.0, 30.0, 15.0, 10.0):
            gains = _with_observers(_PAPER, ObserverGains(bandwidth))
            name = f"ω_n = {bandwidth:g} rad/s, noise {1e3 * noise:g} mm and mrad"
            yield AblationCase("noise", name, gains, noise=noise, plot_position={"x": bandwidth, "line": 1e3 * noise})
    for bandwidth in (7.0, 5.0):
        for torque in (2.0, 5.0, 10.0):
            for offset in (0.1, 0.2, 0.4, 0.8):
                gains = replace(_MATCHED, horizontal_bandwidth=bandwidth)
                name = f"matched, ω_nc = {bandwidth:g} rad/s, {torque:g} N·m, start {offset:g} m off"
                position = {"x": offset, "line": torque, "dash": bandwidth}
                yield AblationCase(
                    "torque limit", name, gains, torque_limit=torque, start_offset=offset, plot_position=position
                )
    strong = OrnsteinUhlenbeck(0.6)
    yield AblationCase("remedy", "matched, σ = 0.6 N, 10 N·m", _MATCHED, wind=strong, torque_limit=10.0)
    yield AblationCase(
        "remedy", "matched, σ = 0.6 N, ω_nc = 5 rad/s", replace(_MATCHED, horizontal_bandwidth=5.0), wind=strong
    )
    for label, gains in (("corrected", _PAPER), ("matched", _MATCHED)):
        for force in (0.15, 0.3, 0.6, 1.0):
            position = {"x": force, "line": gains.mismatch}
            yield AblationCase(
                "wind", f"{label}, σ = {force:g} N", gains, wind=OrnsteinUhlenbeck(force), plot_position=position
            )
        for frequency in (0.5, 1.0, 2.0, 4.0, 8.0):
            position = {"x": frequency, "line": gains.mismatch}
            wind = Sinusoid((0.3, 0.0, 0.0), frequency=frequency)
            yield AblationCase(
                "frequency", f"{label}, 0.3 N at {frequency:g} rad/s", gains, wind=wind, plot_position=position
            )


def predicted_offset(gains: AdrcGains, simulation: Simulation) -> float:
    """Return the steady error per newton of a constant force on the quadrotor (m/N) by linear theory.

    The corrected control law neglects w = −g d/(M l) in F⁽⁴⁾ = F₅ + w, both in its feedback and in the input of the
    Luenberger stage, whose error settles at x̃ = (I − L C)(Φ x̃ + Γ w). The offset is (k₄ w + k₀ x̃₁ + … + k₃ x̃₄)/k₀. The
    share of w that `AdrcGains.mismatch` feeds back is subtracted.
    """
    p, period = simulation.parameters, simulation.period
    w = p.gravity / (p.quadrotor_mass * p.rod_length) * (1.0 - gains.mismatch)
    correct = np.eye(4) - np.outer(current_gain(gains.luenberger, period), [1.0, 0.0, 0.0, 0.0])
    bias = np.linalg.solve(np.eye(4) - correct @ chain(period), correct @ input_gain(LUENBERGER_INPUT, period) * w)
    k = ADRC(gains, simulation).horizontal_gains
    return float((k[4] * w + k[:4] @ bias) / k[0])


def simulate(case: AblationCase) -> AblationResult:
    """Run the episodes of a case."""
    simulation = Simulation(vehicle=replace(VEHICLES["paper"], torque=(case.torque_limit, 1.0)))
    policy = case.controller(case.gains, simulation)
    env: VectorEnv[Any, Any, Any] = QuadPendulumVectorEnv(
        EPISODES, task="hover", vehicle=simulation.vehicle, wind=case.wind, autoreset_mode=AutoresetMode.SAME_STEP
    )
    if case.noise:
        env = VectorSensorWrapper(env, Noise(position=case.noise, euler=case.noise, direction=case.noise))
    options = {"state": {"position": (case.start_offset, 0.0, 2.0)}} if case.start_offset else None
    duration, survived = np.zeros(EPISODES), np.zeros(EPISODES, np.bool_)
    errors, torques = np.full((EPISODE_STEPS, EPISODES, 3), np.nan), []
    for index, step in enumerate(rollout(policy, env, SEED, options)):
        duration[step.active] += simulation.period
        torques.append(step.memory.command[step.active, _ROLL_TORQUE : _PITCH_TORQUE + 1] ** 2)
        errors[index, step.continuing] = step.tracking_error[step.continuing]
        survived |= step.survived
    settled = errors[SETTLING_STEPS:-1, survived]
    steady = isinstance(case.wind, Constant) and survived.any()
    return AblationResult(
        float(survived.mean()),
        float(duration.mean()),
        float(np.sqrt(np.mean(np.sum(settled**2, axis=-1)))) if survived.any() else np.nan,
        float(abs(settled[..., 0].mean()) / STEADY_FORCE) if steady else np.nan,
        predicted_offset(case.gains, simulation) if steady else np.nan,
        float(np.sqrt(np.mean(np.concatenate(torques)))),
    )


def run() -> list[tuple[AblationCase, AblationResult]]:
    """Run all cases and return them with their results."""
    return [(case, simulate(case)) for case in tqdm(list(cases()), unit="case", leave=False)]


def markdown(results: list[tuple[AblationCase, AblationResult]]) -> str:
    """Return the table as Markdown."""
    lines = [f"| {' | '.join(_HEADER)} |", "|---" * len(_HEADER) + "|"]
    for case, result in results:
        values = [
            f"{100.0 * result.survival:.0f}",
            f"{result.duration:.2f}",
            _number(1000.0 * result.rmse),
            _number(result.offset_per_newton),
            _number(result.predicted_offset),
            f"{result.rms_torque:.2f}",
        ]
        lines.append(f"| {case.group} | {case.name} | {' | '.join(values)} |")
    return "\n".join(lines) + "\n"


def _number(value: float) -> str:
    return "–" if np.isnan(value) else f"{value:.3g}" if abs(value) >= 5e-4 else "0"
