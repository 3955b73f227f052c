"""Names and files that are unusual or damaged end in a readable result or in one sentence."""

import os
from pathlib import Path

import numpy as np
import pytest

from quadpend_gym.core.factories import split_name
from quadpend_gym.scenarios import find_scenarios
from quadpend_gym.tasks.observation import OBSERVATION_SIZE
from quadpend_train.cli.main import main
from quadpend_train.evaluation.comparison import named_policies
from quadpend_train.policies.loading import load_policies, load_policy
from tests.helpers.policies import mlp_policy
from tests.helpers.scenarios import shorten_scenarios
from tests.quadpend_train.cli.test_commands import refused

NAMES = ("[red]bold", "a.b", "<b>x")
FILE = "d[/b].npz"  # its name has no slash
LATIN_1 = os.fsdecode(b"sz\xe4.json")
POLICIES = [*(f"{name}={policy}" for name, policy in zip(NAMES, ("lqr", "lqi", "flatness"), strict=True)), FILE]


@pytest.fixture
def brief_scenarios(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    shorten_scenarios(monkeypatch, 0.2)
    monkeypatch.chdir(tmp_path)
    Path(FILE).parent.mkdir()
    Path(LATIN_1).write_text("{}")
    mlp_policy(OBSERVATION_SIZE, interface="wrench").save(FILE)


@pytest.mark.usefixtures("brief_scenarios")
def test_names_are_text_everywhere(capsys: pytest.CaptureFixture[str]) -> None:
    main(
        [
            "evaluate",
            *POLICIES,
            "--scenarios",
            "calm",
            "windy again=windy",
            LATIN_1,
            "--latency",
            "0.005",
            "--episodes",
            "2",
        ]
    )
    printed = capsys.readouterr()
    assert all(name in printed.out for name in (*NAMES, FILE, "calm · 5 ms", "sz? · 5 ms"))
    assert "<b>x" not in Path("results/report.html").read_text(encoding="utf-8")


LONG = "a" * 300
FOLDER = "a file cannot be read or written: file/x: Not a directory"
REFUSED = {
    "evaluate lqr --episodes 1000000000": "episodes must be a whole number from 1 to 100000, not 1000000000",
    "evaluate lqr --scenarios calm calm=windy": "two scenarios have the name 'calm'",
    "evaluate a=lqr a=lqi": "two policies have the same name",
    "evaluate lqr,lqi x=lqi,lqr,flatness": "same number",
    "evaluate lqr --jobs 0": "jobs must be a whole number from 1 to 1024, not 0",
    "tune lqr --latency -0.1": "latency must be None or a finite number from 0 to 1 s",
    "train --resume nix --num-envs 9": "nix contains no run",
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


@pytest.mark.usefixtures("brief_scenarios")
def test_an_existing_path_is_taken_as_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    """Equals signs, commas and at signs in it separate nothing, also behind a name and in a list."""
    paths = ["lr=0.001/policy.npz", "a,b/policy.npz", "hydra/lr=0.1,seed=2/policy.npz", "lr=0.1,seed=3/policy.npz"]
    for number, path in enumerate(map(Path, paths)):
        path.parent.mkdir(parents=True)
        mlp_policy(OBSERVATION_SIZE, interface="wrench", seed=number).save(path)
    assert named_policies([*paths, f"both={paths[0]},{paths[3]}"]) == {
        **{path: path for path in paths},
        "both": f"{paths[0]},{paths[3]}",
    }
    assert [len(load_policies(name)) for name in (*paths, ",".join(paths[2:]), "lqr,lqi")] == [1, 1, 1, 1, 2, 2]
    Path("a,b/g=1.json").write_text('{"gains": {"effort": 0.5}}')
    (tuned,) = load_policies(split_name("mine=lqr:a,b/g=1.json")[1])
    assert not np.array_equal(tuned.predict(0.01 * np.ones(36))[0], load_policy("lqr").predict(0.01 * np.ones(36))[0])
    Path("my@lab,a=b.toml").write_text('wind = "windy"\n')
    (own,) = find_scenarios("my@lab,a=b.toml").values()
    assert find_scenarios(["x=my@lab,a=b.toml", "my@lab,a=b.toml:my@lab,a=b"]) == {"x": own, own.name: own}
    assert find_scenarios("my@lab,a=b.toml@hummingbird") == {
        f"{own.name} · hummingbird": own.with_vehicle("hummingbird")
    }
    Path("twice.json").write_text('{"seed": 1, "seed": 2}')
    assert "has the key 'seed' twice" in refused(["train", "--settings", "twice.json"], capsys)
    assert "are the same policy" in refused(["evaluate", f"{FILE},./{FILE}"], capsys)
