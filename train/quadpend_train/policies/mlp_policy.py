"""Learned policies, stored in files that execute no code when they are loaded.

A policy file is an npz archive with float32 weights and biases and a JSON text, the card. Loading and running a policy
needs numpy and, for a hybrid, the classical controllers of `quadpend_baselines`. It needs neither PyTorch nor
Stable-Baselines3:

    policy = MlpPolicy.load("ppo-gain-scheduling-0")
    action, memory = policy.predict(observation, memory)

Fields of a card that determine the policy:

| field             | meaning                                                                                          |
|-------------------|--------------------------------------------------------------------------------------------------|
| `format`          | version of the format, `FORMAT`                                                                  |
| `activation`      | activation function of the hidden layers, one of `ACTIVATIONS`                                   |
| `squashed`        | whether the output goes through tanh; otherwise it is clipped to [−1, 1]                         |
| `bound`           | limit of the output before tanh; optional                                                        |
| `input_scales`    | scales s₁, s₂, … of the inputs x, which become [x, tanh(s₁ x), tanh(s₂ x), …]; optional          |
| `normalization`   | mean, standard deviation and limit of the normalised inputs, see `Normalization`; optional       |
| `hybrid`          | data for `quadpend_baselines.hybrid.hybrid_from_data`; null for a policy without base controller |
| `action_repeat`   | control steps for which each output of the network is used                                       |
| `history`         | number of latest observations that the network receives, oldest first                            |
| `history_actions` | number of its own latest outputs that the network receives after them, oldest first              |
| `interface`       | what an action commands, as `Simulation.interface`; optional, see `check_interface`              |
| `vehicle`         | name of the vehicle of the training, null for the paper's; optional                              |

A trained policy's card also has the settings, the score, the learning curve and the provenance of its training.
"""

import json
import zipfile
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from gymnasium import logger

from quadpend_baselines import Policy
from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.hybrid import Hybrid, hybrid_from_data
from quadpend_baselines.hybrid.wrappers import NO_HYBRID
from quadpend_baselines.policy.protocol import episode_start_mask, select_rows
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats, Floats32, Integers
from quadpend_gym.core.settings import Range, parse, settings
from quadpend_gym.physics.state import ACTION_SIZE
from quadpend_gym.scenarios import Scenario
from quadpend_train.common.files import atomic
from quadpend_train.common.text import brief
from quadpend_train.policies.finite_differences import with_velocities
from quadpend_train.policies.history import OBSERVATION_SIZES, pushed
from quadpend_train.policies.normalization import Normalization

SHIPPED = Path(__file__).parent / "shipped"
FORMAT = "quadpend policy 2"
# Fields of the card of a policy whose only input is the latest observation
PLAIN_INTERFACE = {"hybrid": None, "action_repeat": 1, "history": 1, "history_actions": 0}
_LARGEST_FILE = 64 * 2**20  # bytes, unpacked
_COMMANDS = {"wrench": "thrust and torques", "rotors": "rotor thrusts", "body_rates": "thrust and body rates"}
ACTIVATIONS: dict[str, Callable[[Any], Any]] = {
    "relu": lambda x: np.maximum(x, np.float32(0.0)),
    "tanh": np.tanh,
    "elu": lambda x: np.where(x > 0.0, x, np.expm1(np.minimum(x, np.float32(0.0)))),
}
Count = Annotated[int, Range(0, 2**53)]


@settings
class Score:
    """The score of a training, see `quadpend_train.training.validation`."""

    survival: Annotated[float, Range(0.0, 1.0)]
    penalised_rmse: Annotated[float, Range(0.0, 1.0, "m")]


