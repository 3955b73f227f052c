"""Learned policies in a file that executes nothing: weights, and a card that says where they come from.

A file is an npz archive with float32 matrices and vectors and one JSON text, the card. numpy is all that is needed to
load and fly it, and where a policy has a companion, a classical controller of `baselines`; neither torch nor SB3 is:

    policy = LearnedPolicy.load("ppo-pace-0")
    action, memory = policy.predict(observation, memory)
"""

import json
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines.policy.protocol import episode_start_mask, select_rows
from quadpend_gym.core.arrays import Floats, Floats32, Integers
from quadpend_gym.physics.state import ACTION_SIZE, DISTURBANCE_SIZE
from quadpend_gym.tasks.observation import OBSERVATION_SIZE, OUTPUT_FEEDBACK_SIZE

SHIPPED = Path(__file__).parent / "shipped"
FORMAT = "quadpend policy 1"
OBSERVATION_SIZES = (OBSERVATION_SIZE, OUTPUT_FEEDBACK_SIZE)
_LARGEST = 64 * 2**20  # bytes
VIEW = {
    "companion": str,
    "steers": str,
    "authority": float,
    "caution": float,
    "hold": int,
    "history": int,
    "history_actions": int,
}
ACTIVATIONS: dict[str, Callable[[Any], Any]] = {
    "relu": lambda x: np.maximum(x, np.float32(0.0)),
    "tanh": np.tanh,
    "elu": lambda x: np.where(x > 0.0, x, np.expm1(np.minimum(x, np.float32(0.0)))),
}


class MlpMemory(NamedTuple):
    """What a policy with a companion or a history remembers from one call to the next, for n rows."""

    companion: Any
    observations: Floats32  # the latest of what it sees, oldest first, (n, k, m)
    actions: Floats32  # the latest that it took, (n, j, 4)
    held: Floats32  # what it decided last, (n, 4)
    age: Integers  # steps since the episode began, (n,)


