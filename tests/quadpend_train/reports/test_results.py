"""`quadpend evaluate` writes reproducible files and updates the generated parts of a document."""

import re
from dataclasses import replace
from pathlib import Path

import pytest

from quadpend_train.cli.main import main
from quadpend_train.reports.results import PARTS
from tests.helpers.scenarios import shorten_scenarios
from tests.helpers.sources import ROOT

RESULTS = ROOT / "docs/results.md"


@pytest.fixture
def brief_axes(monkeypatch: pytest.MonkeyPatch) -> None:
    from quadpend_train.studies import robustness

    axes = {name: robustness.PERTURBATION_AXES[name] for name in ("tilt", "wind")}
    axes = {name: replace(axis, values=axis.values[::4]) for name, axis in axes.items()}
    monkeypatch.setattr(
        robustness.measure_robustness, "__defaults__", (axes, {}, *robustness.measure_robustness.__defaults__[2:])
    )  # type: ignore[index]


def test_evaluate_writes_the_same_files_every_time(
    tmp_path: Path, brief_axes: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    shorten_scenarios(monkeypatch, 1.0)
    document = tmp_path / "results.md"
    empty = "".join(f"<!-- begin {part} -->\n<!-- end {part} -->\n" for part in PARTS)
    document.write_text(f"# Title\n{empty}The end\n", encoding="utf-8")
    command = ["evaluate", "adrc-paper", "lqr", "--scenarios", "calm", "steady", "--episodes", "4"]
    command += ["--robustness", "4", "--replay", "1", "--document", str(document), "--cache", str(tmp_path / "cache")]
    folder = tmp_path / "out"
    written = []
    for _ in range(2):
        main([*command, "--out", str(folder)])
        files = {file.name: file.read_bytes() for file in sorted(folder.iterdir())}
        page = files["report.html"].decode()
        files["report.html"] = re.sub(r"\d{4}-\d\d-\d\d", "", page).encode()
        written.append({**files, "document": document.read_bytes()})
    assert written[0] == written[1]
    assert b'<section id="replay">' in written[0]["report.html"]
    assert set(written[0]) == {
        "report.html",
        "comparison.json",
        "comparison.csv",
        "comparison.md",
        "comparison.png",
        "robustness.json",
        "curves.png",
        "document",
    }
    text = document.read_text(encoding="utf-8")
    assert text.startswith("# Title\n")
    assert text.endswith("The end\n")
    assert "| lqr |" in text
    assert "steady force" in text.lower() or "wind" in text.lower()
    document.write_text(text.replace("lqr", "old"), encoding="utf-8")
    without = command.index("--robustness")
    main([*command[:without], *command[without + 2 :], "--out", str(folder)])  # leaves the robustness as it was
    computed, kept = document.read_text(encoding="utf-8").split("<!-- begin robustness -->")
    assert "old" not in computed
    assert "| lqr |" in computed
    assert "old |" in kept


def test_a_document_without_a_place_is_an_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    document = tmp_path / "results.md"
    document.write_text("nothing\n", encoding="utf-8")
    command = ["evaluate", "adrc-paper", "lqr", "--scenarios", '{"duration": 0.5}', "--episodes", "2"]
    command += ["--cache", str(tmp_path / "cache"), "--out", str(tmp_path / "out"), "--document", str(document)]
    with pytest.raises(SystemExit):
        main(command)
    assert "must contain <!-- begin provenance -->" in capsys.readouterr().err


def test_the_published_results_have_all_parts_and_linked_files() -> None:
    text = RESULTS.read_text(encoding="utf-8")
    for part in PARTS:
        (filled,) = re.findall(rf"<!-- begin {part} -->\n(.*?)<!-- end {part} -->", text, re.DOTALL)
        assert filled.strip(), part
    for link in re.findall(r"\]\((?!https?:)([^)#]+)\)", text):
        assert (RESULTS.parent / link).exists(), link
