"""Policies as C: they command what the Python policy commands, fly like it, and bear any input."""

import re
from dataclasses import replace
from pathlib import Path
from shutil import which
from typing import Any

import numpy as np
import pytest

from experiments.deploy import check
from quadpend_baselines.hybrid.lab import LAB_SIZE
from quadpend_gym.core.arrays import Floats
from quadpend_gym.scenarios import Scenario, find_scenarios
from quadpend_gym.tasks.observation import LAB, OBSERVATION_SIZE, OUTPUT_FEEDBACK_SIZE
from quadpend_train import run_episodes
from quadpend_train.cli.main import main
from quadpend_train.export.to_c import export_c, scenario_for
from quadpend_train.policies.compiled import SAMPLE_SIZE, CPolicy
from quadpend_train.policies.loading import load_policy
from tests.helpers.policies import RESIDUAL_ACTION, mlp_policy

pytestmark = pytest.mark.skipif(which("cc") is None, reason="there is no C compiler")
SANITIZERS = ("-O0", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
SAMPLED = LAB.columns["direction"].stop
DOUBLE, NO_LIBM = "-DQUADPEND_DOUBLE", "-DQUADPEND_NO_LIBM"


def scenario(name: str, **parts: Any) -> Scenario:
    """A scenario with the observation of a lab."""
    return replace(find_scenarios([name])[name], observation="lab", **parts)


POLICIES = {name: scenario("flight_breeze") for name in ("lqg", "apg-flight-0", "apg-vehicles-safe-0")}


@pytest.fixture(scope="module", params=POLICIES)
def exported(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    source = tmp_path_factory.mktemp(request.param) / "policy.c"
    export_c(load_policy(request.param), request.param, POLICIES[request.param], source)
    return source


def name_of(source: Path) -> str:
    """The name of the exported policy."""
    return next(name for name in POLICIES if source.parent.name.startswith(name))


@pytest.mark.parametrize("flags", [(), (DOUBLE, NO_LIBM, *SANITIZERS)], ids=["float", "double"])
def test_golden_vectors_pass_without_warnings(exported: Path, flags: tuple[str, ...]) -> None:
    assert check(exported, *flags).startswith("passed")


HISTORY = {"kind": "history", "observations": 3, "actions": 2}
ON_ADRC = {"kind": "estimate_only", "base_controller": "adrc-matched"}


@pytest.mark.parametrize(
    ("inputs", "hybrid", "flown"),
    [
        (OUTPUT_FEEDBACK_SIZE, None, "windy"),
        (3 * OUTPUT_FEEDBACK_SIZE + 8, HISTORY, "windy"),
        (OUTPUT_FEEDBACK_SIZE + 9, ON_ADRC, "windy"),
        (LAB_SIZE, {"kind": "lab_only", "base_controller": "lqg"}, "flight_breeze"),
        (OBSERVATION_SIZE + 13, {**RESIDUAL_ACTION, "base_controller": "lqi"}, "windy"),
    ],
)
def test_networks_of_every_kind_are_written(inputs: int, hybrid: Any, flown: str, tmp_path: Path) -> None:
    source = tmp_path / "policy.c"
    export_c(mlp_policy(inputs, hybrid=hybrid), "network", scenario(flown), source)
    assert check(source).startswith("passed")
    assert check(source, DOUBLE).startswith("passed")


def test_networks_on_measurements_take_the_same_samples_as_in_python(tmp_path: Path) -> None:
    """A step of the measured place, a set-point far below, a flip of the attitude, and frozen samples."""
    hybrid, breeze = {"kind": "lab_only", "base_controller": "lqg"}, scenario("flight_breeze")
    network, source = mlp_policy(LAB_SIZE, hybrid=hybrid), tmp_path / "policy.c"
    export_c(network, "network", breeze, source)
    policies: list[Any] = [network.adapt(breeze), CPolicy(source, (DOUBLE.removeprefix("-D"),)).adapt(breeze)]
    env, memories, started = breeze.make_vec(2), [None, None], np.ones(2, np.bool_)
    observation, _ = env.reset(seed=0)
    place, turned, wanted = (LAB.columns[name] for name in ("position", "quaternion", "reference_0"))
    actions, seen = [observation, observation], observation
    for step in range(120):
        last, seen = seen, observation.copy()
        seen[:, place.start] += 0.3 * (step >= 30)
        seen[:, wanted.start + 2] -= 1.5 * (step >= 60)
        if step == 80:
            seen[:, turned] = seen[:, turned][:, [1, 0, 3, 2]]
        if 90 <= step < 100:
            seen[:, :SAMPLED] = last[:, :SAMPLED]
        for i, policy in enumerate(policies):
            actions[i], memories[i] = policy.predict(seen, memories[i], started)
        np.testing.assert_allclose(actions[1], actions[0], atol=1e-5)
        observation, _, started, _, _ = env.step(actions[0])


def test_a_file_is_for_the_pole_of_the_vehicle_where_a_scenario_tells_others(tmp_path: Path) -> None:
    source = tmp_path / "policy.c"
    export_c(load_policy("lqg"), "lqg", scenario("event_training_pole_told"), source)
    assert "#define policy_POLE {0.565, 0.05}" in source.with_suffix(".h").read_text()
    assert check(source).startswith("passed")


def vectors(source: Path) -> Floats:
    """The golden vectors, shape (100, 41)."""
    text = source.with_name(f"{source.stem}_check.c").read_text()
    table = text[text.index("vectors[") : text.index("range[4]")]
    return np.array([float(x) for x in re.findall(r"R\(([^()]+)\)", table)]).reshape(-1, SAMPLE_SIZE + 4)


def test_no_input_leads_out_of_the_range_of_the_command(exported: Path) -> None:
    policy, rng, memory = CPolicy(exported).adapt(POLICIES[name_of(exported)]), np.random.default_rng(0), None
    for _ in range(300):
        samples = rng.normal(size=(50, SAMPLE_SIZE)) * 10.0 ** rng.integers(-3, 20, size=(50, 1))
        samples[rng.random(samples.shape) < 0.02] = rng.choice([np.nan, np.inf, -np.inf])
        command, memory = policy.command(samples, memory)
        action = command / policy.scale - [1.0, 0.0, 0.0, 0.0]
        assert (np.abs(action) <= 1.0 + 1e-6).all()


def test_commands_stay_near_without_samples(exported: Path) -> None:
    seen = vectors(exported)[:, :SAMPLE_SIZE]
    policy, memory, commands = CPolicy(exported).adapt(POLICIES[name_of(exported)]), None, []
    for step, sample in enumerate(seen):
        rows = np.stack([sample, sample])
        rows[1, :11] = np.nan if 60 <= step < 70 else rows[1, :11]
        command, memory = policy.command(rows, memory)
        commands.append(command)
    change = np.abs(np.diff(np.array(commands), axis=1) / (2.0 * policy.scale))[60:70]
    assert 0.0 < change.max() < (0.05 if name_of(exported) == "lqg" else 0.5)


def test_a_compiled_policy_flies_like_the_python_one(exported: Path) -> None:
    name = name_of(exported)
    flown = replace(POLICIES[name], duration=4.0)
    ours, theirs = (
        run_episodes([policy], flown, episodes=3, seed=1_000_000)
        for policy in (load_policy(name), load_policy(f"c:{exported}"))
    )
    assert (ours.survived == theirs.survived).all()
    both = ours.survived.ravel()
    errors = [result.penalised_rmse.ravel()[both].mean() for result in (ours, theirs)]
    assert errors[1] == pytest.approx(errors[0], rel=0.01)


@pytest.mark.parametrize(
    ("name", "parts", "message"),
    [
        ("ppo-swing-up-0", {}, "only policies that balance an upright pendulum can"),
        ("nmpc", {}, "nmpc cannot be written as C"),
        ("lqg", {"interface": "rotors", "actuators": ()}, "another --scenario without rotors"),
        ("lqg", {"sensors": {"kind": "delay"}}, "predict no delay of sensors"),
    ],
)
def test_what_cannot_be_written_is_refused(name: str, parts: dict[str, Any], message: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=message):
        export_c(load_policy(name), name, scenario("flight_breeze", **parts), tmp_path / "policy.c")
    assert not list(tmp_path.iterdir())


def test_a_file_is_for_one_period_and_interface(exported: Path) -> None:
    with pytest.raises(ValueError, match="was written for the interface body_rates, not wrench"):
        load_policy(f"c:{exported}").adapt(scenario("windy"))
    with pytest.raises(ValueError, match=r"reads .*which the scenario does not observe"):
        load_policy(f"c:{exported}").adapt(replace(POLICIES[name_of(exported)], observation="output_feedback"))
    with pytest.raises(ValueError, match="there must be a C file"):
        load_policy("c:none.c")


def test_the_command_chooses_a_fitting_scenario_makes_the_folder_and_says_what_works(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = tmp_path / "new" / "apg.c"
    main(["export", "apg-0", "--to", "c", "--out", str(source)])
    assert "Scenario: windy" in capsys.readouterr().out
    assert source.is_file()
    assert scenario_for(load_policy("apg-loops-0"), "apg-loops-0") == "flight_breeze@racer"
    weights, none = tmp_path / "ppo.cleanrl_model", "neither a policy file .* nor a model"
    weights.write_bytes(b"")
    for model, message in (
        (str(weights), none),
        (str(tmp_path), "neither policy.npz nor a model"),
        ("apg-0", "is a policy file already"),
        ("lqg", "is no model of Stable-Baselines3"),
    ):
        with pytest.raises(SystemExit):
            main(["export", model, "--out", str(tmp_path / "out.npz")])
        assert re.search(message, capsys.readouterr().err)
