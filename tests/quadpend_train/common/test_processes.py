"""Calls in other processes give all results, whatever happens to the processes."""

import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest

from quadpend_train.common.processes import call_in_processes


def square(number: int) -> int:
    return number**2


def refuse(number: int) -> int:
    raise ValueError(f"number must be even, not {number}")


class UnpicklableError(Exception):
    def __init__(self, first: int, second: int) -> None:
        super().__init__("two arguments")


def refuse_in_an_odd_way() -> None:
    raise UnpicklableError(1, 2)


def kill_itself_once(path: Path) -> str:
    if path.exists():
        return "computed again"
    path.touch()
    os.kill(os.getpid(), signal.SIGKILL)
    return ""


def kill_itself(number: signal.Signals) -> None:
    os.kill(os.getpid(), number)
    time.sleep(10.0)


def test_all_results_arrive_under_their_names() -> None:
    calls = {number: partial(square, number) for number in range(7)}
    assert sorted(call_in_processes(calls, 2)) == [(number, number**2) for number in range(7)]
    assert list(call_in_processes({}, 2)) == []


def test_an_exception_of_a_call_is_raised_here_with_its_traceback() -> None:
    with pytest.raises(ValueError, match="number must be even, not 3") as raised:
        list(call_in_processes({"odd": partial(refuse, 3)}, 2))
    assert "in refuse" in str(raised.value.__cause__)
    with pytest.raises(RuntimeError, match="UnpicklableError: two arguments"):
        list(call_in_processes({"odd": refuse_in_an_odd_way}, 1))


def test_the_call_of_a_killed_process_is_computed_again(tmp_path: Path) -> None:
    calls = {0: partial(kill_itself_once, tmp_path / "killed"), 1: partial(square, 3)}
    assert dict(call_in_processes(calls, 2)) == {0: "computed again", 1: 9}


def test_a_call_whose_processes_are_always_killed_ends_in_one_sentence() -> None:
    with pytest.raises(ChildProcessError, match=r"the processes of big were killed 3 times, .*: use fewer jobs$"):
        list(call_in_processes({"big": partial(kill_itself, signal.SIGTERM)}, 1))


def test_processes_end_when_their_parent_is_killed(tmp_path: Path) -> None:
    code = f"""
from functools import partial
from time import sleep
from quadpend_train.common.processes import call_in_processes
from tests.quadpend_train.common.test_processes import write_process_and_wait
if __name__ == "__main__":
    list(call_in_processes({{i: partial(write_process_and_wait, {str(tmp_path)!r}, i) for i in range(2)}}, 2))
"""
    script = tmp_path / "script.py"
    script.write_text(code)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    parent = subprocess.Popen([sys.executable, str(script)], env=environment)
    numbers = [tmp_path / "0", tmp_path / "1"]
    wait_until(lambda: all(path.exists() for path in numbers))
    parent.kill()
    parent.wait()
    wait_until(lambda: not any(Path("/proc", path.read_text()).exists() for path in numbers))


def write_process_and_wait(folder: str, number: int) -> None:
    unfinished = Path(folder, f"{number}.tmp")
    unfinished.write_text(str(os.getpid()))
    unfinished.rename(Path(folder, str(number)))
    time.sleep(60.0)


def wait_until(condition: object, seconds: float = 30.0) -> None:
    end = time.monotonic() + seconds
    while not condition():  # type: ignore[operator]
        assert time.monotonic() < end
        time.sleep(0.02)
