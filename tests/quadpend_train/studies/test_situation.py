"""Policies that observe the situation, with and without it."""

import json

import numpy as np
import pytest

from quadpend_baselines.hybrid.situation import SITUATION_SIZE
from quadpend_train.cli.main import main
from quadpend_train.policies.mlp_policy import FORMAT, MlpPolicy
from quadpend_train.studies import situation

HYBRID = {"kind": "estimate_only", "base_controller": "flatness", "situation": True}


def adaptive_policy(scales=(8.0,)):
    random, size = np.random.default_rng(0), 45 + SITUATION_SIZE
    shapes = [((1 + len(scales)) * size, 5), (5, 4)]
    layers = [(0.1 * random.normal(size=shape).astype(np.float32), np.zeros(shape[1], np.float32)) for shape in shapes]
    card = {"format": FORMAT, "activation": "tanh", "squashed": False, "hybrid": HYBRID, "input_scales": list(scales)}
    card |= {"action_repeat": 1, "history": 1, "history_actions": 0, "settings": {"scenarios": ["windy"]}}
    return MlpPolicy(layers, card)


def test_a_policy_with_the_mean_situation_acts_as_it_would_in_that_situation(monkeypatch):
    monkeypatch.setattr(situation, "EPISODES_OF_MEAN", 2)
    policy = adaptive_policy()
    other = situation.with_mean_situation(policy)
    observation = np.random.default_rng(1).normal(scale=0.1, size=(3, 36)).astype(np.float32)
    table, memory = other.hybrid.table, None
    for step in range(3):
        seen, _ = policy.hybrid.observe(observation, memory and memory.hybrid, np.full(3, memory is None))
        seen[:, -SITUATION_SIZE:] = table[step]
        action, memory = other.predict(observation, memory)
        np.testing.assert_array_equal(action, policy.forward(seen))


def test_a_policy_that_does_not_observe_the_situation_is_refused():
    with pytest.raises(ValueError, match="flatness does not observe the situation"):
        situation.adaptive_policies("flatness")


def test_the_mean_situation_of_wind_is_that_of_its_force(monkeypatch):
    monkeypatch.setattr(situation, "EPISODES_OF_MEAN", 2)
    mean = situation.mean_situation(adaptive_policy())
    assert mean.shape[1] == SITUATION_SIZE
    assert mean[-1, 6] > 0.1  # N


def test_the_command_writes_the_differences_of_each_scenario(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(situation, "EPISODES_OF_MEAN", 2)
    adaptive_policy().save(tmp_path / "mine.npz")
    document = tmp_path / "page.md"
    document.write_text("<!-- begin situation -->\n<!-- end situation -->\n")
    scenario = json.dumps({"wind": "windy", "duration": 0.2})
    options = ["--episodes=3", f"--out={tmp_path}", f"--cache={tmp_path / 'cache'}", f"--document={document}"]
    main(["situation", str(tmp_path / "mine.npz"), "--scenarios", f"short={scenario}", *options])
    capsys.readouterr()
    row = json.loads((tmp_path / "situation.json").read_text())["results"]["short"]
    assert row["penalised_rmse"]["value"] == pytest.approx(row["adaptive"]["value"] - row["held"]["value"])
    assert row["penalised_rmse"]["value"] != 0.0
    assert "| short |" in document.read_text()
    assert (tmp_path / "situation.png").is_file()
