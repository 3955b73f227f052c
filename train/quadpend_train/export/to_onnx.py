"""The network of a policy, with its normalisation, as a file of the Open Neural Network Exchange (ONNX), opset 13."""

from pathlib import Path
from typing import Any

import numpy as np

from quadpend_baselines import Policy
from quadpend_train.common.files import write_bytes
from quadpend_train.policies.mlp_policy import MlpPolicy

_IR_VERSION, _OPSET = 7, 13
_ACTIVATIONS = {"relu": "Relu", "tanh": "Tanh", "elu": "Elu"}


def export_onnx(policy: Policy, out: Path) -> None:
    """Write the network of a policy: from float32 observations of shape (n, m) to actions of shape (n, 4).

    Raises:
        ValueError: The policy is no network, or has a base controller.
    """
    if not isinstance(policy, MlpPolicy):
        raise ValueError("ONNX has networks alone: --to c writes ADRC, LQR, LQI, LQG, flatness and dual-mode")
    card = policy._card
    if policy.hybrid is not None:
        raise ValueError("ONNX has the network alone, but this policy also has an observer or a memory: use --to c")
    from onnx import TensorProto, helper, numpy_helper

    nodes: list[Any] = []
    constants: list[Any] = []

    def add(operation: str, value: str, *numbers: Any) -> str:
        """Apply an operation to a value and constants, and return the name of the result."""
        result = f"{operation.lower()}_{len(nodes)}"
        names = [f"{result}_{i}" for i in range(len(numbers))]
        constants.extend(
            numpy_helper.from_array(np.asarray(x, np.float32), name) for x, name in zip(numbers, names, strict=True)
        )
        nodes.append(helper.make_node(operation, [value, *names], [result]))
        return result

    value = "observation"
    if (normalization := card.normalization) is not None:
        value = add("Div", add("Sub", value, normalization.mean), normalization.std)
        value = add("Clip", value, -normalization.clip, normalization.clip)
    if card.input_scales:
        parts = [value, *(add("Tanh", add("Mul", value, scale)) for scale in card.input_scales)]
        nodes.append(helper.make_node("Concat", parts, [value := "features"], axis=1))
    for i, (weights, biases) in enumerate(policy.layers):
        value = add("Gemm", value, weights, biases)
        if i < len(policy.layers) - 1:
            value = add(_ACTIVATIONS[card.activation], value)
    if card.bound is not None:
        value = add("Clip", value, -card.bound, card.bound)
    action = add("Tanh", value) if card.squashed else add("Clip", value, -1.0, 1.0)
    inputs = len(policy.layers[0][0]) // (1 + len(card.input_scales))
    first, last = (
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["n", size])]
        for name, size in (("observation", inputs), (action, 4))
    )
    graph = helper.make_graph(nodes, "policy", first, last, constants)
    opset = helper.make_opsetid("", _OPSET)
    model = helper.make_model(graph, ir_version=_IR_VERSION, producer_name="quadpend", opset_imports=[opset])
    write_bytes(out, model.SerializeToString())
