"""The generated parts of pages."""

from pathlib import Path

import pytest

from experiments.pages import fill


def test_a_part_of_a_page_is_replaced_and_the_rest_stays(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# Title\n<!-- begin a -->\nold\n<!-- end a -->\nend\n")
    fill(page, {"a": r"new \1"})
    assert page.read_text() == "# Title\n<!-- begin a -->\n\nnew \\1\n\n<!-- end a -->\nend\n"
    with pytest.raises(ValueError, match="must contain <!-- begin b -->"):
        fill(page, {"b": "text"})
