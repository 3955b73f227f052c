"""docs/paper/ablations.md and .png: when the paper's controller fails, and which changes prevent it.

In every case the task is to hover at 100 Hz control rate, in 50 episodes of 10 s. The controller is the paper's: with
its misprints corrected or, if the name of the case says so, as printed or matched (`AdrcGains.mismatch` = 1).

    python -m experiments.paper_ablations docs/paper
"""

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from quadpend_baselines.controllers.adrc import ADRC, COMMAND, OBSERVED, PLANT
from quadpend_baselines.estimation.observers import LUENBERGER_INPUT, chain, current_gain, input_gain
from quadpend_baselines.gains import ADRC_GAINS, AdrcGains, ObserverGains
from quadpend_baselines.policy.rollout import rollout
from quadpend_gym import Constant, OrnsteinUhlenbeck, QuadPendulumVectorEnv, Simulation, Sinusoid, read_observation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import COMMAND_TORQUE
from quadpend_gym.sensors import Noise
from quadpend_gym.vehicles import VEHICLES
from quadpend_gym.wrappers import VectorSensorWrapper
from quadpend_train.evaluation.formatting import markdown_table

EPISODES, SEED, STEPS = 50, 0, 1000
STEADY_FORCE = 0.1  # N
COLOURS = ("#0072B2", "#D55E00", "#009E73")
PAPER, MATCHED = ADRC_GAINS["paper"], ADRC_GAINS["matched"]
COLUMNS = {
    "survival (%)": "{:.0f}",
    "duration (s)": "{:.2f}",
    "settled RMSE (mm)": "{:.3g}",
    "offset (m/N)": "{:.3g}",
    "predicted offset (m/N)": "{:.3g}",
    "RMS torque (N·m)": "{:.2f}",
}


class PrintedADRC(ADRC):
    """ADRC with the laws (51) and (52) as printed, valid at ψ = 0: the signs of v in τθ and of τφ are wrong."""

    def command(self, *given: Any) -> Floats:
        """Return thrust and torques, shape (n, 4)."""
        command, p = super().command(*given), self.simulation.parameters
        observed = given[2][:, OBSERVED:PLANT]
        pendulum = read_observation(observed, "direction")[:, 0]
        pitch = read_observation(observed, "attitude")[:, 1]
        feedforward = p.inertia_pitch * p.chain_stiffness * (pendulum - pitch)
        command[:, COMMAND_TORQUE + 1] = 2.0 * feedforward - command[:, COMMAND_TORQUE + 1]
        command[:, COMMAND_TORQUE] *= -1.0
        return command


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


@dataclass(frozen=True)
class Case:
    """One case; `x`, `line` and `dash` are its position in the plots: coordinate, colour and line style."""

    group: str
    name: str
    gains: AdrcGains = PAPER
    controller: type[ADRC] = ADRC
    wind: Any = None
    noise: float = 0.0  # white noise on positions (m), angles (rad) and direction
    torque: float = 5.0  # N·m, limit of roll and pitch torque
    offset: float = 0.0  # m, of the start along x
    x: float = np.nan
    line: float = np.nan
    dash: float = 0.0


def cases() -> Iterator[Case]:
    """Yield all cases of the table."""
    steady = Constant((STEADY_FORCE, 0.0, 0.0))
    yield Case("law", "as printed", controller=PrintedADRC, wind=steady)
    yield Case("law", "corrected", wind=steady)
    yield Case("law", "matched", MATCHED, wind=steady)
    for name, switching, layer in (
        ("linear ESO", None, None),
        ("DESO, saturation, ρ = 5e6", 5e6, None),
        *((f"DESO, sign, ρ = {rho}", float(rho), 0.0) for rho in ("1e3", "1e5", "5e6")),
    ):
        gains = replace(MATCHED, horizontal=ObserverGains(switching=switching, layer=layer))
        yield Case("observer", f"matched, {name}", gains, wind=OrnsteinUhlenbeck(0.3))
    for noise, w in product((0.0, 1e-4, 1e-3), (500.0, 100.0, 50.0, 30.0, 15.0, 10.0)):
        observer = ObserverGains(w)
        gains = replace(PAPER, luenberger=observer, horizontal=observer, vertical=observer)
        name = f"ω_n = {w:g} rad/s, noise {1e3 * noise:g} mm and mrad"
        yield Case("noise", name, gains, noise=noise, x=w, line=1e3 * noise)
    for w, torque, off in product((7.0, 5.0), (2.0, 5.0, 10.0), (0.1, 0.2, 0.4, 0.8)):
        gains = replace(MATCHED, horizontal_bandwidth=w)
        name = f"matched, ω_nc = {w:g} rad/s, {torque:g} N·m, start {off:g} m off"
        yield Case("torque limit", name, gains, torque=torque, offset=off, x=off, line=torque, dash=w)
    yield Case("remedy", "matched, σ = 0.6 N, 10 N·m", MATCHED, wind=OrnsteinUhlenbeck(0.6), torque=10.0)
    slow = replace(MATCHED, horizontal_bandwidth=5.0)
    yield Case("remedy", "matched, σ = 0.6 N, ω_nc = 5 rad/s", slow, wind=OrnsteinUhlenbeck(0.6))
    for label, gains in (("corrected", PAPER), ("matched", MATCHED)):
        for force in (0.15, 0.3, 0.6, 1.0):
            wind: Any = OrnsteinUhlenbeck(force)
            yield Case("wind", f"{label}, σ = {force:g} N", gains, wind=wind, x=force, line=gains.mismatch)
        for w in (0.5, 1.0, 2.0, 4.0, 8.0):
            wind = Sinusoid((0.3, 0.0, 0.0), frequency=w)
            yield Case("frequency", f"{label}, 0.3 N at {w:g} rad/s", gains, wind=wind, x=w, line=gains.mismatch)


