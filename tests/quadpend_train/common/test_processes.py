"""Calls in other processes give all results, whatever happens to the processes."""

import os
import signal
import subprocess
import sys
import time
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import pytest

from quadpend_train.common import interruption
from quadpend_train.common.processes import call_in_processes, process_is_alive


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


def test_an_exception_of_a_call_arrives_with_its_traceback_and_does_not_stop_the_others() -> None:
    calls = {"odd": partial(refuse, 3), "other": refuse_in_an_odd_way, "even": partial(square, 4)}
    found: dict[str, Any] = dict(call_in_processes(calls, 1))
    assert isinstance(found["odd"], ValueError)
    assert str(found["odd"]) == "number must be even, not 3"
    assert "in refuse" in str(found["odd"].__cause__)
    assert str(found["other"]) == "UnpicklableError: two arguments"
    assert found["even"] == 16


def test_the_call_of_a_killed_process_is_computed_again(tmp_path: Path) -> None:
    calls = {0: partial(kill_itself_once, tmp_path / "killed"), 1: partial(square, 3)}
    assert dict(call_in_processes(calls, 2)) == {0: "computed again", 1: 9}


def test_a_call_whose_processes_are_always_killed_does_not_stop_the_others() -> None:
    calls = {"big": partial(kill_itself, signal.SIGTERM), "small": partial(square, 2)}
    found: dict[str, Any] = dict(call_in_processes(calls, 1))
    assert isinstance(found["big"], ChildProcessError)
    assert str(found["big"]).startswith("its processes were killed 3 times")
    assert found["small"] == 4


def test_process_is_alive_until_its_end() -> None:
    process = subprocess.Popen(["sleep", "60"])
    assert process_is_alive(process.pid)
    process.kill()
    process.wait()
    assert not process_is_alive(process.pid)
    assert not process_is_alive(2**64)
    assert process_is_alive(1)  # of another user, except for root


def start_process_and_return(folder: Path) -> int:
    process = get_context("spawn").Process(target=time.sleep, args=(60.0,))
    process.start()
    (folder / "grandchild").write_text(str(process.pid))
    return 3


def test_a_call_may_start_processes_which_end_with_its_worker(tmp_path: Path) -> None:
    assert dict(call_in_processes({0: partial(start_process_and_return, tmp_path)}, 1)) == {0: 3}
    number = (tmp_path / "grandchild").read_text()
    wait_until(lambda: not Path("/proc", number).exists())


def start_process_and_kill_itself(folder: Path) -> str:
    if (folder / "grandchild").exists():
        return "computed again"
    process = subprocess.Popen(["sleep", "60"])
    (folder / "unfinished").write_text(str(process.pid))
    (folder / "unfinished").rename(folder / "grandchild")
    os.kill(os.getpid(), signal.SIGKILL)
    return ""


def wait_and_start_process_and_kill_itself(folder: Path) -> str:
    wait_until((folder / "begin").exists)
    return start_process_and_kill_itself(folder)


def test_processes_of_a_killed_worker_end(tmp_path: Path) -> None:
    assert dict(call_in_processes({0: partial(start_process_and_kill_itself, tmp_path)}, 1)) == {0: "computed again"}
    number = (tmp_path / "grandchild").read_text()
    wait_until(lambda: not Path("/proc", number).exists())


@pytest.mark.parametrize("number", interruption.SIGNALS, ids=str)
def test_processes_of_a_killed_worker_end_at_a_signal(number: signal.Signals, tmp_path: Path) -> None:
    """The program has not yet found that the worker was killed."""
    code = f"""
import time
from functools import partial
from pathlib import Path
from quadpend_train.common import interruption
from quadpend_train.common.processes import call_in_processes
from tests.quadpend_train.common.test_processes import square, wait_and_start_process_and_kill_itself as wait_and_start
if __name__ == "__main__":
    interruption.end_at_signals()
    folder = Path({str(tmp_path)!r})
    calls = call_in_processes({{0: partial(square, 2), 1: partial(wait_and_start, folder)}}, 2)
    print(next(calls), flush=True)
    (folder / "begin").touch()
    time.sleep(60.0)
"""
    script = tmp_path / "script.py"
    script.write_text(code)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen([sys.executable, str(script)], env=environment, stdout=subprocess.PIPE) as program:
        assert program.stdout is not None
        assert program.stdout.readline() == b"(0, 4)\n"
        wait_until((tmp_path / "grandchild").exists)
        time.sleep(0.2)  # until the worker is killed
        program.send_signal(number)
        assert program.wait(20.0) == 128 + number
    grandchild = (tmp_path / "grandchild").read_text()
    wait_until(lambda: not Path("/proc", grandchild).exists())


def test_a_program_ends_that_leaves_calls_unfinished(tmp_path: Path) -> None:
    code = f"""
from functools import partial
from quadpend_train.common.processes import call_in_processes
from tests.quadpend_train.common.test_processes import square, write_process_and_wait
if __name__ == "__main__":
    calls = call_in_processes({{0: partial(square, 2), 1: partial(write_process_and_wait, {str(tmp_path)!r}, 1)}}, 2)
    print(next(calls))
    kept = [calls, __import__("sys").modules]
    kept[1]["kept"] = kept
"""
    script = tmp_path / "script.py"
    script.write_text(code)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    ended = subprocess.run([sys.executable, str(script)], env=environment, check=True, timeout=40.0, stdout=-1)
    assert b"(0, 4)" in ended.stdout


@pytest.mark.parametrize("started", [False, True], ids=["workers", "their processes"])
def test_processes_end_when_their_parent_is_killed(started: bool, tmp_path: Path) -> None:
    function = "start_process_and_wait" if started else "write_process_and_wait"
    code = f"""
from functools import partial
from time import sleep
from quadpend_train.common.processes import call_in_processes
from tests.quadpend_train.common.test_processes import {function}
if __name__ == "__main__":
    list(call_in_processes({{i: partial({function}, {str(tmp_path)!r}, i) for i in range(2)}}, 2))
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


def start_process_and_wait(folder: str, number: int) -> None:
    get_context("spawn").Process(target=write_process_and_wait, args=(folder, number)).start()
    time.sleep(60.0)


def wait_until(condition: object, seconds: float = 30.0) -> None:
    end = time.monotonic() + seconds
    while not condition():  # type: ignore[operator]
        assert time.monotonic() < end
        time.sleep(0.02)
