"""Settings of the algorithms, each in a table of its own."""

from dataclasses import dataclass

from quadpend_gym.core.validation import check_int, check_number, check_positive


@dataclass(frozen=True)
class PpoSettings:
    """Settings of PPO only."""

    n_steps: int = 64
    """Steps of each sub-environment per rollout."""
    n_epochs: int = 3
    """Epochs of optimisation per rollout."""
    gae_lambda: float = 0.95
    """Factor λ of generalised advantage estimation."""
    clip_range: float = 0.2
    """Clipping range of the probability ratio of new and old policy."""
    ent_coef: float = 0.0
    """Coefficient of the entropy bonus in the loss."""
    log_std_init: float = 0.0
    """Initial logarithm of the standard deviation of the action noise."""
    critic_warmup_steps: int = 0
    """Timesteps at the beginning in which only the critic is trained, for policies that perform well from the start."""

    def __post_init__(self) -> None:
        for name in ("n_steps", "n_epochs"):
            check_int(getattr(self, name), name, 1)
        check_int(self.critic_warmup_steps, "critic_warmup_steps", 0)
        check_number(self.gae_lambda, "gae_lambda", 0.0, 1.0)
        check_positive(self.clip_range, "clip_range")
        check_number(self.ent_coef, "ent_coef", 0.0)
        check_number(self.log_std_init, "log_std_init")


@dataclass(frozen=True)
class SacSettings:
    """Settings of SAC and TQC only."""

    gradient_steps: int = 4
    """Gradient steps per step of the vector environment."""
    buffer_size: int = 300_000
    """Size of the replay buffer in transitions."""
    learning_starts: int = 10_000
    """Timesteps with random actions before training begins."""
    tau: float = 0.005
    """Polyak coefficient τ of the target network update."""
    ent_coef_init: float = 0.1
    """Initial value of the entropy coefficient, which is learned."""
    target_entropy: float = -4.0
    """Target entropy of the policy; the entropy coefficient is adjusted to reach it."""

    def __post_init__(self) -> None:
        for name in ("gradient_steps", "buffer_size", "learning_starts"):
            check_int(getattr(self, name), name, 1)
        check_number(self.tau, "tau", 0.0, 1.0)
        check_positive(self.ent_coef_init, "ent_coef_init")
        check_number(self.target_entropy, "target_entropy")


@dataclass(frozen=True)
class ApgSettings:
    """Settings of APG only; its module explains the cost."""

    window: int = 100
    """Control steps through which gradients are propagated; one gradient step per window."""
    restart: float = 0.5
    """Share of the rows of each scenario that begin a new episode with each window, rounded to whole rows."""
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
        check_number(self.restart, "restart", 0.0, 1.0)
        for name in ("rmse", "error", "yaw", "effort", "rate", "lean"):
            check_number(getattr(self, name), name, 0.0)
        for name in ("max_grad_norm", "max_state_gradient"):
            check_positive(getattr(self, name), name)
