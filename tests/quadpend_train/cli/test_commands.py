"""The command line: overview, lists, errors in one sentence, and paths checked before work."""

import os
import re
import subprocess
import sys
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import pytest

from quadpend_baselines import CONTROLLERS
from quadpend_gym import __version__, actuators, sensors, wind
from quadpend_gym.scenarios import SCENARIOS, SETS, as_scenario, find_scenario
from quadpend_gym.tasks.task import TASKS
from quadpend_gym.vehicles import POLES, VEHICLES
from quadpend_gym.vehicles.vehicle import as_vehicle
from quadpend_train.cli.main import COMMANDS, FUNCTIONS, main
from quadpend_train.cli.training import default_settings
from quadpend_train.policies.loading import shipped_policies
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.training.settings import PRESETS, read_settings, to_mapping
from tests.helpers.sources import ROOT
from tests.helpers.training import interrupt_at
from tests.quadpend_gym.vehicles.test_bad_vehicles import GOOD

BLOCKED = """
import sys
class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == {blocked!r}:
            raise ModuleNotFoundError(name=name)
sys.meta_path.insert(0, Blocked())
from quadpend_train.cli.main import main
main({arguments})
"""


def refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """The sentence on stderr with which a command ends."""
    with pytest.raises(SystemExit, match="2"):
        main(arguments)
    sentence = capsys.readouterr().err
    assert sentence.startswith("quadpend: ")
    assert sentence.count("\n") == 1
    return sentence


def test_overview_docs_and_docstrings_have_the_same_line_for_each_command(capsys: pytest.CaptureFixture[str]) -> None:
    main([])
    main(["--version"])
    printed = capsys.readouterr().out
    assert printed.endswith(f"\nquadpend {__version__}\n")
    page = (ROOT / "docs/command-line.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `quadpend (\w+)` \| (.*) \|$", page, re.MULTILINE)
    assert rows == [(name, summary) for name, summary in COMMANDS.items()]
    for name, summary in COMMANDS.items():
        assert f"\n  {name:<11}{summary}\n" in printed
        module, function = FUNCTIONS[name].split(".")
        found = getattr(import_module(f"quadpend_train.cli.{module}"), function)
        assert found.__doc__.splitlines()[0] == summary


