"""Policies for poles that are told: a design for each length of the pole.

Where a scenario tells the pole (`Scenario.pole_told`), the length differs from episode to episode. A design belongs to
one vehicle, so each row has that of the length nearest to its own, of a geometric sequence around the nominal length.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines.policy.protocol import Policy, PolicyWrapper, concatenate_rows, episode_start_mask, take_rows
from quadpend_gym.core.arrays import Floats32, Integers
from quadpend_gym.scenarios import Scenario
from quadpend_gym.vehicles.parts import Pole

RATIO = 1.05  # of a length to the one before


class ToldMemory(NamedTuple):
    """Memory of a `ToldPole` policy for n rows."""

    number: Integers  # of the design, from that of the nominal length, shape (n,)
    memory: Any  # of the designs


def for_told_pole(adapt: Callable[[Scenario], Policy], scenario: Scenario) -> Policy:
    """Return what `adapt` makes of a scenario, for each length of the pole where the scenario tells it."""
    return ToldPole(adapt, scenario) if scenario.pole_told else adapt(scenario)


def scaled_pole(pole: Pole, factor: float) -> Pole:
    """Return a pole whose length is multiplied by a factor, with the same mass and the same J/(m l²)."""
    return replace(
        pole, length=factor * pole.length, inertia=factor**2 * pole.inertia, extent=factor * pole.full_length
    )


class ToldPole(PolicyWrapper):
    """A policy that is designed for the pole that each episode tells.

    Args:
        adapt: Returns the policy for a scenario.
        scenario: With the nominal vehicle; it observes ``"pole"``.
    """

    def __init__(self, adapt: Callable[[Scenario], Policy], scenario: Scenario) -> None:
        if "pole" not in scenario.observation:
            raise ValueError('pole_told needs an observation with "pole", such as "lab"')
        super().__init__(adapt(scenario))
        self._adapt, self._scenario, self._designs = adapt, replace(scenario, pole_told=False), {0: self.policy}

    def _design(self, number: int) -> Policy:
        if number not in self._designs:
            vehicle = self._scenario.vehicle
            vehicle = replace(vehicle, pole=scaled_pole(vehicle.pole, RATIO**number))
            self._designs[number] = self._adapt(replace(self._scenario, vehicle=vehicle))
        return self._designs[number]

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, Any]:
        """Return action and memory; see `Policy.predict`."""
        observed = np.atleast_2d(observation)
        told = self._scenario.observation.read(observed, "pole")[:, 0] / self._scenario.vehicle.pole.length
        number = np.rint(np.log(told) / np.log(RATIO)).astype(np.int64)
        started = episode_start_mask(episode_start, state is None, len(observed))
        if state is not None:
            number = np.where(started, number, state.number)
        actions, memories, order = [], [], []
        for chosen in np.unique(number).tolist():
            rows = np.flatnonzero(number == chosen)
            before = None if state is None else take_rows(rows, state.memory)
            action, memory = self._design(chosen).predict(observed[rows], before, started[rows], deterministic)
            actions.append(action)
            memories.append(memory)
            order.append(rows)
        back = np.argsort(np.concatenate(order))
        action = np.concatenate(actions)[back]
        return action.reshape(np.shape(observation)[:-1] + action.shape[1:]), ToldMemory(
            number, take_rows(back, concatenate_rows(memories))
        )
