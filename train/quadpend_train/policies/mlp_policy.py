"""Learned policies, stored in files that execute no code when they are loaded.

A policy file is an npz archive with float32 weights and biases and a JSON text, the card. Loading and running a policy
needs numpy and, for a hybrid, the classical controllers of `quadpend_baselines`. It needs neither PyTorch nor
Stable-Baselines3:

    policy = MlpPolicy.load("apg-0")
    action, memory = policy.predict(observation, memory)

The fields of the card that determine the policy are those of `Card`. A trained policy's card also has the settings, the
score, the learning curve and the provenance of its training.
"""

import json
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from gymnasium import logger

from quadpend_baselines import Policy
from quadpend_baselines.estimation.feeding import fed_by_name
from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.hybrid import Hybrid, hybrid_from_data
from quadpend_baselines.hybrid.wrapper import NO_HYBRID
from quadpend_baselines.policy.protocol import episode_start_mask
from quadpend_baselines.policy.told import for_told_pole
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats32
from quadpend_gym.core.settings import Range, parse, settings
from quadpend_gym.physics.state import ACTION_SIZE
from quadpend_gym.scenarios import Scenario
from quadpend_gym.tasks.observation import FULL, LAB, OUTPUT_FEEDBACK, ObservationLayout, as_layout
from quadpend_train.common.files import atomic
from quadpend_train.common.text import brief
from quadpend_train.policies.normalization import Normalization

SHIPPED = Path(__file__).parent / "shipped"
FORMAT = "quadpend policy 2"
ACTIVATIONS: dict[str, Callable[[Any], Any]] = {
    "relu": lambda x: np.maximum(x, np.float32(0.0)),
    "tanh": np.tanh,
    "elu": lambda x: np.where(x > 0.0, x, np.expm1(np.minimum(x, np.float32(0.0)))),
}


@settings
class Card:
    """What determines the policy in a card."""

    format: Literal["quadpend policy 2"]
    activation: Literal["relu", "tanh", "elu"]  # function of the hidden layers
    squashed: bool  # whether the output goes through tanh; otherwise it is clipped to [−1, 1]
    hybrid: dict[str, Any] | None  # data for `hybrid_from_data`; None for a policy without base controller
    bound: Annotated[float | None, Range(1e-30, 1e30)] = None  # limit of the output before tanh
    input_scales: Annotated[tuple[float, ...], Range(1e-6, 1e6)] = ()  # s of the inputs [x, tanh(s₁ x), tanh(s₂ x), …]
    normalization: Normalization | None = None  # of the inputs
    interface: Literal["wrench", "rotors", "body_rates"] | None = None  # what an action commands; None: unknown
    vehicle: str | None = None  # of the training; "any": several; None: the paper's
    # Fields that the network reads; none: those of a preset, which the number of its inputs tells
    observation: tuple[str, ...] = ()


