"""Equations of motion, physical parameters, the state and its integration."""
