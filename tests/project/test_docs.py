"""The documents agree with the code: equations, links, names of tests and functions, examples and figures."""

import re
from pathlib import Path

import pytest
from gymnasium.vector import AutoresetMode

from quadpend_baselines.paper.drawing import draw
from quadpend_gym import wind
from quadpend_gym.actuators import KINDS as ACTUATORS
from quadpend_gym.scenarios import find_scenario
from quadpend_gym.sensors import KINDS as SENSORS
from quadpend_train.cli.main import main
from quadpend_train.reports import model_plots
from quadpend_train.reports.model_plots import GALLERY
from tests.helpers.sources import ROOT

PAPER_PAGES = [ROOT / "docs/paper.md", ROOT / "docs/derivation.md"]
MODELS = (ROOT / "docs/models.md").read_text(encoding="utf-8")
PAGES = sorted([ROOT / "README.md", *ROOT.glob("*/README.md"), *(ROOT / "docs").glob("*.md")])
MAP = (ROOT / "docs/paper.md").read_text(encoding="utf-8")


def test_every_equation_of_the_paper_has_one_row_in_order() -> None:
    assert [int(n) for n in re.findall(r"^\| \((\d+)\) \|", MAP, re.MULTILINE)] == list(range(1, 73))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_link_has_a_target(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    links = re.findall(r"\]\((?!https?:)([^)#\s]+)(?:#[^)]*)?\)", text)
    links += re.findall(r"^\[[^\]]+\]: (\S+)$", text, re.MULTILINE)
    assert [link for link in links if not (page.parent / link).exists()] == []
    defined = re.findall(r"^\[(`[^\]]+`)\]:", text, re.MULTILINE)
    assert set(re.findall(r"\[(`[^\]]+`)\](?![:(])", text)) <= set(defined)


@pytest.mark.parametrize("page", PAPER_PAGES, ids=lambda page: page.name)
def test_every_test_named_exists(page: Path) -> None:
    tests = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("test_*.py"))
    named = set(re.findall(r"`(test_\w+)`", page.read_text(encoding="utf-8")))
    assert named
    assert {name for name in named if f"def {name}(" not in tests} == set()


def test_every_function_in_the_map_is_defined_in_its_file() -> None:
    targets = dict(re.findall(r"^\[(`[^\]]+`)\]: (\S+)$", MAP, re.MULTILINE))
    entries = re.findall(r"\[(`\w+\.py`)\]((?: `[\w.]+`,?)+)", MAP)
    assert len(entries) > 50
    for label, names in entries:
        source = (ROOT / "docs" / targets[label]).read_text(encoding="utf-8")
        for name in re.findall(r"`(?:\w+\.)?(\w+)`", names):
            assert re.search(rf"\b(def|class) {name}\b|^{name}\b|, {name} = ", source, re.MULTILINE), (label, name)


def test_the_frames_figure_is_drawn_by_code(tmp_path: Path) -> None:
    draw(tmp_path / "frames.svg")
    assert (tmp_path / "frames.svg").read_text(encoding="utf-8").count("<path") > 50


def test_the_scenario_on_the_page_of_models_makes_an_environment(tmp_path: Path) -> None:
    (block,) = re.findall(r"```toml\n(.*?)```", MODELS, re.DOTALL)
    (tmp_path / "mine.toml").write_text(block, encoding="utf-8")
    env = find_scenario(str(tmp_path / "mine.toml")).make_vec(3, AutoresetMode.SAME_STEP)
    assert env.reset(seed=0)[0].shape == (3, 4 * 27)


def test_the_page_of_models_has_a_figure_of_every_kind() -> None:
    kinds = {*wind.KINDS, *SENSORS, *ACTUATORS} - {"sum", "drawn", "rescaled", "still_air", "rotor_fault"}
    assert kinds <= set(GALLERY)
    assert {path.stem for path in (ROOT / "docs/models").glob("*.png")} == set(GALLERY)
    assert set(re.findall(r"models/(\w+)\.png", MODELS)) == set(GALLERY)


def test_quadpend_wind_plots_the_given_models(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(model_plots, "_SPECTRUM_SECONDS", 45.0)
    chosen = [f"{name}={GALLERY[name]}" for name in ("dryden", "gusts", "noise", "rotors")]
    main(["wind", *chosen, "windy", '{"kind": "delay"}', "--out", str(tmp_path)])
    assert {path.name for path in tmp_path.iterdir()} == {
        "dryden.png",
        "gusts.png",
        "noise.png",
        "rotors.png",
        "windy.png",
        "model_5.png",
    }


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["hurricane"], "there is no model 'hurricane'; there are calm, breeze"),
        (["constant"], "the wind is always zero"),
        (['{"kind": "dryden"'], "the model is not valid JSON"),
        (["--seconds", "0"], "seconds must be from 1"),
        (["--seed", "-1"], "seed must be a whole number from 0 to"),
    ],
)
def test_bad_options_of_quadpend_wind_are_refused(
    options: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(["wind", *options, "--out", str(tmp_path)])
    assert sentence in capsys.readouterr().err
