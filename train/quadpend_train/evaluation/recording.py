"""Record one episode of a policy step by step, for `quadpend watch`."""

from typing import Any, NamedTuple

from gymnasium.vector import AutoresetMode

from quadpend_baselines.policy.rollout import rollout
from quadpend_gym.core.arrays import Floats
from quadpend_gym.envs.recorder import Recorder
from quadpend_gym.envs.world import World
from quadpend_gym.scenarios import Scenario
from quadpend_gym.viewer.snapshot import Snapshot
from quadpend_train.policies.conversion import as_policy


class Recording(NamedTuple):
    """An episode of T steps of the policy `name`."""

    name: str
    snapshots: tuple[Snapshot, ...]  # after each step
    survived: bool

    @property
    def fell_at(self) -> float | None:
        """Time at which the episode terminated early, s; None if it did not."""
        return None if self.survived else self.snapshots[-1].time


class _StepRecorder(Recorder):
    """Keep a snapshot of every step, including the last step of an episode, before the autoreset."""

    def __init__(self, world: World) -> None:
        super().__init__(world, "rgb_array")
        self.recorded: list[Snapshot] = []

    def record_step(self, outcome: Floats) -> None:
        super().record_step(outcome)
        self.recorded.append(self.snapshot())


def record_episode(name: str, policy: Any, scenario: Scenario, seed: int) -> Recording:
    """Record one episode of a policy, or of what `as_policy` takes: the first one that `run_episodes` runs."""
    flown = as_policy(policy).adapt(scenario)
    env = flown.wrap(scenario.make_vec(1, AutoresetMode.SAME_STEP))
    inner: Any = env.unwrapped
    inner.recorder = recorder = _StepRecorder(inner.world)
    survived = False
    for step in rollout(flown, env, seed):
        survived = bool(step.survived[0])
    return Recording(name, tuple(recorder.recorded), survived)
