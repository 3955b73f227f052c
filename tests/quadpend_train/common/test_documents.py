"""Generated parts of a document are replaced, and the rest stays."""

from pathlib import Path

import pytest

from quadpend_train.common.documents import fill


def test_generated_parts_replace_what_is_between_their_comments_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "results.md"
    path.write_text("Before\n<!-- begin table -->\nold\n<!-- end table -->\nAfter\n")
    fill(path, {"table": "| \\1 new |\n"})
    once = path.read_text()
    assert once == "Before\n<!-- begin table -->\n\n| \\1 new |\n\n<!-- end table -->\nAfter\n"
    fill(path, {"table": "| \\1 new |\n"})
    assert path.read_text() == once
    with pytest.raises(ValueError, match="<!-- begin other --> … <!-- end other --> exactly once, not 0 times"):
        fill(path, {"other": ""})
