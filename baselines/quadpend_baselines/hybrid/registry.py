"""Hybrids by kind. Policy cards, training settings and environment specifications use the names of the kinds."""

from collections.abc import Callable, Mapping
from inspect import signature
from typing import Any

from quadpend_baselines.hybrid.bandwidth_scheduling import BandwidthScheduling
from quadpend_baselines.hybrid.estimate_only import EstimateOnly
from quadpend_baselines.hybrid.protocol import Hybrid
from quadpend_baselines.hybrid.residual_action import ResidualAction

# kind: class
HYBRIDS: dict[str, Callable[..., Hybrid]] = {
    EstimateOnly.kind: EstimateOnly,
    ResidualAction.kind: ResidualAction,
    BandwidthScheduling.kind: BandwidthScheduling,
}


def hybrid_from_data(data: Any) -> Hybrid:
    """Return the hybrid that plain data describe.

    Args:
        data: A mapping with the key ``kind``, one of `HYBRIDS`, and the arguments of that class, for example
            ``{"kind": "residual_action", "base_controller": "flatness", "action_scale": 0.3, "fallback_gain": 0.0}``.

    Raises:
        TypeError: If `data` is not a mapping, or the base controller does not fit the kind.
        ValueError: If the kind, a field or the base controller's name is unknown, or a number is out of range.
    """
    if not isinstance(data, Mapping):
        raise TypeError(f"hybrid must be a mapping with a kind, not {data!r}")
    kind = data.get("kind")
    if not isinstance(kind, str) or kind not in HYBRIDS:
        raise ValueError(f"the kind of a hybrid must be one of {', '.join(HYBRIDS)}, not {kind!r}")
    arguments = {name: value for name, value in data.items() if name != "kind"}
    known = list(signature(HYBRIDS[kind]).parameters)
    if unknown := [name for name in arguments if name not in known]:
        raise ValueError(f"the hybrid {kind} has no field {unknown[0]!r}; its fields are {', '.join(known)}")
    if not isinstance(name := arguments.get("base_controller"), str):
        raise TypeError(f"base_controller must be the name of a controller, not {name!r}")
    return HYBRIDS[kind](**arguments)
