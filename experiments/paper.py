"""docs/paper/merit.json: the numerical experiment of the paper (Section 5), as far as the paper describes it.

    python -m experiments.paper

The paper gives the parameters (Table 1) and the gains. It does not give the reference, the initial state, the gusts,
the switching gain or the integration step. This project chooses them such that the results resemble the paper's
figures: the reference is a helix with a slow oscillation in yaw, the initial state is not on the reference, and random
gusts begin after 10 s.
"""

import argparse
import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from experiments.pages import DOCS
from quadpend_baselines.gains import tuning
from quadpend_baselines.registry import controller_of
from quadpend_gym import PAPER, PaperGusts, QuadPendulumEnv, Reference, Simulation, State
from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.streams import WIND_STREAM, Streams
from quadpend_gym.physics.state import DISTURBANCE_SIZE, FORCE, TORQUE
from quadpend_gym.vehicles import CONTROL_PERIOD
from quadpend_train.common.files import write_text

DURATION = 20.0  # s
REFERENCE = Reference(
    offset=(0.0, 0.0, 1.0, 0.0),
    rate=(0.0, 0.0, 0.05, 0.0),
    amplitude=(1.0, 1.0, 0.0, 0.1),
    frequency=(0.5, 0.5, 0.0, 0.5),
    phase=(np.pi / 2, 0.0, 0.0, 0.0),
)
START = {
    "position": (1.05, -0.05, 0.9),  # m; the reference starts at (1, 0, 1)
    "velocity": (0.0, 0.5, 0.05),  # m/s, that of the reference
    "euler": (0.0, 0.0, 0.2),  # rad
    "euler_rate": (0.0, 0.0, 0.0),
    "direction": (0.0, 0.0, 1.0),
    "direction_rate": (0.0, 0.0, 0.0),
}
GUSTS = PaperGusts(force=0.2, yaw_torque=0.05, onset=10.0, hold=1.0)
SEED = 0
RECORDING_PERIOD = 0.01  # s
CHANNELS = ("F_x", "F_y", "z", "psi")  # m, m, m, rad
_TOLERANCES = (1e-2, 1e-3, 1e-4)  # ε of (8)–(11), m and rad
_CONVERGED = 6.0  # s, after which the initial error has decayed
GUST_COLUMNS = (FORCE, FORCE + 1, FORCE + 2, TORQUE + 2)  # nonzero disturbances in gusts: N, N, N, N·m


@dataclass(frozen=True)
class Trajectory:
    """A trajectory at m times."""

    time: Floats  # s, shape (m,)
    state: Floats  # see `quadpend_gym.physics.state`, shape (m, 18)
    reference: Floats  # derivatives of order 0 to 6 of F_x, F_y, z and ψ, shape (m, 7, 4)
    disturbance: Floats  # the true disturbance, N and N·m, in the layout of `Disturbance`, shape (m, 9)
    estimate: Floats  # the disturbance that the observers estimate, shape (m, 9)

    @property
    def error(self) -> Floats:
        """Tracking errors of F_x, F_y, z (m) and ψ (rad), shape (m, 4)."""
        s = State(self.state)
        bob = s.position + PAPER.rod_length * s.direction
        outputs = np.column_stack([bob[:, :2], s.position[:, 2], s.euler[:, 2]])
        return np.asarray(outputs - self.reference[:, 0])


def gusts(times: Floats) -> Floats:
    """Return the gusts (N, N·m), shape (n, 9), at times (s) as the environment samples them for the seed `SEED`."""
    key = Streams.from_seeds([SEED]).derive(0).derive(WIND_STREAM).derive(0).keys
    out = np.zeros((times.size, DISTURBANCE_SIZE))
    # `sample` evaluates the gusts at the time (step + ½) · period. With a period of 1 s, step = t − ½ gives time t.
    steps: Any = times - 0.5
    GUSTS.sample(out, np.empty((times.size, 0)), steps, 1.0, Streams(np.full(times.size, key[0])))
    return out


def simulate_sampled(period: float, duration: float = DURATION) -> Trajectory:
    """Simulate the sampled controller in the environment, with single-precision observations."""
    simulation = Simulation(period=period, substeps=max(1, round(2 * period / CONTROL_PERIOD)))
    policy: Any = controller_of("adrc-paper", tuning("adrc-paper").gains, simulation)
    env = QuadPendulumEnv(period=period, substeps=simulation.substeps, duration=2.0 * duration, wind=GUSTS)
    observation, _ = env.reset(seed=SEED, options={"state": START, "reference": REFERENCE})
    every = round(RECORDING_PERIOD / period)
    memory, records = None, []
    for i in range(round(duration / period) + 1):
        state = env.state.array.copy()
        action, memory = policy.predict(observation, memory)
        estimate = policy.estimated_disturbance(memory)[0]
        observation, _, terminated, _, _ = env.step(action)
        if i % every == 0:
            records.append((i * period, state, estimate))
        if terminated:
            break
    times, states, estimates = (np.array(part) for part in zip(*records, strict=True))
    return Trajectory(times, states, REFERENCE.derivatives(times), gusts(times), estimates)


def figures_of_merit(trajectory: Trajectory) -> dict[str, Any]:
    """Return the paper's criteria (8)–(11), errors and the accuracy of the estimates, by channel, in SI units."""
    before = trajectory.time < GUSTS.onset
    calm, windy = before & (trajectory.time >= _CONVERGED), trajectory.time >= GUSTS.onset + GUSTS.hold
    error = np.abs(trajectory.error)
    true, estimate = (d[windy][:, GUST_COLUMNS] for d in (trajectory.disturbance, trajectory.estimate))
    correlation = [float(np.corrcoef(*pair)[0, 1]) for pair in zip(true.T, estimate.T, strict=True)]

    def by_channel(values: Any) -> dict[str, Any]:
        return dict(zip(CHANNELS, np.asarray(values).tolist(), strict=True))

    return {
        "largest_error_in_calm_air": by_channel(error[calm].max(axis=0)),
        "rmse_in_gusts": by_channel(np.sqrt(np.mean(error[windy] ** 2, axis=0))),
        "convergence_time": {
            f"{limit:g}": by_channel([_convergence_time(trajectory.time, e, limit) for e in error[before].T])
            for limit in _TOLERANCES
        },
        "rmse_of_estimates": by_channel(np.sqrt(np.mean((true - estimate) ** 2, axis=0))),
        "correlation_of_estimates": by_channel(correlation),
    }


def _convergence_time(time: Floats, error: Floats, tolerance: float) -> float | None:
    """Return T₀ of (8)–(11), s: the error stays within `tolerance` from T₀ until the gusts; None if it does not."""
    first = int(np.append(np.flatnonzero(error > tolerance), -1).max()) + 1
    return float(time[first]) if first < error.size else None


def main() -> None:
    """Simulate at 1 kHz and at 100 Hz, and write the figures of merit."""
    argparse.ArgumentParser(prog="python -m experiments.paper", description=__doc__).parse_args()
    periods = {"1 kHz": 1e-3, "100 Hz": CONTROL_PERIOD}
    merit = {name: figures_of_merit(simulate_sampled(period)) for name, period in periods.items()}
    write_text(DOCS / "paper/merit.json", json.dumps(merit, indent=1, allow_nan=False) + "\n")


if __name__ == "__main__":
    main()