def test_the_help_of_train_has_all_presets_and_settings_on_two_screens(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    main(["train", "--help", "--algo", "apg"])
    printed = capsys.readouterr().out
    for path in PRESETS.glob("*.toml"):
        assert re.search(rf"^  {path.stem} +\S", printed, re.MULTILINE)
    given = to_mapping(read_settings("apg"))
    names = [name for table in ("hybrid", "reward", "apg") for name in (f"{table}.{key}" for key in given[table])]
    for name in [*names, *(name for name, value in given.items() if not isinstance(value, dict))]:
        assert re.search(rf"^  --{name.replace('_', '-')}( .*)?  +\S", printed, re.MULTILINE), name
    assert "  --num-envs 240 " in printed  # the default of this preset
    main(["train", "--help"])
    assert capsys.readouterr().out.count("\n") <= 100


def test_train_needs_no_options() -> None:
    assert default_settings([]) == {"run": read_settings("ppo")}


def test_the_overview_imports_no_library() -> None:
    code = "import sys; from quadpend_train.cli.main import main; main([]); print(*sys.modules)"
    ran = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert not {"numpy", "gymnasium", "numba", "tyro", "torch"} & set(ran.stdout.split())


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["evalute"], "there is no command 'evalute' (did you mean 'evaluate'?); the commands are list, train"),
        (["evaluate", "--scenarios", '{"wind": "strom"}'], "there is no wind 'strom' (did you mean 'storm'?)"),
        (
            ["preflight", "lqg", "--scenario", "flight-motion"],
            "a data sheet is of one scenario: choose one of flight_circle",
        ),
        (["export", "ppo-alone"], "there is no policy 'ppo-alone' (did you mean 'ppo-alone-0'?)"),
    ],
    ids=lambda item: " ".join(item) if isinstance(item, list) else "",
)
def test_unknown_names_are_refused_with_the_most_similar_one(
    arguments: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert sentence in refused(arguments, capsys)


@pytest.mark.parametrize(
    ("module", "command", "extra"),
    [
        ("tyro", "list", "train"),
        ("torch", "train --out here", "train"),
        ("optuna", "tune lqr --out here", "train"),
        ("pygame", "watch flatness --out here.png", "view"),
    ],
)
def test_a_missing_extra_is_named_in_one_sentence(module: str, command: str, extra: str, tmp_path: Path) -> None:
    code = BLOCKED.format(blocked=module, arguments=command.replace("here", f"{tmp_path}/a").split())
    ran = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert ran.returncode == 2
    assert re.fullmatch(rf"quadpend: .* needs? {module}.*: pip install 'quadpend-gym\[{extra}\]'\n", ran.stderr)


def test_a_closed_pipe_ends_a_command_quietly() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    command = [sys.executable, "-m", "quadpend_train", "--help"]
    ran = subprocess.run(command, cwd=ROOT, stdout=writer, stderr=subprocess.PIPE, check=False)
    os.close(writer)
    assert ran.returncode == 141
    assert ran.stderr == b""


def test_traceback_is_printed_on_request(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["export", "nix", "--traceback"])
    printed = capsys.readouterr().err
    assert printed.startswith("Traceback")
    assert "\nquadpend: there is no policy 'nix'" in printed


def test_list_has_every_name(capsys: pytest.CaptureFixture[str]) -> None:
    main(["list"])
    tables = dict(re.findall(r"(\w+):\n(.*?)\n\n", capsys.readouterr().out, re.DOTALL))
    listed = {name: {line.split()[0] for line in text.splitlines()} for name, text in tables.items()}
    assert listed["policies"] >= {*CONTROLLERS, *shipped_policies()}
    assert listed["scenarios"] == {*SCENARIOS, *SETS}
    assert listed["settings"] == {path.stem for path in PRESETS.glob("*.toml")}
    expected = {"tasks": set(TASKS), "vehicles": set(VEHICLES), "poles": set(POLES)}
    expected |= {"sensors": set(sensors.KINDS), "actuators": set(actuators.KINDS)}
    assert {name: listed[name] for name in expected} == expected
    assert listed["winds"] == {*wind.PRESETS, *wind.KINDS} - {"sum"}


@pytest.mark.parametrize("name", VEHICLES)
def test_a_printed_vehicle_is_the_file_of_that_vehicle(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["list", "--vehicle", name])
    (tmp_path / "mine.toml").write_text(capsys.readouterr().out, encoding="utf-8")
    assert as_vehicle(tmp_path / "mine.toml") == replace(VEHICLES[name], name="mine")


def test_a_run_is_trained_resumed_and_compared_by_the_commands_that_are_printed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """In the scenarios and with the vehicle as they were given; a resumed run may have other limits only."""
    monkeypatch.chdir(tmp_path)
    Path("mine.toml").write_text(GOOD)
    options = ["--settings", "fast-hummingbird", "--vehicle", "mine.toml", "--num-envs", "4", "--n-eval-episodes", "1"]
    options += ["--set", "ppo.batch_size=64"]
    with monkeypatch.context() as patch:
        interrupt_at(4, patch)
        with pytest.raises(SystemExit, match="130"):
            main(["train", *options, "--out", "run"])
    assert "`quadpend train --resume run` continues the run" in capsys.readouterr().err
    resume = ["train", "--resume", "run"]
    with pytest.raises(SystemExit, match="2"):
        main([*resume, "--seed", "9"])
    assert "may change max_seconds only: seed must be 0" in capsys.readouterr().err
    main([*resume, "--max-seconds", "1e-3"])
    assert "Trained policy: run/policy.npz\n" in capsys.readouterr().out
    card = MlpPolicy.load("run/policy.npz").card
    assert (card["stopped_by"], card["settings"]["max_seconds"]) == ("max_seconds", 1e-3)
    (trained_in,) = card["settings"]["scenarios"]
    assert as_scenario(trained_in) == find_scenario("hummingbird_learning").with_vehicle("mine.toml")
    main(["train", *options, "--max-seconds", "1e-3", "--out", "other"])
    command = "quadpend evaluate flatness mine=other --scenarios hummingbird_learning --vehicle mine.toml"
    assert capsys.readouterr().out.endswith(f": {command}\n")


def test_a_pipe_that_cannot_encode_a_character_gets_another_one() -> None:
    program = f"""if True:
        import subprocess, sys
        from quadpend_train.cli.main import main
        for options in (["list"], ["train", "--help"]):
            sys.argv = ["quadpend", *options]
            try:
                main()
            except SystemExit as end:
                assert not end.code
        subprocess.run([sys.executable, "-c", "print('{chr(0x3C3)}')"], check=True)"""
    variables = {**os.environ, "PYTHONIOENCODING": "ascii", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    done = subprocess.run([sys.executable, "-c", program], env=variables, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith(b"\n?\n")
