"""Damaged files of policies, cards, results, settings and scenarios are refused with one sentence, or they work.

Policies and cached results that are read are unchanged; cards and scenarios work; settings can be read.

A *target* writes a valid file, damages it, and reads it again. Damage is done to the bytes of a file, and to the values
of the data in it, so that checksums do not hide what is behind them.
"""

import json
import random as stdlib_random
import warnings
from collections.abc import Callable, Iterator
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from quadpend_gym.scenarios import Scenario, find_scenario
from quadpend_train.evaluation import cache
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.training.settings import read_settings
from tests.helpers.policies import mlp_policy, synthetic_results

REFUSALS = (ValueError, TypeError, OSError)  # the exceptions that the command line prints as one sentence
VALUES: tuple[Any, ...] = (
    *(0, -1, 1, 2**31, 10**30, 0.0, -0.5, 1e-320, 1e308, float("nan"), float("inf"), True, False, None),
    *("", "a", "ä" * 300, "$\\frac$", "[red]", "../..", [], [0], [[]], [None], {}, {"a": 1}, [1e308] * 5, ["calm"] * 3),
)
_LONGEST_SENTENCE = 2000  # characters

Target = Callable[[stdlib_random.Random, Path], str]


def damaged_bytes(content: bytes, random: stdlib_random.Random) -> bytes:
    """Return the content with one to three random changes: bits, bytes, parts left out, repeated or cut off."""
    data = bytearray(content)
    for _ in range(random.randint(1, 3)):
        at, length = random.randrange(len(data) + 1), random.randint(1, 40)
        change = random.randrange(6)
        if change == 0 and at < len(data):
            data[at] ^= 1 << random.randrange(8)
        elif change == 1:
            data[at : at + length] = random.randbytes(length)
        elif change == 2:
            del data[at : at + length]
        elif change == 3:
            data[at:at] = data[at : at + length]
        elif change == 4:
            del data[at:]
        else:
            data[at:at] = random.randbytes(length)
    return bytes(data)


def _places(data: Any) -> Iterator[tuple[Any, Any]]:
    """Yield every container in nested data with a key of it."""
    for key, value in data.items() if isinstance(data, dict) else enumerate(data):
        yield data, key
        if isinstance(value, dict | list):
            yield from _places(value)


def damaged_data(data: Any, random: stdlib_random.Random) -> Any:
    """Return a copy of nested data with one or two random changes: a value replaced, left out, or a new key."""
    data = json.loads(json.dumps(data))
    for _ in range(random.randint(1, 2)):
        container, key = random.choice(list(_places(data)) or [(data, None)])
        change = random.randrange(5)
        if change == 0 and key is not None:
            del container[key]
        elif change == 1 and isinstance(container, dict):
            container[random.choice(["", "a", "seed", "kind"])] = deepcopy(random.choice(VALUES))
        elif key is not None:
            container[key] = deepcopy(random.choice(VALUES))
    return data


