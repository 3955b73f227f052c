"""Scenarios: which environment, in which wind. Frozen data, so that a name means the same flight everywhere."""

from dataclasses import dataclass
from typing import Any

import gymnasium as gym
from gymnasium.vector import AutoresetMode, VectorEnv

from quadpend_gym import Constant, OrnsteinUhlenbeck, PaperGusts


@dataclass(frozen=True)
class Scenario:
    """An environment and the wind in it."""

    description: str
    env_id: str = "QuadPendulum-v0"
    wind: Any = None  # as the keyword of `gymnasium.make`

    def make_vec(self, num_envs: int, autoreset_mode: AutoresetMode) -> VectorEnv[Any, Any, Any]:
        """The scenario as a vector environment."""
        return gym.make_vec(
            f"quadpend_gym:{self.env_id}", num_envs=num_envs, wind=self.wind, autoreset_mode=autoreset_mode
        )


SCENARIOS = {
    "calm": Scenario("no wind"),
    "breeze": Scenario("fluctuating force, 0.15 N on each axis of the quadrotor", wind=OrnsteinUhlenbeck(0.15)),
    "windy": Scenario("fluctuating force, 0.3 N on each axis of the quadrotor", wind=OrnsteinUhlenbeck(0.3)),
    "steady": Scenario("0.3 N along x on the quadrotor", wind=Constant((0.3, 0.0, 0.0))),
    "gusts": Scenario("the paper's random gusts, setting in after 2 s", wind=PaperGusts(onset=2.0)),
    "hover": Scenario("hover in calm air", env_id="QuadPendulumHover-v0"),
    "hover_windy": Scenario("hover in a fluctuating 0.3 N", "QuadPendulumHover-v0", OrnsteinUhlenbeck(0.3)),
}


def find_scenario(name: str) -> Scenario:
    """The scenario of that name.

    Raises:
        ValueError: there is none.
    """
    if name not in SCENARIOS:
        raise ValueError(f"there is no scenario {name!r}; the scenarios are {', '.join(SCENARIOS)}")
    return SCENARIOS[name]
