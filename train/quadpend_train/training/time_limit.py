"""The limit `max_seconds` of a run.

It counts everything from the start to the trained policy: the set-up, the imitation, training with its evaluations, the
last evaluation, the score on the card, and saving. Training therefore stops early enough to leave time for the last
three. Their duration is predicted from a few control steps of an evaluation, and from the evaluations so far. Training
can stop after a step only, so the time of the longest interval between two steps, which contains gradient steps, is
kept too.
"""

import time
from itertools import islice

from gymnasium.vector import AutoresetMode

from quadpend_baselines import Policy
from quadpend_baselines.policy.rollout import rollout
from quadpend_gym.scenarios import expand_sets, find_scenario
from quadpend_train.evaluation.episodes import VALIDATION_SEED
from quadpend_train.training.settings import TrainSettings

_SAVING = 0.3  # s, of the model and of the policy
_MARGIN = 1.1  # factor on the predicted duration of an evaluation
_PROBE = 20  # control steps


class TimeUpError(Exception):
    """The time of a run is up."""


class TimeLimit:
    """Tell when training has to stop.

    Args:
        seconds: Limit; 0 for no limit.
        started: Time at which the run started, as `time.perf_counter` returns it; None: now.
    """

    def __init__(self, seconds: float, started: float | None = None) -> None:
        self.end = (time.perf_counter() if started is None else started) + seconds if seconds else float("inf")
        self.stopped = False  # whether the limit has ended the training
        self.evaluation = 0.0  # s, duration of an evaluation
        self._evaluations = 1  # after training: the score, and the last evaluation if there are any
        self._last: float | None = None  # time of the last step
        self._intervals = [0.0, 0.0]  # longest intervals between two steps in the last rollout and in this one, s

    def predict(self, policy: Policy, settings: TrainSettings) -> None:
        """Predict how long an evaluation of a policy takes."""
        if self.end == float("inf"):
            return
        self._evaluations = 2 if settings.eval_freq else 1
        seconds, episodes = 0.0, settings.n_eval_episodes
        for name in expand_sets(settings.scenarios):
            start, scenario = time.perf_counter(), find_scenario(name)
            env = scenario.make_vec(episodes, AutoresetMode.SAME_STEP)
            steps = rollout(policy.adapt(scenario), env, VALIDATION_SEED)
            next(steps)
            flown = time.perf_counter()
            count = sum(1 for _ in islice(steps, _PROBE))
            seconds += flown - start + (time.perf_counter() - flown) / max(count, 1) * scenario.steps
        self.evaluation = max(self.evaluation, seconds)

    def evaluated(self, seconds: float) -> None:
        """Correct the prediction after an evaluation that took so long."""
        self.evaluation = max(self.evaluation, seconds)
        self._last = None

    def start_rollout(self) -> None:
        """Forget the intervals between two steps before the last rollout."""
        self._intervals = [self._intervals[1], 0.0]

    def step(self) -> None:
        """Measure the interval since the last step."""
        now = time.perf_counter()
        if self._last is not None:
            self._intervals[1] = max(self._intervals[1], now - self._last)
        self._last = now

    def reached(self, evaluations: int = 0) -> bool:
        """Return whether there is no time for more evaluations and another interval between two steps."""
        final = _SAVING + _MARGIN * self.evaluation * (self._evaluations + evaluations)
        return time.perf_counter() + final + max(self._intervals) >= self.end

    def stop(self, evaluations: int = 0) -> bool:
        """Return whether training has to stop, as `reached` says, and remember in `stopped` that it had to."""
        self.stopped = self.stopped or self.reached(evaluations)
        return self.stopped

    def check(self) -> None:
        """Raise `TimeUpError` if training has to stop."""
        if self.reached():
            raise TimeUpError
