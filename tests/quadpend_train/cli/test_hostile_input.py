"""Names and files that are unusual or damaged end in a readable result or in one sentence."""

from pathlib import Path

import pytest

from quadpend_gym.tasks.observation import OBSERVATION_SIZE
from quadpend_train.cli.main import main
from tests.helpers.policies import mlp_policy
from tests.helpers.scenarios import shorten_scenarios
from tests.quadpend_train.cli.test_commands import refused

NAMES = ("[red]bold", "a.b", "<b>x")
FILE = "d[/b].npz"  # its name has no slash
POLICIES = [*(f"{name}={policy}" for name, policy in zip(NAMES, ("lqr", "lqi", "flatness"), strict=True)), FILE]


@pytest.fixture
def brief_scenarios(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    shorten_scenarios(monkeypatch, 0.2)
    monkeypatch.chdir(tmp_path)
    Path(FILE).parent.mkdir()
    mlp_policy(OBSERVATION_SIZE, interface="wrench").save(FILE)


@pytest.mark.usefixtures("brief_scenarios")
def test_names_are_text_everywhere(capsys: pytest.CaptureFixture[str]) -> None:
    main(["evaluate", *POLICIES, "--scenarios", "calm", "windy again=windy", "--episodes", "2", "--replay", "0"])
    printed = capsys.readouterr()
    assert all(name in printed.out for name in (*NAMES, FILE))
    assert "recording" not in printed.err  # the bar of the replay
    assert "<b>x" not in Path("results/report.html").read_text(encoding="utf-8")


LONG = "a" * 300
FOLDER = "a file cannot be read or written: file/x: Not a directory"
REFUSED = {
    "evaluate lqr --episodes 1000000000": "episodes must be a whole number from 1 to 100000, not 1000000000",
    "evaluate lqr --scenarios calm calm=windy": "two scenarios have the name 'calm'",
    "evaluate a=lqr a=lqi": "two policies have the same name",
    "evaluate lqr,lqr x=lqi,lqr,lqi": "same number",
    "train --seeds 4-0": "seeds must be different numbers and ranges",
    "train --jobs 2": "give them with --seeds",
    "train --resume nix --seeds 0-2": "contain no run",
    "train --num-envs 1000000000": "num_envs must be a whole number from 1 to",
    f"evaluate {LONG}": f"a file cannot be read or written: {LONG}: File name too long",
    **{f"{command} --out file/x": FOLDER for command in ("evaluate lqr", "tune lqr")},
}


@pytest.mark.parametrize("command", REFUSED)
def test_impossible_numbers_and_paths_are_refused_before_any_work(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*arguments: object, **settings: object) -> None:
        raise AssertionError("work has begun")

    for work in ("evaluation.episodes.run_episodes", "training.train.train"):
        monkeypatch.setattr(f"quadpend_train.{work}", fail)
    monkeypatch.chdir(tmp_path)
    Path("file").touch()
    assert REFUSED[command] in refused(command.split(), capsys)
