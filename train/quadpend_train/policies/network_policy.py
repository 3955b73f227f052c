"""Policies that run a network of another library, and the import of ONNX files."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from quadpend_gym.core.arrays import Floats32
from quadpend_gym.physics.state import ACTION_SIZE
from quadpend_train.policies.mlp_policy import OBSERVATION_SIZES


class NetworkPolicy:
    """A function of the latest observation as a deterministic policy with the `predict` protocol.

    The output of the function is clipped to [−1, 1]. If the network needs a tanh, the function contains it.

    Args:
        function: Maps observations, shape (n, 36) or (n, 27), float32, to actions, shape (n, 4).
        name: What the function is, for error messages.

    Attributes:
        observation_sizes: Sizes of the observations that the function accepts: 36, 27 or both.

    Raises:
        ValueError: If the function does not map such observations to four finite numbers.
    """

    def __init__(self, function: Callable[[Floats32], Any], name: str) -> None:
        """Call `function` with one and with several observations."""
        self._function = function
        self.name = name
        errors = {size: self._error(size) for size in OBSERVATION_SIZES}
        self.observation_sizes = tuple(size for size, error in errors.items() if not error)
        if not self.observation_sizes:
            raise ValueError(
                f"{name} must map observations of shape (n, {' or '.join(map(str, OBSERVATION_SIZES))}), float32, to"
                f" actions of shape (n, {ACTION_SIZE}): {errors[OBSERVATION_SIZES[0]]}"
            )

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, Any]:
        """Return the action and None; see `quadpend_baselines.Policy.predict`.

        Raises:
            ValueError: If the policy does not accept observations of this size, or `deterministic` is False.
        """
        observation = np.asarray(observation, np.float32)
        if observation.shape[-1:] not in [(size,) for size in self.observation_sizes]:
            raise ValueError(
                f"{self.name} takes observations of {' or '.join(map(str, self.observation_sizes))} numbers, not of"
                f" shape {observation.shape}"
            )
        if not deterministic:
            raise ValueError(f"deterministic must be True: {self.name} acts deterministically")
        action = np.asarray(self._function(np.atleast_2d(observation)), np.float32)
        return np.clip(action.reshape(*observation.shape[:-1], ACTION_SIZE), -1.0, 1.0), None

    def _error(self, size: int) -> str:
        """Return why the function does not accept observations of this size; an empty text if it does."""
        for rows in (1, 3):
            try:
                action = np.asarray(self._function(np.zeros((rows, size), np.float32)), np.float32)
            except Exception as error:  # each library has its own exceptions
                return str(error).strip().split("\n")[0] or type(error).__name__
            if action.shape != (rows, ACTION_SIZE):
                return f"for {rows} observations it returned shape {action.shape}"
            if not np.isfinite(action).all():
                return f"it returned {action.tolist()}"
        return ""


def policy_from_onnx(path: Path) -> NetworkPolicy:
    """Return the policy in an ONNX file.

    The model has one input of observations, shape (n, 36) or (n, 27) with any n or n = 1, float32. Its first output is
    the action, shape (n, 4), which is clipped to [−1, 1]. Other outputs are ignored.

    Args:
        path: The file (.onnx).

    Raises:
        ValueError: If onnxruntime is not installed, or `path` is not such a file.
    """
    try:
        import onnxruntime
    except ImportError as error:
        raise ValueError(f"{path} needs onnxruntime: pip install 'quadpend-gym[onnx]'") from error
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1  # the same result on every machine, and faster for small networks
    options.log_severity_level = 4  # errors are raised, not printed
    try:
        session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime derives its exceptions from Exception
        raise ValueError(f"{path} is not an ONNX model: {str(error).strip().split(chr(10))[0]}") from error
    if len(session.get_inputs()) != 1:
        names = ", ".join(item.name for item in session.get_inputs())
        raise ValueError(f"{path} must have one input, the observation, not {names}")
    (observation,), action = session.get_inputs(), session.get_outputs()[0].name

    def run(rows: Floats32) -> Any:
        if observation.shape[:1] == [1]:  # exported for a single observation
            return np.concatenate([session.run([action], {observation.name: row[np.newaxis]})[0] for row in rows])
        return session.run([action], {observation.name: rows})[0]

    return NetworkPolicy(run, str(path))