@settings
class Card:
    """The fields of a card that the policy and the reports read; the docstring of the module explains the first ones.

    Attributes:
        curve: Timesteps, seconds, survival and penalised RMSE (m) of each evaluation of the training.
        scenarios: Scenarios of the training with their hashes.
        source: File from which the policy was exported.
    """

    format: Literal["quadpend policy 2"]
    activation: Literal["relu", "tanh", "elu"]
    squashed: bool
    hybrid: dict[str, Any] | None
    action_repeat: Annotated[int, Range(1, 10_000_000)]
    history: Annotated[int, Range(1, 10_000_000)]
    history_actions: Annotated[int, Range(0, 10_000_000)]
    bound: Annotated[float | None, Range(1e-30, 1e30)] = None
    input_scales: Annotated[tuple[float, ...], Range(1e-6, 1e6)] = ()
    normalization: Normalization | None = None
    interface: Literal["wrench", "rotors", "body_rates"] = "wrench"
    vehicle: str | None = None
    settings: dict[str, Any] | None = None
    seed: Count = 0
    steps: Count = 0
    best_at: Count = 0
    seconds: Annotated[float, Range(0.0, 1e12, "s")] = 0.0
    score: Score | None = None
    curve: tuple[tuple[float, float, float, float], ...] = ()
    scenarios: dict[str, str] | None = None
    provenance: dict[str, Any] | None = None
    source: str = ""


class MlpMemory(NamedTuple):
    """The state of a policy between two calls, for n rows; for policies of a hybrid or with a history."""

    hybrid: Any  # memory of the hybrid; None without a hybrid
    observations: Floats32  # latest k observations of m numbers, oldest first, (n, k, m)
    actions: Floats32  # latest j outputs of the network, oldest first, (n, j, 4)
    output: Floats32  # latest output of the network, (n, 4)
    steps: Integers  # control steps since the start of the episode, (n,)


