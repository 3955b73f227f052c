"""The scripts measure what their pages say, in brief runs."""

from pathlib import Path

import numpy as np
import pytest

from experiments import ablations, situation, tasks
from experiments.pages import fill
from quadpend_baselines.hybrid.situation import SITUATION_SIZE
from quadpend_train.policies.mlp_policy import FORMAT, MlpPolicy
from quadpend_train.training.settings import to_mapping
from tests.helpers.policies import synthetic_comparison, synthetic_results


def test_a_part_of_a_page_is_replaced_and_the_rest_stays(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# Title\n<!-- begin a -->\nold\n<!-- end a -->\nend\n")
    fill(page, {"a": r"new \1"})
    assert page.read_text() == "# Title\n<!-- begin a -->\n\nnew \\1\n\n<!-- end a -->\nend\n"
    with pytest.raises(ValueError, match="must contain <!-- begin b -->"):
        fill(page, {"b": "text"})


def test_episodes_that_fall_or_end_away_have_not_settled() -> None:
    error = [[0.1] * 200 + [0.01] * 800, [0.1] * 600 + [0.01] * 400, [0.01] * 950 + [0.1] + [0.01] * 49, [0.1] * 1000]
    results = synthetic_results(np.ones(4), [True, True, True, False])._replace(error=np.array([error], np.float32))
    found = tasks.settling(synthetic_comparison(one=[results]), ("s0", "one"))
    assert found["settled"].value == pytest.approx(50.0)
    assert found["settled_soon"].value == pytest.approx(25.0)
    assert found["penalised_time"].value == pytest.approx((2.0 + 6.0 + 10.0 + 10.0) / 4)
    assert found["penalised_time"].high == 10.0


def test_references_are_feasible_up_to_the_acceleration_that_the_thrust_allows() -> None:
    assert tasks.feasible_shares(1.0, 20, 0) == (1.0, 1.0, 1.0)
    assert tasks.feasible_shares(17.5, 20, 0).both == 0.0  # twice the hover thrust: g √3 = 17 m/s² on a wide circle
    found = tasks.feasible_shares(14.0, 50, 0)
    assert 0.0 < found.torques < found.thrust < 1.0


ONE_SETTING = ("deso", "kalman", "gsde", "residual-action-relative-reward", "gain-scheduling-relative-reward")


@pytest.mark.parametrize("name", ablations.ABLATIONS)
def test_the_two_trainings_of_an_ablation_differ(name: str) -> None:
    without, added = (to_mapping(settings) for settings in ablations.settings_pair(ablations.ABLATIONS[name], 4))
    assert without != added
    assert without["seed"] == added["seed"] == 4
    if name in ONE_SETTING:
        without, added = ({**settings, "hybrid": None, **settings["hybrid"]} for settings in (without, added))
        assert sum(without[key] != added[key] for key in without) == 1


def adaptive_policy() -> MlpPolicy:
    random, size = np.random.default_rng(0), 45 + SITUATION_SIZE
    layers = [
        (0.1 * random.normal(size=shape).astype(np.float32), np.zeros(shape[1], np.float32))
        for shape in ((2 * size, 5), (5, 4))
    ]
    hybrid = {"kind": "estimate_only", "base_controller": "flatness", "situation": True}
    card = {"format": FORMAT, "activation": "tanh", "squashed": False, "hybrid": hybrid, "input_scales": [8.0]}
    card |= {"action_repeat": 1, "settings": {"scenarios": ["windy"]}}
    return MlpPolicy(layers, card)


def test_a_policy_with_the_mean_situation_acts_as_it_would_in_that_situation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(situation, "EPISODES_OF_MEAN", 2)
    policy = adaptive_policy()
    other = situation.with_mean_situation(policy)
    assert isinstance(other.hybrid, situation.MeanSituation)
    assert other.hybrid.table[-1, 6] > 0.1  # N, of the wind
    observation = np.random.default_rng(1).normal(scale=0.1, size=(3, 36)).astype(np.float32)
    memory = None
    for step in range(3):
        seen, _ = policy.hybrid.observe(observation, memory and memory.hybrid, np.full(3, memory is None))  # type: ignore[union-attr]
        seen[:, -SITUATION_SIZE:] = other.hybrid.table[step]
        action, memory = other.predict(observation, memory)
        np.testing.assert_array_equal(action, policy.forward(seen))
