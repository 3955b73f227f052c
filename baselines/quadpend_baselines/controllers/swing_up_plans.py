"""The files of the planned swing-ups of the package, which `swing_up_planner` wrote, and what they were planned for."""

from pathlib import Path

from quadpend_gym import Simulation
from quadpend_gym.vehicles import VEHICLES

PLANS: dict[Path, Simulation] = {
    Path(__file__).with_name("swing_up.csv"): Simulation(),
    Path(__file__).with_name("swing_up_hummingbird.csv"): Simulation(VEHICLES["hummingbird"], "body_rates"),
}
