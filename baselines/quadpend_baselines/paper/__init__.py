"""The paper's experiment (its Section 5): simulation, figures and figures of merit."""