class MlpPolicy(Policy):
    """A feedforward network as a deterministic policy with the `predict` protocol.

    Layers are weights of shape (inputs, outputs) and biases of shape (outputs,), float32; the card has the fields of
    `Card`, and others.
    """

    layouts: tuple[ObservationLayout, ...]

    def __init__(self, layers: Sequence[tuple[Floats32, Floats32]], card: dict[str, Any]) -> None:
        known = {item.name for item in fields(Card)}
        if card.get("action_repeat", 1) != 1:
            raise ValueError("policies that repeat their actions fly in version 0.3 only")
        self._card = read = parse(Card, {name: value for name, value in card.items() if name in known}, "card")
        self.layers, self.card, self.input_scales = list(layers), card, read.input_scales
        self.hybrid: Hybrid | None = None if read.hybrid is None else hybrid_from_data(read.hybrid)
        self._activation, self._normalization = ACTIVATIONS[read.activation], read.normalization
        layouts = (as_layout(read.observation),) if read.observation else (FULL, OUTPUT_FEEDBACK)
        if self.hybrid and self.hybrid.reads == "lab":
            layouts = (LAB,)
            self.has_linear_model = False  # samples at rest repeat, and repeated ones are not taken
        sizes = [self.hybrid.observation_size(layout.size) if self.hybrid else layout.size for layout in layouts]
        inputs = len(self.layers[0][0]) / (1 + len(self.input_scales))
        self.layouts = tuple(layout for layout, size in zip(layouts, sizes, strict=True) if size == inputs)
        if not self.layouts:
            raise ValueError(f"the network takes {inputs:g} numbers, not {' or '.join(map(str, sizes))}")
        if self.hybrid and self.hybrid.reads == "estimates" and OUTPUT_FEEDBACK in self.layouts:
            self.layouts = (*self.layouts, LAB)  # its observer reads positions in the world
        with np.errstate(invalid="ignore"):
            output = self.forward(np.zeros((1, int(inputs)), np.float32))
        if output.shape != (1, ACTION_SIZE) or output.dtype != np.float32 or not np.isfinite(output).all():
            raise ValueError(f"the layers must be of float32 and finite, with {ACTION_SIZE} outputs")

    @classmethod
    def load(cls, name: str | Path) -> "MlpPolicy":
        """Load a policy file by its path, or a policy of this package by its name (``"apg-0"``)."""
        path = Path(name)
        if not path.is_file() and not (path := SHIPPED / f"{name}.npz").is_file():
            raise ValueError(f"{str(name)!r} must be the path of a policy file or the name of a policy of this package")
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as data:
                count = len(data.files) // 2
                layers = [(data[f"weights_{i}"], data[f"biases_{i}"]) for i in range(count)]
                return cls(layers, json.loads(str(data["card"])))
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
        """Return the policy with its base controller designed for a scenario, as it reads the observation there."""
        check_interface(self.card, scenario.simulation)
        if (hybrid := self.hybrid) is None:
            return fed_by_name(self, scenario)
        if scenario.task.pendulum == "hanging" and not hybrid.flies_load:
            raise ValueError(NO_HYBRID)

        def adapt(known: Scenario) -> Policy:
            other = copy(self)
            other.hybrid = hybrid.flown_in(known.simulation, Loop.known(known))
            return fed_by_name(other, known)

        return for_told_pole(adapt, scenario)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, Any]:
        """Return the action and the memory; see `quadpend_baselines.Policy.predict`."""
        observation = np.asarray(observation, np.float32)
        sizes = [layout.size for layout in self.layouts]
        if observation.shape[-1] not in sizes:
            raise ValueError(
                f"this policy takes observations of {' or '.join(map(str, sizes))} numbers, not of shape"
                f" {observation.shape}"
            )
        if not deterministic:
            raise ValueError("deterministic must be True: an MlpPolicy acts deterministically")
        if self.hybrid is None:
            return self.forward(observation), None
        rows = np.atleast_2d(observation)
        started = episode_start_mask(episode_start, state is None, len(rows))
        seen, memory = self.hybrid.observe(rows, state, started)
        action, memory = self.hybrid.act(self.forward(seen), memory)
        return action.reshape(*observation.shape[:-1], ACTION_SIZE), memory

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
        if (bound := self._card.bound) is not None:
            output = np.clip(output, -bound, bound)
        return np.asarray(np.tanh(output) if self._card.squashed else np.minimum(np.maximum(output, -1.0), 1.0))


def check_interface(card: dict[str, Any], simulation: Simulation) -> None:
    """Check that a policy's actions mean in a nominal simulation what they meant in its training.

    Policies from elsewhere have no `interface` on their card: they are not checked.
    """
    trained, interface = card.get("interface"), simulation.interface
    if trained is None:
        return
    if trained != interface:
        raise ValueError(
            f"the policy was trained with the interface {trained!r}, but the simulation has the interface {interface!r}"
        )
    vehicle = simulation.vehicle.name
    if (own := card.get("vehicle") or "paper") not in (vehicle, "any"):
        logger.warn("a policy trained on the vehicle %s flies the vehicle %s", own, vehicle)
