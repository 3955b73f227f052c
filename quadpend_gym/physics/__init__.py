"""Physics: the state, the physical parameters, the equations of motion, drag, and the integration in time."""
