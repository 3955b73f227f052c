"""The front of linear control: the smallest error of LQG designs for each delay margin, in the linear model.

    python -m experiments.lqg_front      # docs/flight/lqg_front.csv; 15 minutes; needs the extras mpc and control

The designs are those of the controller `lqg`. A search varies its effort and the noise levels of its Kalman filter, and
minimises the stationary error as a multiple of the linear reference, in hover in a fluctuating force, with the delays
and the noise of a motion capture. The margin is that beyond the known latency. The limits of the thrusts, which the
vehicle has, do not count here. The best design for each margin then flies in `flight_breeze`, as the policies of the
benchmark do: `flown` is its error as a multiple of the reference, `extra_delay` the delay that it tolerates.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import differential_evolution

from experiments.measures import delay_budget
from experiments.pages import DOCS
from quadpend_baselines.controllers.lqg import Lqg
from quadpend_baselines.controllers.output_feedback import OutputFeedback
from quadpend_baselines.gains import gains_for
from quadpend_baselines.modelling.linear_loop import linear_policy, margins, vehicle_model
from quadpend_baselines.modelling.linear_reference import linear_reference, stationary_error
from quadpend_gym.core.nested import changed
from quadpend_gym.scenarios import SCENARIOS, Scenario
from quadpend_gym.sensors import Noise
from quadpend_gym.tasks.observation import OUTPUT_FEEDBACK
from quadpend_gym.tasks.task import TASKS
from quadpend_gym.vehicles import VEHICLES
from quadpend_gym.wind import OrnsteinUhlenbeck
from quadpend_train.evaluation.episodes import TEST_SEED, run_episodes
from quadpend_train.evaluation.linear_models import reference
from quadpend_train.evaluation.ranking import multiple, survivors

HOVER = Scenario(
    task=TASKS["hover"],
    vehicle=VEHICLES["hummingbird"],
    interface="body_rates",
    latency=0.02,
    wind=OrnsteinUhlenbeck(force=0.12),
    sensors=Noise(position=0.0005, euler=0.001, direction=0.0006),
    observation=OUTPUT_FEEDBACK,
)
PATH = DOCS / "flight/lqg_front.csv"
MARGINS = (0.005, 0.01, 0.015, 0.02, 0.025)  # s
RANGES = {
    "effort": (3e-3, 0.5),
    "estimator.force_walk": (0.05, 2.0),
    "estimator.bob_force_walk": (1e-5, 0.03),
    "estimator.torque_noise": (1e-4, 0.03),
}


def design(values: dict[str, float]) -> OutputFeedback:
    """Return `lqg` with the gains `values`, and without an estimate of the mass."""
    gains = changed(gains_for("lqg", HOVER.simulation), values | {"estimator.mass_time": 0.0})
    return OutputFeedback(Lqg, gains)


def flown(row: Any) -> tuple[float, float]:
    """Return the error of a design in `flight_breeze`, as a multiple of the reference, and its extra delay, s."""
    scenario, policy = SCENARIOS["flight_breeze"], design({name: row[name] for name in RANGES})
    found = run_episodes([policy.adapt(scenario)], scenario, 200, TEST_SEED)
    error = multiple([survivors(found._asdict())], [reference(scenario)[0]]).value
    return error, delay_budget(policy, scenario, 100, TEST_SEED)


class Front:
    """The evaluated designs, and the best one for each margin."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario, self.vehicle, self.reference = scenario, vehicle_model(scenario), linear_reference(scenario)
        self.rows: list[dict[str, float]] = []

    def evaluate(self, values: dict[str, float]) -> dict[str, float]:
        """Return error (m and multiple) and margin (s) of the gains in which `values` are replaced."""
        policy = linear_policy(design(values).adapt(self.scenario), self.scenario)
        error, margin = stationary_error(self.scenario, policy), margins(self.vehicle, policy)
        row = {"delay_margin": margin.delay, "error": error, "multiple": error / self.reference}
        self.rows.append({**row, "sensitivity": margin.sensitivity, **values})
        return self.rows[-1]

    def search(self, margin: float, trials: int) -> None:
        """Evaluate about `trials` designs, most of them with about this margin, s."""

        def cost(logarithms: Any) -> float:
            row = self.evaluate(dict(zip(RANGES, np.exp(logarithms).tolist(), strict=True)))
            return row["multiple"] * (1.0 + 10.0 * max(0.0, 1.0 - row["delay_margin"] / margin))

        bounds, rounds = np.log(list(RANGES.values())).tolist(), trials // (5 * len(RANGES)) - 1
        differential_evolution(cost, bounds, popsize=5, maxiter=rounds, polish=False, tol=0.0, seed=0)

    def best(self) -> pd.DataFrame:
        """Return the design with the smallest error for each margin."""
        table = pd.DataFrame(self.rows)
        found = [table[table.delay_margin >= margin].nsmallest(1, "error") for margin in MARGINS]
        return pd.concat(found).assign(required_margin=MARGINS, reference=self.reference)


def main() -> None:
    """Search, and write the front."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=PATH)
    parser.add_argument("--trials", type=int, default=200, help="designs for each margin")
    given, front = parser.parse_args(), Front(HOVER)
    for margin in MARGINS:
        front.search(margin, given.trials)
    table = front.best().drop_duplicates("error")
    table["flown"], table["extra_delay"] = zip(*(flown(row) for _, row in table.iterrows()), strict=True)
    given.out.parent.mkdir(parents=True, exist_ok=True)
    table.to_csv(given.out, index=False)


if __name__ == "__main__":
    main()
