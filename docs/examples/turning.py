"""A wind of your own: a force that turns about the vertical.

quadpend evaluate flatness lqr --scenarios calm turning:TurningForce
"""

import numpy as np


class TurningForce:
    moves_air = False  # a force on the quadrotor only; True if `sample` sets a velocity of the air
    memory_size = 1  # floats of each sub-environment: the heading of the force, rad

    def __init__(self, force=0.3, rate=0.5):
        self.force, self.rate = force, rate  # N, rad/s

    def initial_memory(self, streams):
        return 2.0 * np.pi * streams.uniform(0, 1)  # a random heading of each episode, shape (n, 1)

    def sample(self, out, memory, step, period, streams):
        out[:, 0] += self.force * np.cos(memory[:, 0])
        out[:, 1] += self.force * np.sin(memory[:, 0])
        memory[:, 0] += self.rate * period
