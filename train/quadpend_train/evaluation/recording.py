"""One episode of a policy, kept step by step to be looked at: by `watch` and by the page's replay."""

from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode

from quadpend_baselines import Policy
from quadpend_baselines.policy.rollout import rollout
from quadpend_gym.core.arrays import Floats, Floats32
from quadpend_gym.envs.recorder import Recorder
from quadpend_gym.envs.world import World
from quadpend_gym.viewer.snapshot import Snapshot
from quadpend_train.policies.adaptation import adapt_policy, estimated_disturbance
from quadpend_train.scenarios import Scenario


class Recording(NamedTuple):
    """What happened in an episode of T steps.

    Attributes:
        name: of the policy.
        snapshots: after each step.
        estimate: the disturbance that the policy took each step for, laid out as ``info["disturbance"]``; nan where it
            estimates none; shape (T, 9).
        survived: whether the episode lasted its time.
    """

    name: str
    snapshots: tuple[Snapshot, ...]
    estimate: Floats
    survived: bool

    @property
    def fell_at(self) -> float | None:
        """When the episode ended early, s; None if it did not."""
        return None if self.survived else self.snapshots[-1].time

    @property
    def error(self) -> Floats:
        """Norm of the tracking error, m, shape (T,)."""
        return np.array([seen.error for seen in self.snapshots])

    @property
    def disturbance(self) -> Floats:
        """The true one, shape (T, 9), see `Snapshot`."""
        return np.array([seen.disturbance for seen in self.snapshots])


class _Recorder(Recorder):
    """A film that keeps every step, also the last one of an episode, after which the environment begins anew."""

    def __init__(self, world: World) -> None:
        super().__init__(world, "rgb_array")
        self.kept: list[Snapshot] = []

    def record_step(self, action: Floats32, outcome: Floats) -> None:
        super().record_step(action, outcome)
        self.kept.append(self.snapshot())


def record(
    name: str, policy: Policy, scenario: Scenario, seed: int, options: dict[str, Any] | None = None
) -> Recording:
    """Fly the first episode of a seed, the same that row 0 of `quadpend_train.evaluation.episodes.fly` meets.

    Args:
        name: of the policy.
        policy: anything that obeys the `predict` protocol.
        scenario: where it flies.
        seed: of the episode.
        options: of the environment's reset.
    """
    policy, env = adapt_policy(policy, scenario), scenario.make_vec(1, AutoresetMode.SAME_STEP)
    inner: Any = env.unwrapped
    inner.recorder = recorder = _Recorder(inner.world)
    estimates, survived = [], False
    for step in rollout(policy, env, seed, options):
        survived = bool(step.survived[0])
        estimates.append(estimated_disturbance(policy, step.memory)[0])
    return Recording(name, tuple(recorder.kept), np.array(estimates), survived)
