"""Load policies by name or path, as on the command line."""

import hashlib
import sys
from pathlib import Path

from quadpend_baselines import CONTROLLERS, Policy, controller
from quadpend_gym.core.factories import find_factory, is_factory
from quadpend_gym.core.settings import suggest
from quadpend_train.policies.mlp_policy import SHIPPED, MlpPolicy
from quadpend_train.policies.normalization import statistics_file
from quadpend_train.policies.own import FactoryPolicy


def load_policies(names: str) -> list[Policy]:
    """Load one or several policies, see `policy_names`."""
    return [load_policy(name) for name in policy_names(names)]


def policy_names(names: str) -> list[str]:
    """Return the names of the single policies in `names`.

    Args:
        names: One name, or several separated by commas: the training seeds of one learned policy. The name of a learned
            policy of this package without its seed (``"ppo-gain-scheduling"``) stands for all its seeds.
    """
    shipped = shipped_policies()
    return [single for name in names.split(",") for single in (shipped.get(name) or [name])]


def shipped_policies() -> dict[str, list[str]]:
    """Return the learned policies of this package: their names without a seed, and the names of all seeds in order."""
    found: dict[str, list[str]] = {}
    for path in sorted(SHIPPED.glob("*-[0-9]*.npz")):
        found.setdefault(path.stem.rpartition("-")[0], []).append(path.stem)
    return found


def load_policy(name: str) -> Policy:
    """Load a policy.

    Args:
        name: One of

            - the name of a classical controller, a key of `quadpend_baselines.CONTROLLERS`;
            - the name of a learned policy of this package, with its seed (``"ppo-gain-scheduling-0"``);
            - ``"module:factory"``, see `quadpend_train.policies.own`;
            - the path of a run folder or of a policy file (.npz);
            - the path of a model (.zip) saved by Stable-Baselines3 or a library with the same interface, or of a run
              folder of RL Baselines3 Zoo. Loading a model, or the statistics of `VecNormalize` beside it, executes code
              that is in the file: load only files whose source you trust.

    Raises:
        ValueError: If `name` is none of these.
    """
    if is_factory(name):
        return FactoryPolicy(name)
    policy = controller(name) if name in CONTROLLERS else _load_file(policy_file(name))
    policy.fingerprint = policy_fingerprint(name)
    return policy


def _load_file(path: Path) -> Policy:
    if path.suffix != ".zip":
        return MlpPolicy.load(path)
    from quadpend_train.policies.export import policy_from_zip

    return policy_from_zip(path)


def policy_fingerprint(name: str) -> str:
    """Return a text that differs for different policies: a controller's name, or the hash of a file.

    Args:
        name: As for `load_policy`.

    Raises:
        ValueError: If there is no such policy.
    """
    if name in CONTROLLERS:
        return name
    if is_factory(name):
        find_factory(name)
        files = [sys.modules[name.partition(":")[0]].__file__]
    else:
        path = policy_file(name)
        files = [str(path), str(statistics_file(path) or "") if path.suffix == ".zip" else ""]
    content = hashlib.sha256(b"".join(Path(part).read_bytes() for part in files if part)).hexdigest()
    return f"{name} {content}" if is_factory(name) else content


def policy_file(name: str) -> Path:
    """Return the file of a learned policy.

    Args:
        name: As for `load_policy`, but no classical controller.

    Raises:
        ValueError: If there is no such file.
    """
    path = Path(name)
    if path.is_dir():
        zoo = path / f"{path.name.rpartition('_')[0]}.zip"  # RL Baselines3 Zoo saves models as ID_1/ID.zip
        path = zoo if zoo.is_file() else path / "policy.npz"
    if not path.is_file():
        path = SHIPPED / f"{name}.npz"
    if not path.is_file():
        known = [*CONTROLLERS, *shipped_policies()]
        raise ValueError(
            f"there is no policy {name!r}{suggest(name, known)}; there are {', '.join(known)}; or give the path of a"
            " finished run or a policy file, or 'module:factory'"
        )
    return path