class MlpPolicy:
    """A feedforward network as a policy with the `predict` protocol; it acts deterministically.

    Args:
        layers: weights of shape (inputs, outputs) and biases of each layer, float32.
        card: where it comes from. Of it ``activation`` (relu, tanh, elu), ``squashed`` (whether a tanh bounds the
            action, which is clipped otherwise), ``bound`` (of what goes into that, if there is one) and ``view``
            (``companion``, ``steers``, ``authority``, ``caution``, ``hold``, ``history`` and ``history_actions`` of
            `quadpend_train.training.settings.TrainSettings`) say how it flies.

    Raises:
        ValueError: layers and card do not make a policy.
    """

    def __init__(self, layers: Sequence[tuple[Floats32, Floats32]], card: dict[str, Any]) -> None:
        """Check that the parts fit together."""
        _check_card(card)
        self.layers = [(weights, biases) for weights, biases in layers]
        self.card = card
        view = card["view"]
        self._hold, self._history, self._history_actions = (
            view[name] for name in ("hold", "history", "history_actions")
        )
        self._bend, self._squashed = ACTIVATIONS[card["activation"]], card["squashed"]
        self._companion: Any = None
        if view["companion"]:
            self._companion = _companion(view)
        self._memoryless = self._companion is None and self._history == 1 and not self._history_actions
        _check_layers(self.layers)
        self.sizes = tuple(size for size in OBSERVATION_SIZES if self._inputs(size) == self.layers[0][0].shape[0])
        if not self.sizes:
            raise ValueError(
                f"its first layer takes {self.layers[0][0].shape[0]} numbers, not the"
                f" {' or '.join(str(self._inputs(size)) for size in OBSERVATION_SIZES)} that its card asks for"
            )

    @classmethod
    def load(cls, name: str | Path) -> "MlpPolicy":
        """The policy in a file, or that of this package which is called so (``"ppo-pace-0"``).

        Raises:
            ValueError: there is no such file, or it holds no policy.
        """
        path = Path(name)
        if not path.is_file() and not (path := SHIPPED / f"{name}.npz").is_file():
            raise ValueError(f"there is no learned policy {str(name)!r}: it is neither a file nor one of this package")
        try:
            _check_size(path)
            with path.open("rb") as file, np.load(file, allow_pickle=False) as data:
                arrays = {key: data[key] for key in data.files}
            card = json.loads(str(arrays.pop("card")))
            count = len(arrays) // 2
            layers = [(arrays.pop(f"weights_{i}"), arrays.pop(f"biases_{i}")) for i in range(count)]
            if arrays:
                raise ValueError(f"it also holds {', '.join(sorted(arrays))}")
            return cls(layers, card)
        except KeyError as error:
            raise ValueError(f"{path} is no learned policy: it has no {error}") from error
        except Exception as error:  # whatever a broken archive makes its readers raise
            raise ValueError(f"{path} is no learned policy: {error}") from error

    def save(self, path: Path) -> None:
        """Write the policy to a file; an interruption leaves what was there."""
        arrays: dict[str, Any] = {"card": np.array(json.dumps(self.card))}
        for i, (weights, biases) in enumerate(self.layers):
            arrays |= {f"weights_{i}": weights, f"biases_{i}": biases}
        unfinished = path.with_suffix(".tmp")
        with unfinished.open("wb") as file:
            np.savez_compressed(file, **arrays)
        unfinished.replace(path)

    def with_simulation(self, simulation: Any) -> "MlpPolicy":
        """The same policy, whose companion believes in another nominal simulation."""
        if self._companion is None:
            return self
        other = MlpPolicy(self.layers, self.card)
        other._companion = _companion(self.card["view"], simulation)
        return other

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, Any]:
        """Action and memory; see `baselines.Policy.predict`.

        Raises:
            ValueError: the observation has another size than this policy flies from, or `deterministic` is False.
        """
        observation = np.asarray(observation, np.float32)
        if observation.shape[-1] not in self.sizes or not deterministic:
            raise ValueError(
                "a LearnedPolicy acts deterministically, it keeps no noise"
                if observation.shape[-1] in self.sizes
                else f"this policy takes observations of {' or '.join(map(str, self.sizes))} numbers, not of shape"
                f" {observation.shape}"
            )
        if self._memoryless:
            return self.act(observation), None
        single = observation.ndim == 1
        action, memory = self._remembering(np.atleast_2d(observation), state, episode_start)
        return (action[0] if single else action), memory

    def estimated_disturbance(self, memory: Any) -> Floats:
        """The disturbance that its companion has estimated, shape (n, 9); nan where it has none."""
        if self._companion is None:
            return np.full((1, DISTURBANCE_SIZE), np.nan)
        return np.asarray(self._companion.controller.estimated_disturbance(memory.companion.controller))

    def act(self, seen: Floats32) -> Floats32:
        """What the network makes of all that it sees, shape (inputs,) or (n, inputs): (4,) or (n, 4)."""
        for weights, biases in self.layers[:-1]:
            seen = self._bend(seen @ weights + biases)
        weights, biases = self.layers[-1]
        action = seen @ weights + biases
        if "bound" in self.card:
            action = np.clip(action, -self.card["bound"], self.card["bound"])
        return np.asarray(np.tanh(action) if self._squashed else np.minimum(np.maximum(action, -1.0), 1.0))

    def _remembering(self, observation: Floats32, state: Any, episode_start: Any) -> tuple[Floats32, MlpMemory]:
        started = episode_start_mask(episode_start, state is None, len(observation))
        seen, companion = observation, None
        if self._companion is not None:
            seen, companion = self._companion.watch(observation, state and state.companion, started)
        memory = MlpMemory(
            companion,
            np.repeat(seen[:, np.newaxis], self._history, axis=1),
            np.zeros((len(seen), self._history_actions, ACTION_SIZE), np.float32),
            np.zeros((len(seen), ACTION_SIZE), np.float32),
            np.zeros(len(seen), np.int64),
        )
        if state is not None:
            kept = state._replace(companion=(), observations=_pushed(state.observations, seen))
            memory = select_rows(started, memory._replace(companion=()), kept)
        flat = [memory.observations.reshape(len(seen), -1), memory.actions.reshape(len(seen), -1)]
        action = self.act(np.concatenate(flat, axis=1))
        if self._hold > 1:
            action = select_rows(memory.age % self._hold == 0, action, memory.held)
        memory = MlpMemory(companion, memory.observations, _pushed(memory.actions, action), action, memory.age + 1)
        if self._companion is not None:
            action, companion = self._companion.act(action, companion)
            memory = memory._replace(companion=companion)
        return action, memory

    def _inputs(self, observations: int) -> int:
        """How many numbers the network takes where an observation has so many."""
        seen = observations if self._companion is None else self._companion.size(observations)
        return int(self._history * seen + self._history_actions * ACTION_SIZE)


