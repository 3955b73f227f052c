"""Names, terminals and files that are unusual or damaged end in a readable result or in one sentence."""

import errno
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from quadpend_gym.tasks.observation import OBSERVATION_SIZE
from quadpend_train.cli.main import main
from quadpend_train.common.text import brief, figure_text, markdown_text
from quadpend_train.policies.mlp_policy import MlpPolicy
from tests.helpers.policies import mlp_policy
from tests.helpers.scenarios import shorten_scenarios
from tests.quadpend_train.cli.test_commands import refused

NAMES = (r"$\frac$", "[red]bold", "a|b", "<b>x")
FILE = "d[/b]"  # its name has no slash
POLICIES = [*(f"{name}={policy}" for name, policy in zip(NAMES, ("lqr", "lqi", "flatness", "lqr"), strict=True)), FILE]


@pytest.fixture
def brief_scenarios(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    shorten_scenarios(monkeypatch, 0.2)
    monkeypatch.chdir(tmp_path)
    Path(FILE).parent.mkdir()
    mlp_policy(OBSERVATION_SIZE).save(FILE)


@pytest.mark.usefixtures("brief_scenarios")
def test_names_are_text_everywhere(capsys: pytest.CaptureFixture[str]) -> None:
    main(["evaluate", *POLICIES, "--scenarios", "calm", r"$\x|y$=windy", "--episodes", "2", "--replay", "0"])
    printed = capsys.readouterr()
    assert all(name in printed.out for name in (*NAMES, FILE))
    assert "recording" not in printed.err  # the bar of the replay
    page = Path("results/comparison.md").read_text(encoding="utf-8")
    rows = [line for line in page.splitlines() if line.startswith("| calm")]
    assert len({len(re.findall(r"(?<!\\)\|", row)) for row in rows}) == 1
    assert r"| a\|b |" in page
    assert r"\<b>x" in page
    assert "<b>x" not in Path("results/report.html").read_text(encoding="utf-8")


def test_texts_are_escaped_for_their_place() -> None:
    assert markdown_text("a|b $x$ <i>\nc") == r"a\|b \$x\$ \<i> c"
    assert figure_text(r"$\frac$") == r"\$\frac\$"
    assert brief(ValueError("a\nb\x00c")) == "a b?c"
    assert len(brief(ValueError("x" * 5000))) == 200


def test_a_terminal_may_lack_characters(tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONIOENCODING": "ascii", "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-m", "quadpend_train", "card", "flatness"]
    ran = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, check=False)
    assert ran.returncode == 0
    assert b"position_bandwidth" in ran.stdout
    assert ran.stderr == b""


def test_a_damaged_policy_file_ends_in_a_short_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The message of zipfile about a header that does not fit contains the header, which can have 64 kB."""
    path = tmp_path / "damaged.npz"
    mlp_policy(OBSERVATION_SIZE).save(path)
    data = bytearray(path.read_bytes())
    start = data.index(b"PK\x01\x02")
    data[26:28] = (5000).to_bytes(2, "little")  # the length of the first file's name, in its local header
    path.write_bytes(data)
    for message in (refused(["card", str(path)], capsys), refused(["evaluate", str(path), "lqr"], capsys)):
        assert len(message) < 400 + len(str(path))
        assert message.replace("\n", "").isprintable()
    random = np.random.default_rng(0)
    for _ in range(40):
        broken = bytearray(data)
        broken[random.integers(start, len(data))] ^= 1 << random.integers(8)
        path.write_bytes(broken)
        with pytest.raises(ValueError, match="damaged") as caught:
            MlpPolicy.load(path)
        assert len(str(caught.value)) < 400 + len(str(path))


LONG = "a" * 300
REFUSED = {
    "evaluate lqr --episodes 1000000000": "episodes must be a whole number from 1 to 100000, not 1000000000",
    "evaluate lqr --replay 1000000000": "replay must be a whole number from 0 to 1000, not 1000000000",
    "evaluate lqr --jobs 0": "jobs must be at least 1, not 0",
    "evaluate lqr --seed 99999999999999999999": "seed must be a whole number from 0 to",
    "tune lqr --trials 1000000000": "trials must be a whole number from 1 to",
    "train --num-envs 1000000000": "num_envs must be a whole number from 1 to",
    f"evaluate {LONG}": f"a file cannot be read or written: {LONG}: File name too long",
    f"watch lqr --out {LONG}.png": "File name too long",
    "export model.zip --out file/x.npz": "the folder of out must be a folder that can be written, not file",
    **{
        f"{command} --out {folder}": "out must be a folder that can be written, not"
        for command in ("evaluate lqr", "train", "tune lqr", "paper")
        for folder in ("file/x", LONG)
    },
}


@pytest.mark.parametrize("command", REFUSED)
@pytest.mark.usefixtures("no_work")
def test_impossible_numbers_and_paths_are_refused_before_any_work(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("file").touch()
    assert REFUSED[command] in refused(command.split(), capsys)


@pytest.fixture
def no_work(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*arguments: object, **settings: object) -> None:
        raise AssertionError("work has begun")

    monkeypatch.setattr("quadpend_train.evaluation.episodes.run_episodes", fail)
    monkeypatch.setattr("quadpend_train.training.train.train", fail)


FAULTS = {
    OSError(errno.ENOSPC, "No space left on device", "x.npz"): "x.npz: No space left on device; what was written",
    OSError(errno.EROFS, "Read-only file system"): "a file cannot be read or written: Read-only file system",
    MemoryError("Unable to allocate 1 TiB"): "there is too little memory: ask for less, such as fewer episodes",
}


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: type(fault).__name__)
def test_faults_of_the_machine_are_one_sentence(
    fault: Exception, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*arguments: object) -> None:
        raise fault

    monkeypatch.setattr("quadpend_train.cli.main._run", fail)
    assert FAULTS[fault] in refused(["list"], capsys)


def test_a_full_disk_of_the_output_is_one_sentence() -> None:
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        command = [sys.executable, "-m", "quadpend_train", "list", "tasks"]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
        ran = subprocess.run(command, env=environment, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert ran.returncode == 2
    assert ran.stderr.count("\n") == 1
    assert "No space left on device" in ran.stderr
