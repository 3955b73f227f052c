"""A card that does not describe its policy is refused when the policy is loaded, before anything flies."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadpend_train.cli.main import main
from quadpend_train.policies.mlp_policy import SHIPPED, MlpPolicy
from tests.helpers.bad_input import assert_refused
from tests.helpers.policies import card, layers

SHIPPED_CARD = MlpPolicy.load("ppo-gain-scheduling-0").card
DESCRIPTION = {
    name: SHIPPED_CARD[name]
    for name in ("settings", "seed", "steps", "best_at", "seconds", "score", "curve", "scenarios", "provenance")
}
SETTINGS, PROVENANCE = DESCRIPTION["settings"], DESCRIPTION["provenance"]


def policy(fields: dict[str, Any]) -> MlpPolicy:
    return MlpPolicy(layers(36, 8, 6, 4), card(**fields))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"curve": [[]]}, "curve must be a list of .*, not "),
        ({"curve": [1, 2]}, "curve must be"),
        ({"curve": "no curve"}, "curve must be"),
        ({"curve": {}}, "curve must be"),
        ({"curve": [[0, 0.5, "ä", 0.1], [1, 0.5, 0.5, 0.1]]}, "curve must be"),
        ({"curve": [[0, 0.5, 0.5], [1, 0.5, 0.5]]}, "curve must be"),
        ({"curve": [[1, 0.5, 0.5, 0.1], [1, 0.5, 0.5, 0.1]]}, "curve must be"),
        ({"curve": [[0, float("nan"), 0.5, 0.1]]}, "curve must be"),
        ({"curve": [[0, 10**400, 0.5, 0.1]]}, "curve must be"),
        ({"scenarios": {}}, "scenarios must be a mapping from at least one scenario"),
        ({"scenarios": []}, "scenarios must be"),
        ({"settings": {**SETTINGS, "scenarios": []}}, "settings.scenarios must be at least one scenario"),
        ({"settings": {**SETTINGS, "scenarios": 3}}, "settings.scenarios must be"),
        ({"settings": {**SETTINGS, "algo": 3}}, "settings.algo must be a text, not 3"),
        ({"settings": {}}, "the card must have settings.algo"),
        ({"settings": [3]}, "settings must be a mapping"),
        ({"action_repeat": 10**30}, "action_repeat must be an integer from 0 to 10000000, not 10{29}"),
        ({"seed": 10**30}, "seed must be an integer"),
        ({"steps": "many"}, "steps must be an integer of at least 0, not 'many'"),
        ({"seconds": None}, "seconds must be a finite number"),
        ({"score": {"survival": 2.0, "penalised_rmse": 0.1}}, "score must be"),
        ({"score": 1.0}, "score must be"),
        ({"provenance": {"commit": None}}, "the card must have provenance.python"),
        ({"provenance": {**PROVENANCE, "packages": ["numpy"]}}, "provenance.packages must be"),
        ({"provenance": {**PROVENANCE, "continued_at": 3}}, "provenance.continued_at must be"),
        ({"provenance": {**PROVENANCE, "start_from": "x"}}, "provenance.start_from must be"),
    ],
    ids=lambda value: str(value)[:40],
)
def test_wrong_description_is_refused(fields: dict[str, Any], message: str, tmp_path: Path) -> None:
    policy(DESCRIPTION | fields).save(tmp_path / "policy.npz")
    assert_refused(lambda: MlpPolicy.load(tmp_path / "policy.npz"), f"policy.npz is not a policy file: .*{message}")


def test_missing_field_of_a_trained_policy_is_refused(tmp_path: Path) -> None:
    for name in ("steps", "best_at", "seconds", "seed", "curve"):
        fields = {key: value for key, value in DESCRIPTION.items() if key != name}
        policy(fields).save(tmp_path / "policy.npz")
        assert_refused(lambda: MlpPolicy.load(tmp_path / "policy.npz"), f"the card must have {name}")


def test_command_refuses_the_card_before_any_flight(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("quadpend_train.evaluation.jobs.Job.__call__", lambda _: 1 / 0)
    policy(DESCRIPTION | {"curve": [1, 2]}).save(tmp_path / "policy.npz")
    paths = ["--out", str(tmp_path / "out"), "--cache", str(tmp_path / "cache")]
    with pytest.raises(SystemExit, match="2"):
        main(["evaluate", "lqr", str(tmp_path / "policy.npz"), "--scenarios", "calm", "--episodes", "1", *paths])
    assert "curve must be a list of" in capsys.readouterr().err


def test_policies_with_and_without_a_description_are_loaded(tmp_path: Path) -> None:
    known = Path(__file__).parents[2] / "data/version_0_1/ppo-pace-0.npz"
    for path in [*sorted(SHIPPED.glob("*.npz")), known]:
        MlpPolicy.load(path)
    for fields in ({}, {"settings": {}}, {"source": "model.zip"}, DESCRIPTION):
        policy(fields).save(tmp_path / "policy.npz")
        assert np.isfinite(MlpPolicy.load(tmp_path / "policy.npz").layers[0][0]).all()
