"""Results do not depend on the number of processes, and a call that fails is named when the others have ended."""

import os
import signal
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from quadpend_train.cli.main import main
from quadpend_train.common.executors import CallsFailedError, pool, run
from tests.helpers.own_code import write_module

FAILING = """
from quadpend_baselines import controller
class Failing:
    fingerprint = "1"
    def __init__(self): self.steps, self.policy = 0, controller("lqr")
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        self.steps += 1
        if self.steps > 10:
            raise KeyError("no gain")
        return self.policy.predict(observation, state, episode_start, deterministic)
def make(): return Failing()
"""


def square(number: int) -> int:
    return number**2


def refuse(number: int) -> int:
    raise ValueError(f"number must be even, not {number}")


class UnpicklableError(Exception):
    def __init__(self, first: int, second: int) -> None:
        super().__init__("two arguments")


def refuse_in_an_odd_way() -> None:
    raise UnpicklableError(1, 2)


def kill_itself() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.parametrize("jobs", [1, 2])
def test_results_arrive_under_their_names_and_failures_are_named_at_the_end(jobs: int, tmp_path: Path) -> None:
    assert run({number: partial(square, number) for number in range(7)}, jobs) == {n: n**2 for n in range(7)}
    others = {number: (tmp_path / str(number)).touch for number in range(7)}
    failing: dict[Any, Any] = {("a", 1): partial(refuse, 1), "odd": refuse_in_an_odd_way, **others}
    with pytest.raises(CallsFailedError) as raised:
        run(failing, jobs, what="trial")
    head, *lines = str(raised.value).splitlines()
    assert head == "2 of 9 trials failed; the others have ended:"
    assert any(line.startswith("  a, 1: ValueError: number must be even, not 1") for line in lines)
    assert any("UnpicklableError: two arguments" in line for line in lines)
    assert len(list(tmp_path.iterdir())) == 7


def test_a_killed_process_fails_its_call_only(tmp_path: Path) -> None:
    calls: dict[Any, Any] = {"big": kill_itself, **{number: (tmp_path / str(number)).touch for number in range(5)}}
    with pytest.raises(CallsFailedError, match="big: its process was killed, perhaps for lack of memory") as raised:
        run(calls, 2)
    failed = str(raised.value).count("\n")
    assert failed <= 2  # the calls that ran at that moment
    assert failed + len(list(tmp_path.iterdir())) >= len(calls)


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_a_failing_policy_is_named_and_the_other_results_are_cached(
    jobs: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pool(2).shutdown()  # the processes of other tests, which have another working directory
    module = write_module(tmp_path, monkeypatch, FAILING)
    scenario = ["--scenarios", '{"duration": 0.2}', "--episodes", "2", "--jobs", jobs]
    with pytest.raises(SystemExit) as ended:
        main(["evaluate", f"mine={module}:make", "lqr", *scenario])
    assert ended.value.code == 1
    head, failure = capsys.readouterr().err.strip().splitlines()[-2:]
    assert head.endswith("1 of 2 jobs failed; the others have ended:")
    assert failure.endswith(f"mine: KeyError: 'no gain' ({module}.py, line 9)")
    assert len(list((tmp_path / "results/cache").iterdir())) == 1