class MlpPolicy(Policy):
    """A feedforward network as a deterministic policy with the `predict` protocol.

    Args:
        layers: Weights of shape (inputs, outputs) and biases of shape (outputs,) of each layer, float32.
        card: Description of the policy; the module's docstring lists the fields that determine it.

    Attributes:
        layers: The layers.
        card: The card.
        input_scales: Scales of the inputs, see the module's docstring; empty without them.
        hybrid: The hybrid that the policy is part of, or None.
        observation_sizes: Sizes of the observations that the policy accepts: 36, 27 or both.

    Raises:
        ValueError: If the card or the layers are invalid, or do not fit together.
    """

    observation_sizes: tuple[int, ...]

    def __init__(self, layers: Sequence[tuple[Floats32, Floats32]], card: dict[str, Any]) -> None:
        """Check that layers and card fit together."""
        known = {item.name for item in fields(Card)}
        checked = parse(Card, {name: value for name, value in card.items() if name in known}, "card")
        self.layers, self.card = list(layers), card
        self.hybrid: Hybrid | None = None if checked.hybrid is None else hybrid_from_data(checked.hybrid)
        self.input_scales = checked.input_scales
        self._action_repeat, self._history = checked.action_repeat, checked.history
        self._history_actions, self._normalization = checked.history_actions, checked.normalization
        self._activation, self._squashed, self._bound = ACTIVATIONS[checked.activation], checked.squashed, checked.bound
        self._stateless = self.hybrid is None and self._history == 1 and not self._history_actions
        _check_layers(self.layers)
        inputs, parts = self.layers[0][0].shape[0], 1 + len(self.input_scales)
        self.observation_sizes = tuple(size for size in OBSERVATION_SIZES if parts * self._input_size(size) == inputs)
        if not self.observation_sizes:
            sizes = " or ".join(str(parts * self._input_size(size)) for size in OBSERVATION_SIZES)
            raise ValueError(f"the first layer must take {sizes} numbers, as the card implies, not {inputs}")
        if self._normalization and not len(self._normalization.mean) == len(self._normalization.std) == inputs // parts:
            raise ValueError(f"normalization must have {inputs // parts} numbers, the inputs of the network")

    @classmethod
    def load(cls, name: str | Path) -> "MlpPolicy":
        """Load a policy file.

        Args:
            name: The path of a file, or the name of a policy of this package (``"ppo-gain-scheduling-0"``).

        Raises:
            ValueError: If there is no such file, or it does not contain a policy.
        """
        path = Path(name)
        if not path.is_file() and not (path := SHIPPED / f"{name}.npz").is_file():
            raise ValueError(f"{str(name)!r} must be the path of a policy file or the name of a policy of this package")
        try:
            with zipfile.ZipFile(path) as archive:
                size = sum(item.file_size for item in archive.infolist())
            if size > _LARGEST_FILE:
                raise ValueError(f"the archive must have at most {_LARGEST_FILE} bytes unpacked, not {size}")
            with path.open("rb") as file, np.load(file, allow_pickle=False) as data:
                arrays = {key: data[key] for key in data.files}
            card = json.loads(str(arrays.pop("card")))
            count = len(arrays) // 2
            layers = [(arrays.pop(f"weights_{i}"), arrays.pop(f"biases_{i}")) for i in range(count)]
            if arrays:
                raise ValueError(f"the archive also contains {', '.join(sorted(arrays))}")
            return cls(layers, card)
        except KeyError as error:
            raise ValueError(f"{path} is not a policy file: it has no {error}") from error
        except Exception as error:  # a broken archive can raise nearly any exception
            raise ValueError(f"{path} is not a policy file: {brief(error)}") from error

    def save(self, path: str | Path) -> None:
        """Write the policy to a file. If writing is interrupted, an older file is not changed."""
        arrays: dict[str, Any] = {"card": np.array(json.dumps(self.card))}
        for i, (weights, biases) in enumerate(self.layers):
            arrays |= {f"weights_{i}": weights, f"biases_{i}": biases}
        with atomic(Path(path)) as unfinished, unfinished.open("wb") as file:
            np.savez_compressed(file, **arrays)

    def adapt(self, scenario: Scenario) -> Policy:
        """Return the policy with its base controller designed for a scenario, and with velocities if it needs them.

        Raises:
            ValueError: If the policy was trained with another command interface, see `check_interface`.
        """
        check_interface(self.card, scenario.simulation)
        if self.hybrid is None:
            return with_velocities(self, scenario)
        if scenario.task.pendulum == "hanging":
            raise ValueError(NO_HYBRID)
        other = copy(self)
        other.hybrid = self.hybrid.designed_for(scenario.simulation, Loop.known(scenario))
        return with_velocities(other, scenario)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, Any]:
        """Return the action and the memory; see `quadpend_baselines.Policy.predict`.

        Raises:
            ValueError: If the policy does not accept observations of this size, or `deterministic` is False.
        """
        observation = np.asarray(observation, np.float32)
        if observation.shape[-1] not in self.observation_sizes:
            raise ValueError(
                f"this policy takes observations of {' or '.join(map(str, self.observation_sizes))} numbers, not of"
                f" shape {observation.shape}"
            )
        if not deterministic:
            raise ValueError("deterministic must be True: an MlpPolicy acts deterministically")
        if self._stateless:
            return self.forward(observation), None
        single = observation.ndim == 1
        action, memory = self._predict_rows(np.atleast_2d(observation), state, episode_start)
        return (action[0] if single else action), memory

    def estimated_disturbance(self, memory: Any) -> Floats:
        """Return the base controller's estimate of the disturbance, shape (n, 9); nan without base controller."""
        if self.hybrid is None:
            return super().estimated_disturbance(memory)
        return np.asarray(self.hybrid.controller.estimated_disturbance(memory.hybrid.controller))

    def forward(self, inputs: Floats32) -> Floats32:
        """Return the network's output for inputs of shape (m,) or (n, m), shape (4,) or (n, 4)."""
        if self._normalization is not None:
            inputs = self._normalization.apply(inputs)
        if self.input_scales:
            scaled = [np.tanh(np.float32(scale) * inputs) for scale in self.input_scales]
            inputs = np.concatenate([inputs, *scaled], axis=-1)
        for weights, biases in self.layers[:-1]:
            inputs = self._activation(inputs @ weights + biases)
        weights, biases = self.layers[-1]
        output = inputs @ weights + biases
        if self._bound is not None:
            output = np.clip(output, -self._bound, self._bound)
        return np.asarray(np.tanh(output) if self._squashed else np.minimum(np.maximum(output, -1.0), 1.0))

    def _predict_rows(self, observation: Floats32, state: Any, episode_start: Any) -> tuple[Floats32, MlpMemory]:
        started = episode_start_mask(episode_start, state is None, len(observation))
        seen, hybrid = observation, None
        if self.hybrid is not None:
            seen, hybrid = self.hybrid.observe(observation, state and state.hybrid, started)
        memory = MlpMemory(
            hybrid,
            np.repeat(seen[:, np.newaxis], self._history, axis=1),
            np.zeros((len(seen), self._history_actions, ACTION_SIZE), np.float32),
            np.zeros((len(seen), ACTION_SIZE), np.float32),
            np.zeros(len(seen), np.int64),
        )
        if state is not None:
            kept = state._replace(hybrid=(), observations=pushed(state.observations, seen))
            memory = select_rows(started, memory._replace(hybrid=()), kept)
        flat = [memory.observations.reshape(len(seen), -1), memory.actions.reshape(len(seen), -1)]
        action = self.forward(np.concatenate(flat, axis=1))
        if self._action_repeat > 1:
            action = select_rows(memory.steps % self._action_repeat == 0, action, memory.output)
        memory = MlpMemory(hybrid, memory.observations, pushed(memory.actions, action), action, memory.steps + 1)
        if self.hybrid is not None:
            action, hybrid = self.hybrid.act(action, memory.hybrid)
            memory = memory._replace(hybrid=hybrid)
        return action, memory

    def _input_size(self, size: int) -> int:
        """Return how many numbers the policy passes to the network if an observation has `size` numbers."""
        seen = size if self.hybrid is None else self.hybrid.observation_size(size)
        return int(self._history * seen + self._history_actions * ACTION_SIZE)


