"""The hash of source code ignores docstrings, comments, messages of exceptions and layout only."""

from pathlib import Path

import pytest

from quadpend_gym.core.source_hash import source_hash

SOURCE = '''"""Module docstring."""

LIMIT = 2.0  # m


class Model:
    """Class docstring."""

    def value(self, x: float) -> float:
        """Function docstring."""
        return LIMIT * x  # the product


def empty() -> None:
    """Docstring of a function without a body."""
'''


REFUSAL = """
def check(x: float) -> None:
    if x < 0.0:
        raise ValueError(f"x must not be negative, not {x}")
"""


def package(folder: Path, source: str = SOURCE, file: str = "model.py") -> Path:
    """Create a package with one module and return its folder."""
    package = folder / "package"
    package.mkdir(parents=True)
    (package / "__init__.py").touch()
    (package / file).write_text(source, encoding="utf-8")
    return package


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("Module docstring.", "Other words."),
        ("Class docstring.", "Other words."),
        ("Function docstring.", "Other\n        words."),
        ("# the product", "# another comment"),
        ('"""Module docstring."""', ""),
        ("LIMIT * x", "(LIMIT  *  x)"),
        ("\n\n\n", "\n\n"),
    ],
)
def test_a_change_of_docstrings_comments_or_layout_keeps_the_hash(tmp_path: Path, old: str, new: str) -> None:
    assert old in SOURCE
    assert source_hash([package(tmp_path / "a")]) == source_hash([package(tmp_path / "b", SOURCE.replace(old, new))])


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("2.0", "2.5"),
        ("2.0", "2"),
        ("LIMIT", "BOUND"),
        ("value", "values"),
        ("LIMIT * x", "x * LIMIT"),
        ("float", "int"),
    ],
)
def test_a_change_of_a_number_a_name_or_an_expression_changes_the_hash(tmp_path: Path, old: str, new: str) -> None:
    assert old in SOURCE
    assert source_hash([package(tmp_path / "a")]) != source_hash([package(tmp_path / "b", SOURCE.replace(old, new))])


def test_a_renamed_file_changes_the_hash(tmp_path: Path) -> None:
    one, other = package(tmp_path / "a"), package(tmp_path / "b", file="other.py")
    assert source_hash([one]) != source_hash([other])


def test_a_change_of_a_string_value_changes_the_hash(tmp_path: Path) -> None:
    one, other = (package(tmp_path / text, f"text = {text!r}") for text in ("a", "b"))
    assert source_hash([one]) != source_hash([other])


def test_a_change_of_a_table_changes_the_hash(tmp_path: Path) -> None:
    folder = package(tmp_path)
    table = folder / "plan.csv"
    table.write_text("1.0\n")
    before = source_hash([folder, table])
    table.write_text("2.0\n")
    assert source_hash([folder, table]) != before


def test_the_order_of_the_paths_and_a_path_given_twice_do_not_matter(tmp_path: Path) -> None:
    folder = package(tmp_path)
    files = [folder / "model.py", folder / "__init__.py"]
    assert source_hash(files) == source_hash(files[::-1]) == source_hash([folder, *files])


def test_a_missing_file_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        source_hash([tmp_path / "missing.py"])


@pytest.mark.parametrize(("old", "new", "same"), [("negative", "below zero", True), ("ValueError", "TypeError", False)])
def test_a_change_of_a_message_keeps_the_hash_but_not_one_of_the_exception(
    tmp_path: Path, old: str, new: str, same: bool
) -> None:
    changed = package(tmp_path / "b", REFUSAL.replace(old, new))
    assert (source_hash([package(tmp_path / "a", REFUSAL)]) == source_hash([changed])) is same