def simulate(case: Case, steps: int = STEPS, settling: int = STEPS // 2) -> dict[str, Any]:
    """Return the row of a case; the settled RMSE is that of the surviving episodes after `settling` steps."""
    simulation = Simulation(vehicle=replace(VEHICLES["paper"], torque=(case.torque, 1.0)))
    parts: dict[str, Any] = {"task": "hover", "vehicle": simulation.vehicle, "wind": case.wind}
    env: Any = QuadPendulumVectorEnv(EPISODES, max_episode_steps=steps, autoreset_mode="SameStep", **parts)
    if case.noise:
        env = VectorSensorWrapper(env, Noise(position=case.noise, euler=case.noise, direction=case.noise))
    options = {"state": {"position": (case.offset, 0.0, 2.0)}} if case.offset else None
    duration, survived, torques = np.zeros(EPISODES), np.zeros(EPISODES, np.bool_), []
    errors = np.full((steps, EPISODES, 3), np.nan)
    for index, step in enumerate(rollout(case.controller(case.gains, simulation), env, SEED, options)):
        duration[step.active] += simulation.period
        torques.append(step.memory[step.active, COMMAND + 1 : COMMAND + 3] ** 2)
        going = step.active & ~(step.terminated | step.truncated)
        errors[index, going] = step.tracking_error[going]
        survived |= step.survived
    settled = errors[settling:-1, survived]
    steady = isinstance(case.wind, Constant) and survived.any()
    values = (
        100.0 * survived.mean(),
        duration.mean(),
        1000.0 * np.sqrt(np.mean(np.sum(settled**2, axis=-1))) if survived.any() else np.nan,
        abs(settled[..., 0].mean()) / STEADY_FORCE if steady else np.nan,
        predicted_offset(case.gains, simulation) if steady else np.nan,
        np.sqrt(np.mean(np.concatenate(torques))),
    )
    return {**vars(case), **dict(zip(COLUMNS, map(float, values), strict=True))}


def markdown(table: pd.DataFrame) -> str:
    """Return the table as Markdown."""
    rows = []
    for row in table.to_dict("records"):
        cells = [form.format(row[column]) for column, form in COLUMNS.items()]
        cells = ["–" if cell == "nan" else "0" if abs(float(cell)) < 5e-4 else cell for cell in cells]
        rows.append([row["group"], row["name"], *cells])
    return markdown_table(["group", "case", *COLUMNS], rows) + "\n"


def draw(table: pd.DataFrame, path: Path) -> None:
    """Draw survival and settled RMSE of the cases."""
    figure = Figure(figsize=(8.5, 6.0), layout="constrained")
    panels: Any = (
        ("noise", "survival (%)", "noise {0:g} mm, mrad", "$ω_n$ of the observers (rad/s)", {"xscale": "log"}),
        ("torque limit", "survival (%)", "$ω_{{nc}}$ = {1:g}, {0:g} N·m", "offset of the start (m)", {}),
        ("wind", "settled RMSE (mm)", "mismatch share {0:g}", "fluctuating wind, σ (N)", {"yscale": "log"}),
        ("frequency", "settled RMSE (mm)", "mismatch share {0:g}", "force of 0.3 N, ω (rad/s)", {"yscale": "log"}),
    )
    for axis, (group, metric, label, x, scales) in zip(figure.subplots(2, 2).ravel(), panels, strict=True):
        chosen = table[table.group == group].sort_values("x")
        colours, dashes = sorted(chosen.line.unique()), sorted(chosen.dash.unique())
        for (line, dash), points in chosen.groupby(["line", "dash"]):
            i, style = colours.index(line), "-" if dash == dashes[0] else "--"
            axis.plot(points.x, points[metric], "os^"[i] + style, color=COLOURS[i], label=label.format(line, dash))
        axis.set(xlabel=x, ylabel=metric, title=group, **scales)
        axis.grid(alpha=0.3)
        axis.legend(frameon=False, fontsize=7)
    figure.suptitle(f"Failures and remedies: every point is the result of {EPISODES} episodes of 10 s", fontsize=10)
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    results = pd.DataFrame([simulate(case) for case in cases()])
    (Path(sys.argv[1]) / "ablations.md").write_text(markdown(results), encoding="utf-8")
    draw(results, Path(sys.argv[1]) / "ablations.png")
