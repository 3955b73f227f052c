"""The scripts in `train/` and `docs/examples/` run without changes, with fewer steps."""

import importlib
import runpy
import subprocess
import sys
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from quadpend_baselines.hybrid.lab import LAGS
from quadpend_train.policies.loading import load_policy
from tests.helpers.scenarios import shorten_scenarios
from tests.helpers.sources import ROOT

Run = Callable[..., str]


@pytest.fixture
def run_script(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run a script with arguments as `python` does, but in this process, and return what it prints."""
    shorten_scenarios(monkeypatch, 1.0)
    monkeypatch.chdir(tmp_path)

    def run(name: str, *arguments: str) -> str:
        monkeypatch.setattr(sys, "argv", [name, *arguments])
        runpy.run_path(str(ROOT / name), run_name="__main__")
        return capsys.readouterr().out

    return run


def test_ppo_script_trains_saves_and_evaluates_a_model(run_script: Run, tmp_path: Path) -> None:
    assert "mean return" in run_script("train/ppo.py", "--total-timesteps", "2000")
    assert (tmp_path / "ppo.zip").is_file()


def test_the_script_for_a_gpu_trains_on_the_processor(run_script: Run, tmp_path: Path) -> None:
    arguments = "--device", "c", "--num-envs", "32", "--num-steps", "16", "--minibatches", "2", "--seconds", "1"
    assert "survival" in run_script("train/ppo_gpu.py", *arguments)
    assert (tmp_path / "ppo_gpu.pt").is_file()


@pytest.mark.extras
def test_the_script_for_measurements_alone_trains_on_the_processor(run_script: Run, tmp_path: Path) -> None:
    scenarios = "--scenarios", "wind", "pole 0.8", "catch"
    sizes = "--seeds", "0", "1", "--rows", "2", "--imitation", "2", "--gradients", "1", "--without", "lags"
    out = run_script("train/lab.py", "--device", "c", "--out", str(tmp_path / "lab"), *scenarios, *sizes)
    assert "improve 1" in out
    policies = [load_policy(str(tmp_path / "lab" / f"lab-{seed}.npz")) for seed in range(2)]
    first, second = (policy.layers[0][0] for policy in policies)
    assert not np.array_equal(first, second)
    assert (first[LAGS] == 0.0).all()
    assert np.count_nonzero(first) == first.size - first[LAGS].size


@pytest.mark.extras
def test_its_training_goes_on_after_an_interruption_as_without_one(tmp_path: Path) -> None:
    script, weights = runpy.run_path(str(ROOT / "train/lab.py")), []
    sizes = "--rows", "2", "--imitation", "3", "--gradients", "2", "--scenarios", "wind", "dropouts", "--seeds", "3"
    given = "--device", "c", "--kernels", str(tmp_path), *sizes
    for name, interrupted in (("whole", ""), ("resumed", "imitate 7"), ("resumed", "improve 5"), ("resumed", "")):
        trainer = script["Trainer"](
            script["parse"]([*given, "--out", str(tmp_path / name)]), script["Networks"]([3], [])
        )

        def report(head: str, last: str = interrupted) -> None:
            if last and head.startswith(last):
                raise KeyboardInterrupt

        trainer.report = report
        with pytest.raises(KeyboardInterrupt) if interrupted else nullcontext():
            weights.append(trainer.train()[0].layers[0][0])
    np.testing.assert_array_equal(*weights)


@pytest.mark.extras
def test_its_gradient_is_a_finite_difference(tmp_path: Path) -> None:
    """Of the cost of a window of two networks, with respect to a bias of each, from the same flight."""
    script = runpy.run_path(str(ROOT / "train/lab.py"))
    arguments = "--device", "c", "--kernels", str(tmp_path), "--seeds", "0", "1", "--rows", "3"
    settings, networks = script["parse"]([*arguments, "--scenarios", "wind", "late"]), script["Networks"]([0, 1], [])
    trainer = script["Trainer"](settings, networks)
    script["Trainer"].improve.__globals__.update(WINDOW=20, RESTARTED=0.0)
    flight, bias, gradient = trainer.flight, trainer.networks.biases[2], []
    trainer.noise.zero_()
    for _ in range(15):  # the teacher flies
        trainer.imitate()
    flown = flight.seen, flight.action, flight.memory, *(x for e in flight.envs for x in (e._memory, e.clock))
    before, losses = [item.clone() for item in flown], []
    trainer.descend = lambda loss: losses.append(loss) or (torch.autograd.backward(loss.sum()))
    for shift in (0.0, 1e-3, -1e-3):
        for item, value in zip(flown, before, strict=True):
            item.copy_(value)
        bias.data[:, 0, 1] += shift
        bias.grad = None
        trainer.improve()
        gradient.append(bias.grad[:, 0, 1])
        bias.data[:, 0, 1] -= shift
    slope = (losses[1] - losses[2]).detach() / 2e-3
    np.testing.assert_allclose(gradient[0], slope, rtol=0.03, atol=0.02 * slope.abs().max())


@pytest.fixture
def ablations(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(ROOT / "train"))
    yield importlib.import_module("ablations")
    del sys.modules["ablations"], sys.modules["lab"]


@pytest.fixture
def recurrent_trainer(ablations: Any, tmp_path: Path) -> Any:
    sizes = "--rows", "4", "--imitation", "2", "--gradients", "1", "--scenarios", "wind", "catch"
    return ablations.RecurrentTrainer(ablations.parse(["--device", "c", "--out", str(tmp_path), *sizes]))


@pytest.mark.extras
def test_networks_with_recurrent_units_learn_and_fly_as_in_their_training(
    ablations: Any, recurrent_trainer: Any
) -> None:
    trainer, flight = recurrent_trainer, recurrent_trainer.flight
    first = [item.clone() for item in trainer.networks.units.parameters()]
    policies = ablations.recurrent(trainer.networks, trainer.train())
    assert not any(torch.equal(*pair) for pair in zip(first, trainer.networks.units.parameters(), strict=True))
    flying, memories = [policy.adapt(flight.envs[0].scenario) for policy in policies], [None] * len(policies)
    flight.begin(0)
    for _ in range(30):
        with torch.no_grad():
            inputs, memory = trainer.inputs(flight.seen, flight.action, flight.memory)
            action = trainer.act(inputs)[0].clamp(-1.0, 1.0)
        for i, policy in enumerate(flying):
            rows = slice(4 * i, 4 * i + 4)
            own, memories[i] = policy.predict(flight.seen[:, rows].T.numpy(), memories[i], flight.begun[rows].numpy())
            np.testing.assert_allclose(own, action[:, rows].T, rtol=0, atol=1e-4)
        observed, begun, _ = flight.step(action)
        flight.keep(observed, action, memory, begun)


@pytest.mark.extras
def test_recurrent_units_are_fitted_as_they_flew_also_where_episodes_end(
    ablations: Any, recurrent_trainer: Any
) -> None:
    trainer, losses, ended = recurrent_trainer, [], 0
    fit, trainer.descend = trainer.fit, losses.append
    trainer.share.zero_()  # the untrained networks fly, and fall

    def checked(inputs: Any, labels: Any) -> None:
        nonlocal ended
        ended += sum(int((units == 0.0).all(2).sum()) for units in trainer.remembered[1:])
        fit(inputs, labels)
        flown = [ablations.imitation_loss(trainer.networks(x), y) for x, y in zip(inputs, labels, strict=True)]
        torch.testing.assert_close(torch.stack(losses).mean(0), torch.stack(flown).mean(0))
        losses.clear()

    trainer.fit = checked
    for _ in range(12):
        trainer.imitate()
    assert ended


def test_sac_script_trains_saves_and_evaluates_a_model(run_script: Run, tmp_path: Path) -> None:
    assert "It balances in" in run_script("train/sac.py", "--total-timesteps", "2000")
    assert (tmp_path / "sac.zip").is_file()


def test_the_loop_in_the_manner_of_cleanrl_trains(run_script: Run) -> None:
    assert "update 0: mean length of an episode" in run_script("docs/examples/ppo_as_in_cleanrl.py", "--updates", "1")


def test_a_script_runs_as_train_py_beside_folders_with_the_names_of_our_packages(tmp_path: Path) -> None:
    for package in ("baselines", "benchmarks", "tests"):
        (tmp_path / package).mkdir()
        (tmp_path / package / "__init__.py").touch()
    script = (ROOT / "train/ppo.py").read_text(encoding="utf-8")
    assert "default=3_000_000" in script
    (tmp_path / "train.py").write_text(script.replace("default=3_000_000", "default=64"), encoding="utf-8")
    ran = subprocess.run([sys.executable, "train.py"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
