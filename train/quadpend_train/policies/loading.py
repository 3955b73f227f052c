"""Policies by name, as the command line gives them."""

import hashlib
from pathlib import Path

from quadpend_baselines import CONTROLLERS, Policy, controller
from quadpend_baselines.gains import GAINS
from quadpend_train.policies.mlp_policy import SHIPPED, MlpPolicy


def load_policies(names: str) -> list[Policy]:
    """The policies under one name: one, or several separated by commas, the training seeds of one learner.

    The name of a learner of this package (``"ppo-pace"``) stands for all its seeds (``"ppo-pace-0"``, …).
    """
    return [load_policy(name) for name in members(names)]


def members(names: str) -> list[str]:
    """The single policies under one name."""
    return [member for name in names.split(",") for member in (learners().get(name) or [name])]


def learners() -> dict[str, list[str]]:
    """The learned policies of this package, by learner, in the order of their seeds."""
    found: dict[str, list[str]] = {}
    for path in sorted(SHIPPED.glob("*-[0-9]*.npz")):
        found.setdefault(path.stem.rpartition("-")[0], []).append(path.stem)
    return {name: sorted(seeds, key=lambda seed: int(seed.rpartition("-")[2])) for name, seeds in found.items()}


def load_policy(name: str) -> Policy:
    """The policy that `name` stands for.

    Args:
        name: of a classical controller, a key of `baselines.CONTROLLERS`; of a learned policy of this package; the
            path of a run folder or of a policy file; or of a model (.zip) saved by PPO, SAC or TQC, which executes code
            that is in it: load only files whose origin you trust.

    Raises:
        ValueError: it is none of these.
    """
    if name in CONTROLLERS:
        return controller(name)
    path = policy_file(name)
    if path.suffix != ".zip":
        return MlpPolicy.load(path)
    from quadpend_train.policies.export import export_zip

    return export_zip(path)


def identities(names: str) -> list[str]:
    """What tells the policies under one name, as in `load_policies`, from all others: see `identity`."""
    return [identity(name) for name in members(names)]


def identity(name: str) -> str:
    """What tells a policy from all others: a controller's name and gains, the hash of a model's file.

    Raises:
        ValueError: there is no such policy.
    """
    if name in CONTROLLERS:
        return f"{name} {GAINS[name]!r}"
    return hashlib.sha256(policy_file(name).read_bytes()).hexdigest()


def policy_file(name: str) -> Path:
    """The file of a learned policy, by the names that `load_policy` takes.

    Raises:
        ValueError: there is none.
    """
    path = Path(name)
    if path.is_dir():
        path = path / "policy.npz"
    if not path.is_file():
        path = SHIPPED / f"{name}.npz"
    if not path.is_file():
        known = ", ".join([*CONTROLLERS, *learners()])
        raise ValueError(f"there is no policy {name!r}: it is neither {known} nor a finished run or a file")
    return path
