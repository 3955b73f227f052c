"""One episode of a policy, kept step by step to be looked at: by `watch` and by the page's replay."""

from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode

from baselines import Policy
from baselines.rollout import rollout
from quadpend_gym.arrays import Floats
from quadpend_gym.film import Snapshot
from quadpend_gym.kernel import DISTURBANCE_SIZE
from train.policies import estimated_disturbance, seated
from train.scenarios import Scenario


class Recording(NamedTuple):
    """What happened in an episode.

    Attributes:
        name: of the policy.
        snapshots: after each step but the last, T of them.
        estimate: the disturbance that the policy took each step for, laid out as ``info["disturbance"]``; nan where it
            estimates none; shape (T, 9).
        survived: whether the episode lasted its time.
    """

    name: str
    snapshots: tuple[Snapshot, ...]
    estimate: Floats
    survived: bool

    @property
    def error(self) -> Floats:
        """Norm of the tracking error, m, shape (T,)."""
        return np.array([seen.error for seen in self.snapshots])

    @property
    def disturbance(self) -> Floats:
        """The true one, shape (T, 9), see `Snapshot`."""
        return np.array([seen.disturbance for seen in self.snapshots])


def record(
    name: str, policy: Policy, scenario: Scenario, seed: int, options: dict[str, Any] | None = None
) -> Recording:
    """Fly the first episode of a seed, the same that row 0 of `train.flights.fly` meets.

    Args:
        name: of the policy.
        policy: anything that obeys the `predict` protocol.
        scenario: where it flies.
        seed: of the episode.
        options: of the environment's reset.
    """
    policy = seated(policy, scenario)
    env = scenario.make_vec(1, AutoresetMode.SAME_STEP, render_mode="rgb_array")
    film: Any = env.unwrapped.film  # type: ignore[attr-defined]
    snapshots, estimates, survived = [], [], False
    for step in rollout(policy, env, seed, options):
        survived = bool(step.survived[0])
        if step.going_on[0]:
            snapshots.append(film.snapshot())
            estimates.append(estimated_disturbance(policy, step.memory)[0])
    return Recording(name, tuple(snapshots), np.reshape(estimates, (len(estimates), DISTURBANCE_SIZE)), survived)
