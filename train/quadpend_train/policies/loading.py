"""Load policies by name or path, as on the command line, and try them before a long evaluation."""

import hashlib
from pathlib import Path

import numpy as np
from gymnasium import logger
from gymnasium.vector import AutoresetMode

from quadpend_baselines import CONTROLLERS, Policy
from quadpend_baselines.registry import controller_from_text, gains_file
from quadpend_gym.core.factories import describe_error, is_factory, split_text
from quadpend_gym.core.settings import suggest
from quadpend_gym.scenarios import Scenario
from quadpend_train.policies.compiled import is_c, load_c_policy
from quadpend_train.policies.conversion import PROTOCOL, FactoryPolicy, ObjectPolicy, policy_from_model
from quadpend_train.policies.mlp_policy import SHIPPED, MlpPolicy
from quadpend_train.policies.normalization import statistics_files

_UNKNOWN = (
    "{} is neither a policy file (.npz) nor a model of Stable-Baselines3 (.zip): weights of torch, as of CleanRL, and"
    " ONNX files fly by a function of yours, 'module:factory', which returns a FunctionPolicy"
)


def load_policies(names: str) -> list[Policy]:
    """Load one policy, or training seeds of one learned policy that commas separate."""
    texts = split_text(names, ",")
    seeds = [load_policy(name) for name in texts]
    if len({policy.fingerprint or name for name, policy in zip(texts, seeds, strict=True)}) < len(seeds):
        raise ValueError(
            f"training seeds must be different policies, but some of {', '.join(texts)} are the same policy"
        )
    return seeds


def shipped_policies() -> list[str]:
    """Return the names of the learned policies of this package."""
    return sorted(path.stem for path in SHIPPED.glob("*.npz"))


def load_policy(name: str) -> Policy:
    """Load a policy.

    Args:
        name: One of

            - the name of a classical controller, one of `quadpend_baselines.CONTROLLERS`; ``"lqg:gains.json"`` has the
              gains of a file, for example one of ``quadpend tune``, see `quadpend_baselines.registry`;
            - the name of a learned policy of this package, with its seed (``"apg-0"``);
            - ``"c:policy.c"``, a C file of ``quadpend export``, or ``"supervised:policy.c"``, the same with its
              supervisor, see `quadpend_train.policies.compiled`. It is compiled and executed;
            - ``"module:factory"``, see `quadpend_train.policies.conversion`;
            - the path of a run folder or of a policy file (.npz);
            - the path of a model (.zip) saved by Stable-Baselines3 or a library with the same interface, or of a run
              folder of RL Baselines3 Zoo. Loading a model, or the statistics of `VecNormalize` beside it, executes code
              that is in the file: load only files whose source you trust.
    """
    policy: Policy
    if is_c(name):
        policy = load_c_policy(name)
        policy.fingerprint = hashlib.sha256(policy.source.encode()).hexdigest()
        return policy
    if name in CONTROLLERS or gains_file(name):
        policy = controller_from_text(name)
        policy.fingerprint = policy_fingerprint(name)
        return policy
    if is_factory(name):
        return FactoryPolicy(name)
    if (path := policy_file(name)).suffix == ".zip":
        from quadpend_train.policies.from_sb3 import from_zip

        policy = from_zip(path, None, policy_from_model)
    elif path.suffix == ".npz":
        policy = MlpPolicy.load(path)
    else:
        raise ValueError(_UNKNOWN.format(path))
    policy.fingerprint = policy_fingerprint(name)
    return policy


def model_file(name: str) -> Path:
    """Return the model (.zip) that a policy file can be made of, see `load_policy`."""
    if is_c(name) or name in CONTROLLERS or gains_file(name) or is_factory(name):
        raise ValueError(
            f"{name} is no model of Stable-Baselines3 (.zip), of which a policy file can be made; --to c writes C"
        )
    path = policy_file(name)
    if path.suffix == ".npz":
        raise ValueError(f"{path} is a policy file already: --to c converts it")
    if path.suffix != ".zip":
        raise ValueError(_UNKNOWN.format(path))
    return path


def policy_fingerprint(name: str) -> str:
    """Return a text that differs for different policies: a controller's name, or the hash of a file."""
    if name in CONTROLLERS:
        return name
    if (gains := gains_file(name)) is not None:
        return f"{name.partition(':')[0]} {hashlib.sha256(gains.read_bytes()).hexdigest()}"
    path = policy_file(name)
    files = [path, *(statistics_files(path) if path.suffix == ".zip" else [])]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


def policy_file(name: str) -> Path:
    """Return the file of a learned policy, see `load_policy`."""
    path = Path(name)
    if path.is_dir():
        path = _file_in(path)
    if not path.is_file():
        path = SHIPPED / f"{name}.npz"
    if not path.is_file() and Path(name).is_dir():
        raise ValueError(
            f"the folder {name!r} has neither policy.npz nor a model (.zip): give that of a finished run"
            " or a policy file"
        )
    if not path.is_file() and ("/" in name or Path(name).suffix):
        raise ValueError(f"there is no policy {name!r}: this file or folder is not on this machine")
    if not path.is_file():
        known = [*CONTROLLERS, *shipped_policies()]
        raise ValueError(
            f"there is no policy {name!r}{suggest(name, known)}; there are {', '.join(known)}; or give the path of a"
            " finished run or a policy file, or 'module:factory'"
        )
    return path


def _file_in(folder: Path) -> Path:
    """Return the policy of a run, ENV.zip of a folder ENV_1 of RL Baselines3 Zoo, or the only model in a folder."""
    zoo, models = folder / f"{folder.name.rpartition('_')[0]}.zip", [*folder.glob("*.zip")]
    if zoo in models:
        return zoo
    models = [path for path in models if path.name != "train_eval_metrics.zip"]  # of the Zoo on Hugging Face
    if not models or (folder / "settings.json").is_file():
        return folder / "policy.npz"
    if len(models) > 1:
        raise ValueError(f"give the path of one of the models in {folder}: {', '.join(sorted(p.name for p in models))}")
    return models[0]


def check_policy(name: str, policy: Policy, scenario_name: str, scenario: Scenario) -> None:
    """Fly a policy for two steps in two sub-environments of a scenario, so that a mismatch is found early.

    A policy from elsewhere is warned about if nothing says what its actions command.
    """
    interface, memory = scenario.simulation.interface, None
    card = getattr(policy, "card", None)
    if card is not None and "interface" not in card:
        logger.warn("nothing says what the actions of %s command: they are taken as those of %r", name, interface)
    try:
        adapted = policy.adapt(scenario)
        env = adapted.wrap(scenario.make_vec(2, AutoresetMode.SAME_STEP))
        observation, _ = env.reset(seed=0)
        for started in ([True, True], [True, False]):
            action, memory = adapted.predict(observation, memory, np.array(started), deterministic=True)
            observation, *_ = env.step(action)
    except Exception as error:  # own code may raise exceptions of any type
        what = str(error) if isinstance(error, ValueError) else describe_error(error)
        is_own = isinstance(policy, FactoryPolicy | ObjectPolicy) and card is None
        rule = f"; {PROTOCOL}" if is_own and PROTOCOL not in what else ""
        raise ValueError(f"{name} does not fit the scenario {scenario_name}: {what}{rule}") from error
