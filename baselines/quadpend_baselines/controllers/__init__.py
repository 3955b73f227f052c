"""Classical controllers: ADRC, flatness-based control, LQR, LQI, MPPI and nonlinear MPC."""