def weight_difference(policy: MlpPolicy, other: MlpPolicy) -> float:
    """Return the largest absolute difference of two policies' weights; inf if the shapes of their layers differ."""
    pairs = [pair for layers in zip(policy.layers, other.layers, strict=False) for pair in zip(*layers, strict=True)]
    if len(policy.layers) != len(other.layers) or any(a.shape != b.shape for a, b in pairs):
        return float("inf")
    return max(float(np.abs(a - b).max()) for a, b in pairs)


def lacks_interface(card: dict[str, Any]) -> bool:
    """Return whether nothing says what the actions of a policy with this card command, see `check_interface`."""
    scheduled = (card.get("hybrid") or {}).get("kind") == "bandwidth_scheduling"
    return not (scheduled or "interface" in card or "settings" in card)


def check_interface(card: dict[str, Any], simulation: Simulation) -> None:
    """Check that a policy's actions mean in a simulation what they meant in its training.

    The base controller of a hybrid of the kind ``"bandwidth_scheduling"`` commands any vehicle and interface. Cards of
    policies that were trained here before there were other interfaces have no ``interface``: theirs is that of the
    paper's vehicle, ``"wrench"``. Nothing is known about policies from elsewhere, so they are not checked.

    Args:
        card: The policy's card.
        simulation: Nominal simulation in which the policy is to fly.

    Raises:
        ValueError: If the interfaces differ.
    """
    trained = card.get("interface", "wrench" if "settings" in card else None)
    if trained is None or (card["hybrid"] or {}).get("kind") == "bandwidth_scheduling":
        return
    if trained != simulation.interface:
        raise ValueError(
            f"the policy was trained to command {_COMMANDS[trained]} (interface {trained!r}), but an action of the"
            f" simulation commands {_COMMANDS[simulation.interface]} (interface {simulation.interface!r})"
        )
    vehicle = simulation.vehicle.name
    if (own := card.get("vehicle") or "paper") != vehicle:
        logger.warn("a policy trained on the vehicle %s flies the vehicle %s", own, vehicle)


def _check_layers(layers: Sequence[tuple[Any, Any]]) -> None:
    if not layers:
        raise ValueError("there are no layers")
    inputs = layers[0][0].shape[:1]
    for i, (weights, biases) in enumerate(layers):
        if weights.ndim != 2 or weights.shape[:1] != inputs or biases.shape != weights.shape[1:]:
            raise ValueError(f"layer {i} has weights {weights.shape} and biases {biases.shape}, which do not fit")
        if weights.dtype != np.float32 or biases.dtype != np.float32:
            raise ValueError(f"layer {i} must be of float32, not {weights.dtype} and {biases.dtype}")
        if not (np.isfinite(weights).all() and np.isfinite(biases).all()):
            raise ValueError(f"layer {i} has numbers that are not finite")
        inputs = biases.shape
    if inputs != (ACTION_SIZE,):
        raise ValueError(f"the last layer must have {ACTION_SIZE} outputs, not {inputs[0]}")
