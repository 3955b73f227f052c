"""When the paper's controller fails, and what cures it: one table.

Every case hovers in the environment at 100 Hz, 50 episodes of 10 s, under the paper's law with its misprints corrected
or, where the row says so, the matched one, and varies the law, the observers, bandwidth and noise, authority, wind.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from tqdm.auto import tqdm

from quadpend_baselines.controllers.adrc import ADRC, AdrcMeasurement
from quadpend_baselines.estimation.observers import LUENBERGER_INPUT, chain, current_gain, input_gain
from quadpend_baselines.gains import ADRC_GAINS, AdrcGains, ObserverGains
from quadpend_baselines.policy.rollout import rollout
from quadpend_gym import Actuators, Constant, OrnsteinUhlenbeck, QuadPendulumVectorEnv, Simulation, Sinusoid
from quadpend_gym.core.arrays import Floats
from quadpend_gym.sensors import Noise
from quadpend_gym.wrappers import VectorSensorWrapper

EPISODES, SEED, STEPS, SETTLED = 50, 0, 1000, 500
STEADY = 0.1  # N
_PAPER, _MATCHED = ADRC_GAINS["paper"], ADRC_GAINS["matched"]


class PrintedADRC(ADRC):
    """The laws (51) and (52) with their printed signs; at ψ = 0."""

    def command(self, measurement: AdrcMeasurement, estimate: Floats) -> Floats:
        """Thrust and torques, shape (n, 4): τθ has +A v for −A v, and τφ is the negative of the right one."""
        command = super().command(measurement, estimate)
        p = self.simulation.parameters
        feedforward = p.inertia_pitch / p.gravity * self.fourth_derivative(measurement)[:, 0]
        command[:, 2] = 2.0 * feedforward - command[:, 2]
        command[:, 1] *= -1.0
        return command


@dataclass(frozen=True)
class AblationCase:
    """One row of the table."""

    group: str
    name: str
    gains: AdrcGains = _PAPER
    controller: type[ADRC] = ADRC
    wind: Any = None
    noise: float = 0.0  # m and rad, standard deviation of white noise on what is measurement
    torque: float = 5.0  # N·m, limit of roll and pitch
    offset: float = 0.0  # m, of the start along x
    place: dict[str, float] = field(default_factory=dict)  # where the plots draw it


@dataclass(frozen=True)
class AblationResult:
    """What a case did.

    Attributes:
        survival: share of the episodes that lasted 10 s.
        seconds: survived, mean.
        rmse: of the tracking error over the last 5 s of surviving episodes, m; nan if none.
        offset_per_newton: mean error along x per newton of steady wind, m/N; nan without such wind.
        predicted_offset: the same by linear theory.
        torque: root mean square of the roll and pitch torques, N·m.
    """

    survival: float
    seconds: float
    rmse: float
    offset_per_newton: float
    predicted_offset: float
    torque: float


def _observers(gains: AdrcGains, observer: ObserverGains) -> AdrcGains:
    return replace(gains, luenberger=observer, horizontal=observer, vertical=observer)


def cases() -> Iterator[AblationCase]:
    """All rows of the table."""
    steady = Constant((STEADY, 0.0, 0.0))
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
            gains = _observers(_PAPER, ObserverGains(bandwidth))
            name = f"ω_n = {bandwidth:g} rad/s, noise {1e3 * noise:g} mm and mrad"
            yield AblationCase("noise", name, gains, noise=noise, place={"x": bandwidth, "line": 1e3 * noise})
    for bandwidth in (7.0, 5.0):
        for torque in (2.0, 5.0, 10.0):
            for offset in (0.1, 0.2, 0.4, 0.8):
                gains = replace(_MATCHED, horizontal_bandwidth=bandwidth)
                name = f"matched, ω_nc = {bandwidth:g} rad/s, {torque:g} N·m, start {offset:g} m off"
                place = {"x": offset, "line": torque, "dash": bandwidth}
                yield AblationCase("authority", name, gains, torque=torque, offset=offset, place=place)
    strong = OrnsteinUhlenbeck(0.6)
    yield AblationCase("cure", "matched, σ = 0.6 N, 10 N·m", _MATCHED, wind=strong, torque=10.0)
    yield AblationCase(
        "cure", "matched, σ = 0.6 N, ω_nc = 5 rad/s", replace(_MATCHED, horizontal_bandwidth=5.0), wind=strong
    )
    for label, gains in (("corrected", _PAPER), ("matched", _MATCHED)):
        for force in (0.15, 0.3, 0.6, 1.0):
            place = {"x": force, "line": gains.mismatch}
            yield AblationCase("wind", f"{label}, σ = {force:g} N", gains, wind=OrnsteinUhlenbeck(force), place=place)
        for frequency in (0.5, 1.0, 2.0, 4.0, 8.0):
            place = {"x": frequency, "line": gains.mismatch}
            wind = Sinusoid((0.3, 0.0, 0.0), frequency=frequency)
            yield AblationCase("frequency", f"{label}, 0.3 N at {frequency:g} rad/s", gains, wind=wind, place=place)


def predicted_offset(gains: AdrcGains, simulation: Simulation) -> float:
    """Steady error per newton of a constant force on the quadrotor (m/N), from linear theory.

    The corrected law overlooks w = −g d/(M l) in F⁽⁴⁾ = F₅ + w, in its feedback and as the input of the Luenberger
    stage, whose error settles at x̃ = (I − L C)(Φ x̃ + Γ w): the offset is (k₄ w + k₀ x̃₁ + … + k₃ x̃₄)/k₀, and what the
    mismatch share feeds back of w goes off it.
    """
    p, period = simulation.parameters, simulation.period
    w = p.gravity / (p.quadrotor_mass * p.rod_length) * (1.0 - gains.mismatch)
    correct = np.eye(4) - np.outer(current_gain(gains.luenberger, period), [1.0, 0.0, 0.0, 0.0])
    bias = np.linalg.solve(np.eye(4) - correct @ chain(period), correct @ input_gain(LUENBERGER_INPUT, period) * w)
    k = ADRC(gains, simulation).horizontal_gains
    return float((k[4] * w + k[:4] @ bias) / k[0])


def simulate(case: AblationCase) -> AblationResult:
    """Hover 50 episodes."""
    simulation = Simulation(actuators=Actuators(roll_pitch_torque=case.torque))
    policy = case.controller(case.gains, simulation)
    env: VectorEnv[Any, Any, Any] = QuadPendulumVectorEnv(
        EPISODES, "hover", simulation, case.wind, autoreset_mode=AutoresetMode.SAME_STEP, max_episode_steps=STEPS
    )
    if case.noise:
        env = VectorSensorWrapper(env, Noise(position=case.noise, euler=case.noise, direction=case.noise))
    options = {"state": {"position": (case.offset, 0.0, 2.0)}} if case.offset else None
    seconds, survived = np.zeros(EPISODES), np.zeros(EPISODES, np.bool_)
    errors, torques = np.full((STEPS, EPISODES, 3), np.nan), []
    for number, step in enumerate(rollout(policy, env, SEED, options)):
        seconds[step.active] += simulation.period
        torques.append(step.memory.command[step.active, 1:3] ** 2)
        errors[number, step.continuing] = step.tracking_error[step.continuing]
        survived |= step.survived
    late = errors[SETTLED:-1, survived]
    steady = isinstance(case.wind, Constant) and survived.any()
    return AblationResult(
        float(survived.mean()),
        float(seconds.mean()),
        float(np.sqrt(np.mean(np.sum(late**2, axis=-1)))) if survived.any() else np.nan,
        float(abs(late[..., 0].mean()) / STEADY) if steady else np.nan,
        predicted_offset(case.gains, simulation) if steady else np.nan,
        float(np.sqrt(np.mean(np.concatenate(torques)))),
    )


def run() -> list[tuple[AblationCase, AblationResult]]:
    """Every case and what it did."""
    return [(case, simulate(case)) for case in tqdm(list(cases()), unit="case", leave=False)]


def markdown(results: list[tuple[AblationCase, AblationResult]]) -> str:
    """The table."""
    header = "| group | case | survival (%) | seconds | settled RMSE (mm) | offset (m/N) | predicted | torque (N·m) |"
    lines = [header, "|---|---|---|---|---|---|---|---|"]
    for case, result in results:
        figures = [
            f"{100.0 * result.survival:.0f}",
            f"{result.seconds:.2f}",
            _figure(1000.0 * result.rmse),
            _figure(result.offset_per_newton),
            _figure(result.predicted_offset),
            f"{result.torque:.2f}",
        ]
        lines.append(f"| {case.group} | {case.name} | {' | '.join(figures)} |")
    return "\n".join(lines) + "\n"


def _figure(value: float) -> str:
    return "–" if np.isnan(value) else f"{value:.3g}" if abs(value) >= 5e-4 else "0"
