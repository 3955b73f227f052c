"""The paper's experiment (its Section 5): simulation, figures, figures of merit, and ablations of the controller."""
