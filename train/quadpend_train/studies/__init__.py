"""Studies made of many evaluations: robustness, recovery regions, ablations, tuning."""
