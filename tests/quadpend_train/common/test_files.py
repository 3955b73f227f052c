"""Files are complete or unchanged."""

import os
import subprocess
from pathlib import Path

import pytest

from quadpend_train.common import interruption
from quadpend_train.common.files import atomic, atomic_files, write_text


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


def test_file_of_a_killed_process_is_deleted_with_the_next_attempt(tmp_path: Path) -> None:
    """Those of running processes and of other files stay."""
    process = subprocess.Popen(["true"])
    process.wait()
    names = [f"unfinished_{process.pid}_a.txt", f"unfinished_{os.getppid()}_a.txt", f"unfinished_{process.pid}_b.txt"]
    for name in names:
        (tmp_path / name).write_text("half")
    write_text(tmp_path / "a.txt", "whole")
    assert {path.name for path in tmp_path.iterdir()} == {"a.txt", *names[1:]}
