"""Observers: estimates of the state and of the disturbance from measurements."""
