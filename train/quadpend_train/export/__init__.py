"""Policies for other programs: as C for microcontrollers."""