def difference(policy: MlpPolicy, other: MlpPolicy) -> float:
    """The largest difference of two policies' weights; infinite where they are built differently."""
    pairs = [pair for layers in zip(policy.layers, other.layers, strict=False) for pair in zip(*layers, strict=True)]
    if len(policy.layers) != len(other.layers) or any(a.shape != b.shape for a, b in pairs):
        return float("inf")
    return max(float(np.abs(a - b).max()) for a, b in pairs)


def _check_size(path: Path) -> None:
    """Raise ValueError if a file would unpack to more than a policy ever is."""
    with zipfile.ZipFile(path) as archive:
        size = sum(item.file_size for item in archive.infolist())
    if size > _LARGEST:
        raise ValueError(f"it would unpack to {size} bytes, and a policy has at most {_LARGEST}")


def _pushed(memory: Floats32, value: Floats32) -> Floats32:
    """`memory` without its oldest, and with `value` as its latest."""
    return np.concatenate([memory[:, 1:], value[:, np.newaxis]], axis=1)[:, : memory.shape[1]]


def _companion(view: dict[str, Any], simulation: Any = None) -> Any:
    from quadpend_baselines import controller
    from quadpend_baselines.hybrid.companion import Companion

    return Companion(controller(view["companion"], simulation), view["steers"], view["authority"], view["caution"])


def _check_card(card: Any) -> None:
    if not isinstance(card, dict) or card.get("format") != FORMAT:
        raise ValueError(f"its card is not of the format {FORMAT!r}")
    if card.get("activation") not in ACTIVATIONS:
        raise ValueError(f"its activation must be one of {', '.join(ACTIVATIONS)}, not {card.get('activation')!r}")
    if not isinstance(card.get("squashed"), bool):
        raise ValueError(f"squashed must be true or false, not {card.get('squashed')!r}")
    bound = card.get("bound", 1.0)
    if not isinstance(bound, float) or not 0.0 < bound < float("inf"):
        raise ValueError(f"bound must be a number above zero, not {bound!r}")
    if isinstance(view := card.get("view"), dict):
        view.setdefault("caution", 0.0)  # which older cards do not know
    if not isinstance(view, dict) or {name: type(value) for name, value in view.items()} != VIEW:
        raise ValueError(f"its view must have {', '.join(VIEW)}, not {view!r}")
    if view["hold"] < 1 or view["history"] < 1 or view["history_actions"] < 0:
        raise ValueError(f"its view must hold at least 1 step, with a history of at least 1 and 0, not {view!r}")


def _check_layers(layers: Sequence[tuple[Any, Any]]) -> None:
    if not layers:
        raise ValueError("it has no layers")
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
        raise ValueError(f"it puts out {inputs[0]} numbers, not an action's {ACTION_SIZE}")
