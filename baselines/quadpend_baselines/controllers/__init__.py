"""Classical controllers: ADRC, flatness-based control, LQR, LQI and nonlinear MPC."""
