"""Load policies by name or path, as on the command line."""

import hashlib
from collections.abc import Sequence
from pathlib import Path

from quadpend_baselines import CONTROLLERS, Policy, controller
from quadpend_baselines.gains import GAINS, HANGING_GAINS, RIGID_GAINS
from quadpend_gym.core.validation import suggest
from quadpend_train.common.version_0_1 import current_name
from quadpend_train.policies.mlp_policy import SHIPPED, MlpPolicy
from quadpend_train.policies.network_policy import policy_from_onnx
from quadpend_train.policies.normalization import statistics_file
from quadpend_train.policies.own import fingerprint, make_policy, own_factory, plugins, source


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
    return [single for name in names.split(",") for single in (shipped.get(current_name(name)) or [name])]


def shipped_policies() -> dict[str, list[str]]:
    """Return the learned policies of this package: their names without a seed, and the names of all seeds in order."""
    found: dict[str, list[str]] = {}
    for path in sorted(SHIPPED.glob("*-[0-9]*.npz")):
        found.setdefault(path.stem.rpartition("-")[0], []).append(path.stem)
    return {name: sorted(seeds, key=lambda seed: int(seed.rpartition("-")[2])) for name, seeds in found.items()}


def load_policy(name: str) -> Policy:
    """Load a policy.

    Args:
        name: One of

            - the name of a classical controller, a key of `quadpend_baselines.CONTROLLERS`;
            - the name of a learned policy of this package, with its seed (``"ppo-gain-scheduling-0"``);
            - ``"module:factory"``, or the name of an installed plug-in, see `quadpend_train.policies.own`;
            - the path of a run folder or of a policy file (.npz);
            - the path of an ONNX file (.onnx), see `quadpend_train.policies.network_policy.policy_from_onnx`;
            - the path of a model (.zip) saved by Stable-Baselines3 or sb3-contrib, or of a run folder of RL Baselines3
              Zoo. Loading a model, or the statistics of `VecNormalize` beside it, executes code that is in the file:
              load only files whose source you trust.

    Raises:
        ValueError: If `name` is none of these.
    """
    if name in CONTROLLERS:
        return controller(name)
    if factory := own_policy(name):
        return make_policy(factory)
    path = policy_file(name)
    if path.suffix == ".onnx":
        return policy_from_onnx(path)
    if path.suffix != ".zip":
        return MlpPolicy.load(path)
    from quadpend_train.policies.export import policy_from_zip

    return policy_from_zip(path)


def policy_fingerprints(names: str) -> list[str]:
    """Return the fingerprint of each policy in `names`, see `policy_names` and `policy_fingerprint`."""
    return [policy_fingerprint(name) for name in policy_names(names)]


def cache_fingerprints(policies: str | Sequence[Policy]) -> list[str] | None:
    """Return a text for each policy that determines what it does; None if there is none for one of them.

    Args:
        policies: Policies as objects, or their names as for `load_policies`. Objects and own policies have a text only
            if they have a `fingerprint`, see `quadpend_train.policies.own`.
    """
    if isinstance(policies, str):
        names = policy_names(policies)
        found = [fingerprint(load_policy(name)) if own_policy(name) else policy_fingerprint(name) for name in names]
    else:
        found = [fingerprint(policy) for policy in policies]
    known = [text for text in found if text is not None]
    return known if len(known) == len(found) else None


def own_policy(name: str) -> str | None:
    """Return the text ``"module:factory"`` of an own policy or plug-in; None for the policies of this package."""
    shipped = shipped_policies()
    built_in = {*CONTROLLERS, *shipped, *(single for seeds in shipped.values() for single in seeds)}
    return None if name in built_in else own_factory(name, built_in)


def policy_fingerprint(name: str) -> str:
    """Return a text that differs for different policies: a controller's name and gains, or the hash of a file.

    Args:
        name: As for `load_policy`.

    Raises:
        ValueError: If there is no such policy.
    """
    if name in CONTROLLERS:
        return " ".join([name, repr(GAINS[name]), *(repr(gains.get(name)) for gains in (RIGID_GAINS, HANGING_GAINS))])
    if factory := own_policy(name):
        return source(factory)
    path = policy_file(name)
    # An ONNX model can have its weights in another file, and a zip the statistics of VecNormalize.
    parts = [path, path.with_name(f"{path.name}.data"), *([statistics_file(path)] if path.suffix == ".zip" else [])]
    return hashlib.sha256(b"".join(part.read_bytes() for part in parts if part and part.is_file())).hexdigest()


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
        path = SHIPPED / f"{current_name(name)}.npz"
    if not path.is_file():
        known = [*CONTROLLERS, *shipped_policies(), *plugins()]
        raise ValueError(
            f"there is no policy {name!r}{suggest(name, known)}; there are {', '.join(known)}; or give the path of a"
            " finished run or a policy file, or 'module:factory'"
        )
    return path
