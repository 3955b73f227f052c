"""Controllers of a pendulum below the quadrotor: a hanging load, and the swing-up."""
