"""The numerical experiment of the paper (Section 5), as far as the paper describes it, and its figures of merit.

The paper gives the parameters (Table 1) and the gains. It does not give the reference, the initial state, the gusts,
the switching gain or the integration step. This project chooses them such that the results resemble the paper's
figures: the reference is a helix with a slow oscillation in yaw, the initial state is not on the reference, and random
gusts begin after 10 s.
"""

from typing import Any

import numpy as np

from experiments.paper_continuous import ContinuousLoop, Trajectory
from quadpend_baselines.gains import tuning
from quadpend_baselines.policy.protocol import to_command
from quadpend_baselines.registry import controller_of
from quadpend_gym import PaperGusts, QuadPendulumEnv, Reference, Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.streams import WIND_STREAM, Streams
from quadpend_gym.physics.state import DISTURBANCE_SIZE, FORCE, TORQUE
from quadpend_gym.vehicles import CONTROL_PERIOD

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
CONTINUOUS_STEP = 4e-4  # s, small enough for ω_n = 500 rad/s
RECORDING_PERIOD = 0.01  # s
CHANNELS = ("F_x", "F_y", "z", "psi")  # m, m, m, rad
_TOLERANCES = (1e-2, 1e-3, 1e-4)  # ε of (8)–(11), m and rad
_CONVERGED = 6.0  # s, after which the initial error has decayed
GUST_COLUMNS = (FORCE, FORCE + 1, FORCE + 2, TORQUE + 2)  # nonzero disturbances in gusts: N, N, N, N·m


def run() -> dict[str, Trajectory]:
    """Simulate the experiment in continuous time, at 1 kHz and at 100 Hz."""
    steps = round(DURATION / CONTINUOUS_STEP)
    times: Floats = 0.5 * CONTINUOUS_STEP * np.arange(2 * steps + 1, dtype=np.float64)
    loop = ContinuousLoop(controller_of("adrc-paper", tuning("adrc-paper").gains))
    every = round(RECORDING_PERIOD / CONTINUOUS_STEP)
    return {
        "continuous": loop.simulate(start_state(), REFERENCE, gusts(times), CONTINUOUS_STEP, every),
        "1 kHz": simulate_sampled(1e-3),
        "100 Hz": simulate_sampled(CONTROL_PERIOD),
    }


def start_state() -> Floats:
    """Return the start as a state array, shape (18,)."""
    return np.concatenate([np.asarray(value, np.float64) for value in START.values()])


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
            records.append((i * period, state, to_command(action[np.newaxis], simulation)[0], estimate))
        if terminated:
            break
    times, states, commands, estimates = (np.array(part) for part in zip(*records, strict=True))
    return Trajectory(times, states, REFERENCE.derivatives(times), commands, gusts(times), estimates)


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
