"""The base class of the control laws that `controllers.output_feedback` flies."""

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from quadpend_baselines.estimation.estimate import Estimate
from quadpend_baselines.estimation.kalman import Estimator
from quadpend_baselines.estimation.loop import Loop
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats

# What estimates the disturbance: a Kalman filter, which estimates the state too; the observers of ADRC; nothing that
# other classes may read; or there is no controller
ObserverKind = Literal["kalman", "deso", "hidden", "none"]


@dataclass(frozen=True)
class Law:
    """Thrust and torques as a function of the estimates, for n rows.

    A law declares the class of its gains by the annotation of `gains`; its memory is that of the law alone.
    """

    gains: Any
    simulation: Simulation
    flies_load: ClassVar[bool] = False  # whether it was tested with a hanging load
    has_linear_model: ClassVar[bool] = True  # False: `modelling.linear_loop` need not look for one
    observer: ClassVar[ObserverKind] = "kalman"
    is_linear_near: ClassVar[bool] = False  # whether it has the feedback that `hybrid.deviations` reads
    has_c: ClassVar[bool] = True  # whether it can be written as C
    commands_actions: ClassVar[bool] = False  # whether commands are actions, of which a zero thrust is that of hover

    def estimator(self, loop: Loop) -> Any:
        """Return the estimator for a known loop; by default the Kalman filter with the gains `estimator`."""
        return Estimator(self.gains.estimator, self.simulation, loop)

    def initial_memory(self, rows: int) -> Any:
        """Return the memory at the start of an episode: an array of `rows` rows or a tuple of such arrays."""
        return ()

    def command(self, estimate: Estimate, memory: Any) -> tuple[Floats, Any]:
        """Return thrust (N) and torques (N·m), or actions, shape (n, 4), before saturation, and the memory."""
        raise NotImplementedError
