"""C is compiled with any compiler that `CC` names, and without a folder for the cache."""

import shutil
from pathlib import Path

import pytest

from quadpend_gym.core.c_library import load_c

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path


def answer(number: int = 42) -> int:
    """The number that compiled C returns."""
    return int(load_c(f"int f(void) {{ return {number}; }}").f())


@pytest.mark.parametrize("command", ["cc -O1", "{folder}/with space/cc", ""])
def test_a_compiler_may_have_arguments_and_spaces_in_its_path(
    command: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "with space").mkdir()
    (folder / "with space/cc").symlink_to(str(shutil.which("cc")))
    monkeypatch.setenv("CC", command.format(folder=folder))
    assert answer() == 42


def test_the_message_of_a_compiler_that_fails_is_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "cc --nonsense")
    with pytest.raises(OSError, match=r"(?s)the C compiler fails: cc --nonsense .*nonsense"):
        answer()


def test_a_damaged_library_is_compiled_again(folder: Path) -> None:
    answer(7)
    (library,) = (folder / "quadpend_gym").iterdir()
    library.replace(folder / "loaded")
    library.touch()
    assert answer(7) == 7


def no_user(_: int) -> None:
    raise KeyError


def test_no_home_is_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a container whose user has no entry in /etc/passwd."""
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.delenv("HOME", raising=False)
    monkeypatch.setattr("pwd.getpwuid", no_user)
    with pytest.warns(RuntimeWarning, match="set XDG_CACHE_HOME"):
        assert answer() == 42


def test_a_cache_that_cannot_be_written_is_a_warning(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder / "file"))
    with pytest.warns(RuntimeWarning, match="set XDG_CACHE_HOME"):
        assert answer() == 42


def test_a_filled_cache_needs_neither_a_compiler_nor_to_be_written(monkeypatch: pytest.MonkeyPatch) -> None:
    answer()
    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr("os.access", lambda *_: False)
    assert answer() == 42


def test_a_quotation_mark_without_its_end_names_the_variable(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "cc '-O1")
    with pytest.raises(OSError, match="CC is no command"):
        answer()
