"""The protocol that all hybrids share.

A hybrid combines a classical base controller with a policy. At every control step the hybrid first computes the
policy's observation (`Hybrid.observe`), and then computes the action that is applied to the environment from the
policy's action (`Hybrid.act`). Three classes use the policy's action a ∈ [−1, 1]⁴ in different ways, with the action
scale κ:

| class                 | applied action                                                                              |
|-----------------------|---------------------------------------------------------------------------------------------|
| `EstimateOnly`        | (1)  a                                                                                      |
| `ResidualAction`      | (2)  clip(a_base + κ a, −1, 1)                                                              |
| `BandwidthScheduling` | (3)  the base controller's action, with its four bandwidths multiplied by (1 + κ)^a         |

Equation (4), in `fallback`, optionally scales a down when the base controller's observer reports an anomaly.

The policy's observation contains, in this order,

| part                                                                                    | size     | scale      |
|-----------------------------------------------------------------------------------------|----------|------------|
| the observation of the base controller's state estimate; without one, the environment's | 36 or 27 | its own    |
| the estimated disturbance, with the layout of ``info["disturbance"]``                   | 9        | 1 N, 1 N·m |
| the action of the base controller; with `ResidualAction` only                           | 4        | 1          |
| the situation, see `situation`; with ``EstimateOnly(situation=True)`` only              | 12       | its own    |

`ResidualAction` and `BandwidthScheduling` multiply the part of the observation that depends on the state, and the base
controller's action, by ten, because the base controller keeps these values small.
"""

from typing import Any, ClassVar, NamedTuple, Protocol

from quadpend_baselines.estimation.loop import Loop
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats, Floats32


class HybridMemory(NamedTuple):
    """The state of a hybrid between two calls, for n rows."""

    controller: Any  # memory of the base controller
    base_action: Floats32  # action of the base controller, (n, 4); zeros if the hybrid computes it later
    anomaly_score: Floats  # q of equation (4), (n,); zeros without a fallback gain
    situation: Any = ()  # `Situation`; empty for hybrids that do not observe it


class Hybrid(Protocol):
    """A base controller combined with a policy.

    Attributes:
        kind: The key of the class in `quadpend_baselines.hybrid.registry.HYBRIDS`.
        base_controller: The classical controller.
        base_controller_name: The name by which the base controller was given, one of
            `quadpend_baselines.CONTROLLERS`; None if it was given as an object.
    """

    kind: ClassVar[str]
    base_controller: Any
    base_controller_name: str | None

    def observation_size(self, size: int) -> int:
        """Return the size of the policy's observation if the environment's observation has `size` numbers."""

    def observe(
        self, observation: Floats32, memory: HybridMemory | None, episode_start: Any
    ) -> tuple[Floats32, HybridMemory]:
        """Update the base controller's estimate and make the policy's observation.

        Args:
            observation: Observation of the environment, shape (n, 36) or (n, 27).
            memory: Memory that the last call of `act` returned; None at the first step.
            episode_start: Mask of the rows whose episode begins with this observation, shape (n,).

        Returns:
            The policy's observation, shape (n, m) with m from `observation_size`, and the memory for `act`.
        """

    def base_action(self, memory: HybridMemory) -> tuple[Floats32, HybridMemory]:
        """Return the action that the base controller would apply, shape (n, 4), and the memory after that, for `act`.

        `BandwidthScheduling` returns zeros, because its base controller acts only after the policy. In other hybrids,
        base controllers with an integral or a plan expect this call in every step.

        Args:
            memory: Memory that the last call of `observe` returned.
        """

    def act(self, action: Floats32, memory: HybridMemory) -> tuple[Floats32, HybridMemory]:
        """Turn the policy's action into the action to apply, and pass the latter to the base controller's observer.

        Args:
            action: Action of the policy, shape (n, 4).
            memory: Memory that the last call of `observe` or `base_action` returned.

        Returns:
            The action to apply to the environment, shape (n, 4), and the memory for the next call of `observe`.
        """

    def with_simulation(self, simulation: Simulation, loop: Loop | None = None) -> "Hybrid":
        """Return this hybrid with a base controller that is designed for another nominal simulation and loop."""

    def as_data(self) -> dict[str, Any]:
        """Return plain data from which `hybrid_from_data` makes the same hybrid.

        Raises:
            ValueError: If the base controller was given as an object, which has no name.
        """
