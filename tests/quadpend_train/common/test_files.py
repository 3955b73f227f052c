"""Files are complete or unchanged."""

import errno
import os
from pathlib import Path

import pytest

from quadpend_train.common.files import atomic, write_text


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


def test_a_link_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "file")
    write_text(tmp_path / "link", "text")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "file").read_text() == "text"
