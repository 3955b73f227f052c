"""Files are complete or unchanged."""

import errno
import os
from pathlib import Path
from typing import Any

import pytest

from quadpend_train.common.files import atomic, writable_file, writable_folder, write_text


def test_a_full_disk_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, write = tmp_path / "table.csv", Path.write_bytes
    path.write_text("old")

    def fill_disk(self: Path, data: bytes) -> int:
        write(self, data[:2])
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", fill_disk)
    with pytest.raises(OSError, match="No space left"):
        write_text(path, "new")
    assert path.read_text() == "old"
    monkeypatch.undo()
    write_text(path, "new")
    assert path.read_text() == "new"
    assert os.listdir(tmp_path) == ["table.csv"]


def test_an_interruption_leaves_no_temporary_file(tmp_path: Path) -> None:
    def write() -> None:
        with atomic(tmp_path / "table.csv") as unfinished:
            unfinished.write_text("ne")
            assert (unfinished.parent, unfinished.suffix) == (tmp_path, ".csv")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write()
    assert os.listdir(tmp_path) == []


def test_a_link_stays_a_link_and_a_device_a_device(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "file")
    write_text(tmp_path / "link", "text")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "file").read_text() == "text"
    write_text(Path("/dev/null"), "text")
    assert not Path("/dev/null").is_file()


@pytest.mark.parametrize("check", [writable_folder, writable_file])
def test_a_path_that_cannot_be_written_is_refused(check: Any, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ValueError, match=r"out must be a folder that can be written, not .*/file"):
        check(tmp_path / "file/x/y")
    assert check(tmp_path / "new/x") == tmp_path / "new/x"
