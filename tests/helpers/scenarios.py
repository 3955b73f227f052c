"""Short episodes, for tests whose statements do not depend on the length of an episode."""

from dataclasses import replace

import pytest

from quadpend_gym.scenarios import SCENARIOS, Scenario, find_scenario
from quadpend_gym.scenarios.library import shipped


def short(name: str, duration: float) -> Scenario:
    """Return a scenario with shorter episodes; `duration` in s."""
    return replace(find_scenario(name), duration=duration, unscored=0.0)


def shorten_scenarios(monkeypatch: pytest.MonkeyPatch, duration: float) -> None:
    """Let the episodes of every named scenario last for `duration` seconds."""
    for name in list(SCENARIOS):
        monkeypatch.setitem(shipped()[0], name, short(name, duration))
