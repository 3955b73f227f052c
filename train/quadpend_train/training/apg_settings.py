"""Settings of APG."""

from dataclasses import dataclass

from quadpend_gym.core.validation import check_int, check_number, check_positive


@dataclass(frozen=True)
class ApgSettings:
    """Settings of APG only; its module explains the cost."""

    window: int = 100
    """Control steps through which gradients are propagated; one gradient step per window."""
    rmse: float = 6.0
    """Weight w_R of the root mean square of the tracking error, mean over the scenarios, 1/m."""
    error: float = 0.1
    """Weight w₁ of the tracking error, 1/m."""
    yaw: float = 0.1
    """Weight w_ψ of the squared yaw error, 1/rad²."""
    effort: float = 1e-3
    """Weight w_a of the squared actions."""
    rate: float = 1e-4
    """Weight w_ω of the squared Euler-angle rates, s²/rad²."""
    lean: float = 100.0
    """Weight w_l of the cost of leaning."""
    max_grad_norm: float = 1.0
    """Largest norm of the gradient of a gradient step."""
    max_state_gradient: float = 3000.0
    """Largest norm of the gradient of the summed cost of a row with respect to its state at one step."""

    def __post_init__(self) -> None:
        check_int(self.window, "window", 1)
        for name in ("rmse", "error", "yaw", "effort", "rate", "lean"):
            check_number(getattr(self, name), name, 0.0)
        for name in ("max_grad_norm", "max_state_gradient"):
            check_positive(getattr(self, name), name)
