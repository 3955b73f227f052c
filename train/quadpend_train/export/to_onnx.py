"""The network of a policy, with its normalisation, as a file of the Open Neural Network Exchange (ONNX), opset 13.

An ONNX file is a message of protocol buffers: fields with a number, and a length or an integer. `_bytes` and `_integer`
write one field; the numbers are those of ``onnx.proto``.
"""

from pathlib import Path

import numpy as np

from quadpend_baselines import Policy
from quadpend_gym.core.arrays import Floats, Floats32
from quadpend_train.common.files import atomic
from quadpend_train.policies.mlp_policy import MlpPolicy

_IR_VERSION, _OPSET = 7, 13
_FLOAT = 1  # the type of tensors
_ACTIVATIONS = {"relu": "Relu", "tanh": "Tanh", "elu": "Elu"}


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def _integer(field: int, value: int) -> bytes:
    return _varint(field << 3) + _varint(value)


def _bytes(field: int, value: bytes | str) -> bytes:
    data = value.encode() if isinstance(value, str) else value
    return _varint(field << 3 | 2) + _varint(len(data)) + data


def _tensor(name: str, array: Floats | Floats32) -> bytes:
    dimensions = b"".join(_integer(1, size) for size in array.shape)
    return dimensions + _integer(2, _FLOAT) + _bytes(8, name) + _bytes(9, array.astype("<f4").tobytes())


def _value(name: str, size: int) -> bytes:
    """Return the description of an input or output of shape (n, size)."""
    shape = _bytes(1, _bytes(2, "n")) + _bytes(1, _integer(1, size))
    return _bytes(1, name) + _bytes(2, _bytes(1, _integer(1, _FLOAT) + _bytes(2, shape)))


class _Graph:
    """A chain of operations on float32 tensors."""

    def __init__(self) -> None:
        self.nodes, self.constants, self.last = b"", b"", "observation"

    def add(self, operation: str, *constants: Floats | Floats32, attributes: bytes = b"") -> str:
        """Apply an operation to the last value and constants, and return the name of the result."""
        result, names = f"{operation.lower()}_{len(self.nodes)}", [self.last]
        for i, constant in enumerate(constants):
            names.append(f"{result}_{i}")
            self.constants += _bytes(5, _tensor(names[-1], constant))
        inputs = b"".join(_bytes(1, name) for name in names)
        self.nodes += _bytes(1, inputs + _bytes(2, result) + _bytes(4, operation) + attributes)
        self.last = result
        return result


def export_onnx(policy: Policy, out: Path) -> None:
    """Write the network of a policy: from float32 observations of shape (n, m) to actions of shape (n, 4).

    Raises:
        ValueError: The policy is no network, or has a base controller or repeats actions.
    """
    if not isinstance(policy, MlpPolicy):
        raise ValueError("ONNX is for networks: use --to c")
    card, graph = policy._card, _Graph()
    if policy.hybrid is not None or card.action_repeat != 1:
        raise ValueError("ONNX has the network alone, but this policy also has an observer: use --to c")
    if (normalization := card.normalization) is not None:
        limit = np.array(normalization.clip)
        graph.add("Sub", np.array(normalization.mean))
        graph.add("Div", np.array(normalization.std))
        graph.add("Clip", -limit, limit)
    parts = [graph.last]
    for scale in card.input_scales:
        graph.last = parts[0]
        graph.add("Mul", np.array(scale))
        parts.append(graph.add("Tanh"))
    if card.input_scales:
        joined = b"".join(_bytes(1, name) for name in parts) + _bytes(2, "features") + _bytes(4, "Concat")
        axis = _bytes(5, _bytes(1, "axis") + _integer(3, 1) + _integer(20, 2))
        graph.nodes, graph.last = graph.nodes + _bytes(1, joined + axis), "features"
    for i, (weights, biases) in enumerate(policy.layers):
        graph.add("Gemm", weights, biases)
        if i < len(policy.layers) - 1:
            graph.add(_ACTIVATIONS[card.activation])
    if card.bound is not None:
        graph.add("Clip", np.array(-card.bound), np.array(card.bound))
    action = graph.add("Tanh") if card.squashed else graph.add("Clip", np.array(-1.0), np.array(1.0))
    inputs = len(policy.layers[0][0]) // (1 + len(card.input_scales))
    ends = _bytes(11, _value("observation", inputs)) + _bytes(12, _value(action, 4))
    content = graph.nodes + _bytes(2, "policy") + graph.constants + ends
    model = _integer(1, _IR_VERSION) + _bytes(2, "quadpend") + _bytes(7, content) + _bytes(8, _integer(2, _OPSET))
    with atomic(out) as unfinished:
        unfinished.write_bytes(model)
