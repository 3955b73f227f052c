"""Files are complete or unchanged."""

import os
import subprocess
import time
from pathlib import Path

import pytest

from quadpend_train.common import interruption
from quadpend_train.common.files import (
    atomic,
    atomic_files,
    delete_abandoned,
    delete_temporary,
    temporary_name,
    write_text,
)


def test_a_complete_file_replaces_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    for text in ("old", "new"):
        write_text(path, text)
        assert path.read_text() == text
    assert os.listdir(tmp_path) == ["table.csv"]
    assert not interruption.unfinished


@pytest.mark.parametrize("error", [OSError("disk full"), KeyboardInterrupt()])
def test_a_failure_leaves_the_old_file_and_no_temporary_file(tmp_path: Path, error: BaseException) -> None:
    path = tmp_path / "table.csv"
    path.write_text("old")

    def write() -> None:
        with atomic(path) as unfinished:
            unfinished.write_text("ne")
            assert (unfinished.parent, unfinished.suffix) == (tmp_path, ".csv")
            raise error

    with pytest.raises(type(error)):
        write()
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["table.csv"]


def test_a_link_stays_a_link_and_a_device_a_device(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "file")
    write_text(tmp_path / "link", "text")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "file").read_text() == "text"
    write_text(Path("/dev/null"), "text")
    assert not Path("/dev/null").is_file()


def test_a_name_of_the_largest_length_can_be_written(tmp_path: Path) -> None:
    write_text(tmp_path / ("θ" * 125 + ".txt"), "text")
    assert (tmp_path / ("θ" * 125 + ".txt")).read_text() == "text"


def test_several_files_are_moved_together_or_not_at_all(tmp_path: Path) -> None:
    def write(error: type[BaseException] | None) -> None:
        with atomic_files(tmp_path) as unfinished:
            for name in ("a", "b"):
                (unfinished / name).write_text(f"{error}")
            if error:
                raise error

    with pytest.raises(KeyboardInterrupt):
        write(KeyboardInterrupt)
    assert os.listdir(tmp_path) == []
    write(None)
    assert sorted(os.listdir(tmp_path)) == ["a", "b"]
    assert not interruption.unfinished


def ended_process() -> int:
    """Return the number of a process that has ended."""
    process = subprocess.Popen(["true"])
    process.wait()
    return process.pid


def test_file_of_a_killed_process_is_deleted_with_the_next_attempt(tmp_path: Path) -> None:
    """Those of running processes, of other files and of other hosts, where the process may run, stay."""
    number = ended_process()
    abandoned = temporary_name(number, "_a.txt")
    kept = [
        temporary_name(os.getppid(), "_a.txt"),
        temporary_name(number, "_b.txt"),
        f"unfinished_another.host_{number}_a.txt",
        f"unfinished_{number}_a.txt",  # of an earlier version, perhaps on another host
        "unfinished_business_a.txt",
    ]
    for name in [abandoned, *kept]:
        (tmp_path / name).write_text("half")
    write_text(tmp_path / "a.txt", "whole")
    assert {path.name for path in tmp_path.iterdir()} == {"a.txt", *kept}


def test_folder_of_a_killed_process_with_the_number_of_this_one_is_deleted(tmp_path: Path) -> None:
    """The processes of a restarted container have the same numbers again."""
    (tmp_path / temporary_name(os.getpid())).mkdir()
    (tmp_path / temporary_name(os.getpid()) / "old").write_text("half")
    with atomic_files(tmp_path) as unfinished:
        (unfinished / "new").write_text("whole")
    assert os.listdir(tmp_path) == ["new"]


def test_file_of_another_host_is_deleted_after_a_day(tmp_path: Path) -> None:
    number, now = ended_process(), time.time()
    names = [f"unfinished_{host}{number}_{name}" for host in ("0f9a3c51_", "another.host_", "") for name in "ab"]
    for hours, remaining in ((23, names), (25, [name for name in names if name.endswith("b")])):
        for name in names:
            (tmp_path / name).write_text("half")
            os.utime(tmp_path / name, (now - 3600 * hours,) * 2)
        write_text(tmp_path / "a", "whole")
        assert {path.name for path in tmp_path.iterdir()} == {"a", *remaining}


def test_file_that_this_process_is_writing_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also if another thread writes a file of the same name, or deletes the temporary files of the folder."""
    (tmp_path / "link").symlink_to(tmp_path)
    monkeypatch.chdir(tmp_path)
    with atomic(Path("a.txt")) as unfinished, atomic_files(Path()) as several:
        unfinished.write_text("being written")
        (several / "b").write_text("being written")
        for folder in (Path(), tmp_path, tmp_path / "link"):
            delete_abandoned(folder, "_a.txt")
            delete_abandoned(folder, "")
            delete_temporary(folder)
    assert {path.name for path in tmp_path.iterdir()} == {"link", "a.txt", "b"}


def test_hosts_whose_long_names_differ_at_their_end_are_different(monkeypatch: pytest.MonkeyPatch) -> None:
    names = set()
    for end in "ab":
        monkeypatch.setattr("platform.node", lambda end=end: "a-host-in-the-cluster.department.university" + end)
        names.add(temporary_name(1))
    assert len(names) == 2
    assert max(map(len, names)) < 30
