"""Training starts from the network of another policy."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from quadpend_train.cli.main import main
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.training import train as training
from quadpend_train.training.settings import HybridSettings, TrainSettings, read_settings
from tests.helpers.bad_input import assert_refused
from tests.helpers.policies import mlp_policy
from tests.helpers.training import (
    BRIEF,
    BRIEF_SAC,
    train_policy,
    weight_difference,
    with_arguments,
)

SHORTER = replace(BRIEF, total_timesteps=512, save_freq=256)
SHORTER_SAC = replace(BRIEF_SAC, total_timesteps=256, save_freq=128)
RESIDUAL = HybridSettings("flatness", "residual_action", action_scale=0.3)


@pytest.mark.parametrize(
    "settings",
    [
        SHORTER,
        replace(SHORTER, hybrid=RESIDUAL),
        SHORTER_SAC,
        with_arguments(SHORTER_SAC, use_sde=True, train_freq=4),
    ],
    ids=["ppo", "residual action", "sac", "sac, gSDE"],
)
def test_training_starts_with_the_network_of_the_policy(settings: TrainSettings, tmp_path: Path) -> None:
    """The rest of the model is the untrained model of the settings."""
    start, fresh = train_policy(settings, tmp_path), training.initial_model(replace(settings, seed=1))
    model = training.initial_model(replace(settings, start_from=str(tmp_path), seed=1))
    assert weight_difference(training.export(model, **settings.policy_interface()), start) == 0.0
    arrays, others = model.policy.state_dict(), fresh.policy.state_dict()
    changed = {name for name in arrays if not bool((arrays[name] == others[name]).all())}
    actor = ("mlp_extractor.policy_net", "action_net") if settings.algo == "ppo" else ("actor.latent_pi", "actor.mu")
    assert changed == {name for name in arrays if name.startswith(actor)}


def test_training_on_estimates_starts_with_a_policy_of_the_true_state(tmp_path: Path) -> None:
    """The estimates of the disturbance are inputs without weight at first."""
    start = train_policy(SHORTER, tmp_path)
    observed = replace(SHORTER, hybrid=HybridSettings("lqr"), start_from=str(tmp_path), seed=1)
    model = training.initial_model(observed)
    (weights, _), (first, _) = training.export(model, **observed.policy_interface()).layers[0], start.layers[0]
    assert weights[: len(first)].tolist() == first.tolist()
    assert len(weights) > len(first)
    assert not weights[len(first) :].any()


def network(**changes: Any) -> dict[str, Any]:
    """Return the arguments of PPO with a network like that of `mlp_policy`."""
    return {**BRIEF.arguments, "policy_kwargs": {"net_arch": (8, 6), **changes}}


def test_fine_tuned_policy_is_trained_again_while_its_start_exists(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    start = tmp_path / "start.npz"
    train_policy(SHORTER, tmp_path / "first")
    start.write_bytes((tmp_path / "first/policy.npz").read_bytes())
    main(["train", "--start-from", str(start), "--seed", "4", "--out", str(tmp_path / "run")])
    settings = read_settings(str(tmp_path / "run/settings.json"))
    assert settings == replace(SHORTER, start_from=str(start), seed=4)  # other settings are those of the policy
    again = ["train", "--settings", str(tmp_path / "run/policy.npz"), "--out"]
    main([*again, str(tmp_path / "again")])
    policies = [MlpPolicy.load(tmp_path / name / "policy.npz") for name in ("run", "again")]
    assert weight_difference(*policies) == 0.0
    start.unlink()
    with pytest.raises(SystemExit):
        main([*again, str(tmp_path / "third")])
    assert "there is no policy" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"arguments": network(net_arch=(8, 7))}, r"widths \[36, 8, 6, 4\], but the settings have \[36, 8, 7, 4\]"),
        ({"arguments": network(activation_fn="tanh")}, "has activation 'relu', but the settings have 'tanh'"),
        ({"input_scales": (8.0,)}, r"has input_scales None, but the settings have \[8.0\]"),
        ({"hybrid": RESIDUAL}, "has hybrid None, but the settings have {'kind': 'residual_action'"),
        (
            {"algo": "sac", "arguments": {"policy_kwargs": {"net_arch": (8, 6)}}},
            "has squashed False, but the settings have True",
        ),
        ({"start_from": "adrc-paper"}, "must be a learned policy with a feedforward network, not adrc-paper"),
        ({"start_from": "nix"}, "there is no policy 'nix'"),
        ({"start_from": "ppo-alone-0"}, "ppo-alone-0 has .*, but the settings have"),
        ({"hybrid": HybridSettings("lqr", imitation_timesteps=64)}, "imitation_timesteps must be 0 with start_from"),
    ],
    ids=str,
)
def test_policy_that_does_not_fit_the_settings_is_refused(changes: Any, message: str, tmp_path: Path) -> None:
    mlp_policy(36).save(tmp_path / "start.npz")
    given = {"arguments": network(), "start_from": str(tmp_path / "start.npz"), **changes}
    assert_refused(lambda: train_policy(replace(BRIEF, **given), tmp_path / "run"), message, (ValueError, TypeError))
    assert not (tmp_path / "run").exists()


def test_policy_that_commands_something_else_is_no_start(tmp_path: Path) -> None:
    start = tmp_path / "start.npz"
    scenario = '{"vehicle": "hummingbird", "interface": "body_rates"}'
    rates = replace(
        BRIEF,
        arguments=network(),
        start_from=str(start),
        scenarios=(scenario,),
    )
    mlp_policy(36, interface="wrench").save(start)
    assert_refused(
        lambda: training.initial_model(rates), "start.npz: the policy was trained with the interface 'wrench'"
    )
    mlp_policy(36, interface="body_rates", vehicle="hummingbird").save(start)
    training.initial_model(rates)
    assert_refused(lambda: training.initial_model(replace(rates, scenarios=("calm",))), "'body_rates'.*'wrench'")
