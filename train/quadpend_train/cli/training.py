"""The commands about learned policies: `train`, `export`, `card` and `reproduce`.

The parameters of these functions are the options of the commands. Slow imports are inside the functions, so that
`quadpend --help` starts quickly.
"""

import json
import sys
from pathlib import Path
from typing import Annotated

import tyro

from quadpend_train.scenarios import find_scenario, scenario_hash
from quadpend_train.training.settings import TrainSettings, from_mapping, read_settings

DEFAULT_SETTINGS = "demo"
DEFAULT_OUT = Path("runs/latest")


def settings_of(start_from: str | None) -> str:
    """Return the settings of a training that starts from a policy: the file of the policy, whose card has them.

    Args:
        start_from: The policy as for `load_policy`, or None.

    Returns:
        A name for `read_settings`; the default settings for a policy that was not trained by `quadpend train`.
    """
    from quadpend_train.policies.loading import policy_file
    from quadpend_train.policies.mlp_policy import MlpPolicy

    try:
        path = policy_file(start_from) if start_from else None
        return str(path) if path and "settings" in MlpPolicy.load(path).card else DEFAULT_SETTINGS
    except ValueError:  # training refuses the policy with its own message
        return DEFAULT_SETTINGS


def train(
    run: Annotated[TrainSettings, tyro.conf.arg(name="")],
    settings: str = DEFAULT_SETTINGS,
    out: Path = DEFAULT_OUT,
    resume: Path | None = None,
    more_steps: int | None = None,
) -> None:
    """Train PPO, SAC or TQC.

    Args:
        run: Settings that replace those of the file.
        settings: Settings file: the name of a preset in train/quadpend_train/training/presets, the path of a TOML or
            JSON file, or a policy file (.npz), whose card contains the settings of its training. Without it, --algo
            selects the preset ppo, sac or tqc, and --start-from the settings of its policy.
        out: Folder of the run.
        resume: Folder of an interrupted run to continue, with the settings in that folder.
        more_steps: Timesteps by which the finished run in the folder given by --resume is continued.
    """
    from quadpend_train.training import train as training

    if resume and (out != DEFAULT_OUT or run != read_settings(settings)):
        raise ValueError("--resume uses the settings and the folder of the run: give no other options with it")
    if more_steps is not None:
        if not resume:
            raise ValueError("--more-steps continues a finished run: give its folder with --resume")
        policy = training.extend(resume, more_steps)
    else:
        policy = training.resume(resume) if resume else training.train(run, out)
    print(f"Trained policy: {policy}")


def export(model: tyro.conf.Positional[Path], out: Path | None = None, vec_normalize: Path | None = None) -> None:
    """Convert a model saved by Stable-Baselines3 or sb3-contrib to a policy file, which executes no code when loaded.

    Loading the model executes code that it contains: export only files that you trust.

    Args:
        model: File (.zip) saved by an algorithm with a feedforward network, such as PPO, A2C, SAC, TQC or TD3.
        out: Policy file; the default is the path of the model with the suffix .npz.
        vec_normalize: File (.pkl) saved by VecNormalize, if the model was trained with it. The default is a file
            vecnormalize.pkl beside the model. Loading it executes code that it contains.
    """
    from quadpend_train.policies.export import export_zip

    path = out or model.with_suffix(".npz")
    if path.exists():
        raise FileExistsError(f"{path} exists already: choose another file with --out")
    export_zip(model, vec_normalize, source=model.name).save(path)
    print(f"Written: {path}")


def card(policy: tyro.conf.Positional[str]) -> None:
    """Print the card of a learned policy: settings, seed, scenarios, package versions and scores of its training.

    Args:
        policy: A policy of this package (ppo-gain-scheduling-0), a run folder or a policy file.
    """
    from quadpend_train.policies.loading import policy_file
    from quadpend_train.policies.mlp_policy import MlpPolicy

    print(json.dumps(MlpPolicy.load(policy_file(policy)).card, indent=1))


def reproduce(policy: tyro.conf.Positional[str], out: Path = Path("runs/reproduced")) -> None:
    """Train a learned policy again from its card, and report whether the weights are the same.

    Args:
        policy: A policy of this package (ppo-gain-scheduling-0), a run folder or a policy file.
        out: Folder of the new run.
    """
    from quadpend_train.policies.loading import policy_file
    from quadpend_train.policies.mlp_policy import MlpPolicy, weight_difference
    from quadpend_train.training import start
    from quadpend_train.training import train as training

    original = MlpPolicy.load(policy_file(policy))
    if missing := [name for name in ("settings", "scenarios", "provenance") if name not in original.card]:
        raise ValueError(f"the card of {policy} has no {missing[0]}: the policy was exported, not trained here")
    for name, trained_in in original.card["scenarios"].items():
        if scenario_hash(find_scenario(name)) != trained_in:
            raise ValueError(f"the scenario {name} has changed since {policy} was trained in it")
    start.check_reproducible(original.card, policy)
    settings = from_mapping(original.card["settings"], f"the card of {policy}")
    reproduced = MlpPolicy.load(training.train(settings, out))
    if largest := weight_difference(original, reproduced):
        print(f"The weights differ by up to {largest:g}. Other machines and package versions cause such differences.")
        print(
            f"The card was made on: {original.card['provenance']['machine']}, {original.card['provenance']['packages']}"
        )
        sys.exit(1)
    print("The weights are the same.")
