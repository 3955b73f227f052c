"""The benchmarks run with small sizes."""

import re
import shutil
from pathlib import Path

import pytest

from benchmarks import golden, golden_cases, gpu, peers, speed
from quadpend_baselines import CONTROLLERS
from quadpend_train.policies.loading import shipped_policies
from tests.helpers.sources import ROOT


@pytest.fixture
def brief(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(speed, "NUM_ENVS", (1, 4))
    monkeypatch.setattr(speed, "_SECONDS", 1e-4)
    monkeypatch.setattr(speed, "_ROUNDS", 1)


@pytest.fixture
def page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the page that the benchmarks update."""
    for module in (speed, peers):
        monkeypatch.setattr(module, "DOCS", tmp_path)
    monkeypatch.setattr("sys.argv", ["speed"])
    return Path(shutil.copy(ROOT / "docs/accuracy.md", tmp_path))


def test_speed_writes_a_rate_for_every_environment(brief: None, page: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(speed, "measure_start", lambda: {"import": 0.1})
    speed.main()
    text = page.read_text(encoding="utf-8")
    assert "| environment | single | 1 | 4 |" in text
    for name in ("calm", "wind", "hummingbird", "everything", "CartPole-v1"):
        assert re.search(rf"\| {name} \| [\d,.–]+ \| [\d,.]+ \| [\d,.]+ \|", text)
    assert "| import | 0.10 s |" in text


def test_golden_hashes_are_repeatable_and_a_different_hash_is_reported(tmp_path: Path) -> None:
    names = {
        "environments": "QuadPendulumHover-v0, everything, single",
        "episodes": "lqr, windy",
        "trainings": "ppo with gSDE",
    }

    def hashes() -> dict[str, str]:
        parts = [golden.compute(f"{part}: {only}") for part, only in names.items()]
        return {name: value for part in parts for name, value in part.items()}

    first = hashes()
    assert [*first] == [f"{part}: {name}" for part, name in names.items()]
    assert golden.check(tmp_path / "golden.json", first) == []
    assert golden.check(tmp_path / "golden.json", hashes()) == []
    changed = {**first, "episodes: lqr, windy": "another"}
    assert golden.check(tmp_path / "golden.json", changed) == ["episodes: lqr, windy"]


def test_golden_hashes_cover_every_controller_and_shipped_policy() -> None:
    assert golden_cases.FLIGHTS.keys() == {*CONTROLLERS, *(name.removesuffix("-0") for name in shipped_policies())}


@pytest.mark.filterwarnings("ignore:.*a policy trained on the vehicle")
@pytest.mark.parametrize("name", sorted(shipped_policies()))
def test_golden_hashes_fly_each_shipped_policy(name: str) -> None:
    flight = f"episodes: {name.removesuffix('-0')}, {next(iter(golden_cases.FLIGHTS[name.removesuffix('-0')]))}"
    assert golden.compute(flight).keys() == {flight}


def test_the_benchmark_of_a_gpu_says_that_there_is_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    monkeypatch.setattr("sys.argv", ["gpu", "--out", str(tmp_path / "gpu.json")])
    gpu.main()
    assert "needs a GPU" in capsys.readouterr().out
    assert not list(tmp_path.iterdir())