def attempt(read: Callable[[], Any], expected: Callable[[Any], bool]) -> str:
    """Read a damaged file. Return what was wrong with the reading; empty if nothing was.

    Args:
        read: Reads the file.
        expected: Whether what was read is right.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            found = read()
        except REFUSALS as error:
            text = str(error)
            return "" if text and "\n" not in text and len(text) < _LONGEST_SENTENCE else f"sentence {text[:200]!r}"
        except Exception as error:  # any other exception is a finding
            return f"{type(error).__name__}: {error}"[:300]
        try:
            return "" if expected(found) else "read, but not what was written"
        except Exception as error:  # every exception is a finding: the file should have been refused
            return f"read, but not usable: {type(error).__name__}: {error}"[:300]


def policy_file(random: stdlib_random.Random, folder: Path) -> str:
    """Damage the bytes of a policy file."""
    policy, path = mlp_policy(36, seed=random.randrange(100)), folder / "policy.npz"
    policy.save(path)
    path.write_bytes(damaged_bytes(path.read_bytes(), random))

    def same(found: MlpPolicy) -> bool:
        weights = zip(found.layers, policy.layers, strict=True)
        return found.card == policy.card and all(
            np.array_equal(x, y) for a, b in weights for x, y in zip(a, b, strict=True)
        )

    return attempt(lambda: MlpPolicy.load(path), same)


def card(random: stdlib_random.Random, folder: Path) -> str:
    """Damage values on the card of a policy; a card that is read must give a policy that acts and can be described."""
    from quadpend_train.cli.cards import _learned

    shipped = MlpPolicy.load(random.choice(["apg-0", "ppo-gain-scheduling-0", "sac-hummingbird-0"]))
    path = folder / "card.npz"
    shipped.save(path)
    with np.load(path, allow_pickle=False) as stored:
        arrays = dict(stored)
    changed = damaged_data(json.loads(str(arrays["card"])), random)
    arrays["card"] = np.array(json.dumps(changed))
    np.savez(path, **arrays)

    def works(found: MlpPolicy) -> bool:
        observations = np.zeros((2, found.observation_sizes[0]), np.float32)
        action, _ = found.predict(observations)
        return bool(np.isfinite(action).all())

    def load_and_describe() -> MlpPolicy:
        policy = MlpPolicy.load(path)
        list(_learned(policy))
        return policy

    return attempt(load_and_describe, works)


def kept_results(random: stdlib_random.Random, folder: Path) -> str:
    """Damage the bytes of a file of cached results; a damaged file counts as missing."""
    results = synthetic_results([0.1, 0.2, 0.3])
    cache.save(folder, "a", results)
    path = folder / "a.npz"
    path.write_bytes(damaged_bytes(path.read_bytes(), random))

    def same(found: Any) -> bool:
        pairs: Any = zip(found or results, results, strict=True)
        return all(np.array_equal(x, y, equal_nan=True) for x, y in pairs)

    return attempt(lambda: cache.load(folder, "a", results.error.shape[-1]), same)


def _settings_data() -> dict[str, Any]:
    from quadpend_train.training.settings import to_mapping

    return dict(to_mapping(read_settings("ppo-gain-scheduling")))


def settings(random: stdlib_random.Random, folder: Path) -> str:
    """Damage a file of training settings: its values in JSON, or its bytes in TOML."""
    data, path = _settings_data(), folder / ("s.json" if random.random() < 0.7 else "s.toml")
    if path.suffix == ".json":
        path.write_text(json.dumps(damaged_data(data, random)), encoding="utf-8")
    else:
        path.write_bytes(damaged_bytes(_toml(data).encode(), random))
    return attempt(lambda: read_settings(str(path)), lambda found: found is not None)


def _toml(data: Any) -> str:
    """Return nested data as TOML, with inline tables and without None."""
    return "\n".join(f"{json.dumps(key)} = {_inline(value)}" for key, value in data.items() if value is not None)


def _inline(value: Any) -> str:
    if isinstance(value, dict):
        items = (f"{json.dumps(key)} = {_inline(item)}" for key, item in value.items() if item is not None)
        return f"{{{', '.join(items)}}}"
    if isinstance(value, list):
        return f"[{', '.join(_inline(item) for item in value if item is not None)}]"
    if isinstance(value, float):
        return {"Infinity": "inf", "NaN": "nan"}.get(json.dumps(value), repr(value))
    return json.dumps(value, ensure_ascii=False)


SCENARIO = {
    "duration": 4.0,
    "wind": [{"kind": "gusts", "force": 1.0}, {"kind": "constant"}],
    "task": {"references": {"hover": 0.0, "radius": [0.5, 1.0]}, "start": {}},
    "simulation": {"period": 0.02, "parameters": {"bob_mass": 0.1}},
}


def scenario(random: stdlib_random.Random, folder: Path) -> str:
    """Damage a scenario file: its values, or its bytes."""
    path = folder / "scenario.toml"
    if random.random() < 0.7:
        path.write_text(_toml(damaged_data(SCENARIO, random)), encoding="utf-8")
    else:
        path.write_bytes(damaged_bytes(_toml(SCENARIO).encode(), random))
    return attempt(lambda: find_scenario(str(path)), flies)


def flies(found: Scenario) -> bool:
    """Return whether a scenario makes an environment that steps."""
    env: Any = found.make_vec(2, AutoresetMode.SAME_STEP)
    env.reset(seed=0)
    return bool(np.isfinite(env.step(np.zeros((2, 4), np.float32))[0]).all())


TARGETS: dict[str, Target] = {
    "policy files": policy_file,
    "cards": card,
    "kept results": kept_results,
    "settings": settings,
    "scenarios": scenario,
}


def fuzz(name: str, seeds: range, folder: Path) -> list[str]:
    """Damage a file once for each seed and return the findings, each with its seed."""
    found = ((seed, TARGETS[name](stdlib_random.Random(f"{name} {seed}"), folder)) for seed in seeds)
    return [f"{name}, seed {seed}: {text}" for seed, text in found if text]
