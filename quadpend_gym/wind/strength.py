"""Largest force of a wind relative to the weight of a vehicle, and a warning if the wind is too strong for it."""

from typing import Any

import numpy as np
from gymnasium import logger

from quadpend_gym.core.models import ModelBatch
from quadpend_gym.core.streams import WIND_STREAM, Streams
from quadpend_gym.physics.drag import AIR_DENSITY
from quadpend_gym.vehicles import PAPER, Simulation
from quadpend_gym.wind.base import WIND_FIELDS, WIND_SIZE
from quadpend_gym.wind.registry import KINDS

_SAMPLES = 64
_DURATION = 10.0  # s, the samples are taken at equally spaced times up to this one


def largest_force(models: tuple[Any, ...], simulation: Simulation) -> float:
    """Return the largest force on quadrotor and bob together, in N, in 64 samples of the wind, each with its own seed.

    The drag is that of a vehicle at rest. A model that is not of this package counts as zero.

    Args:
        models: Wind models, as returned by `as_wind`.
        simulation: Drag areas and control period.
    """
    wind = np.zeros((WIND_SIZE, _SAMPLES)).T
    step = np.linspace(0.0, _DURATION / simulation.period, _SAMPLES).astype(np.int64)
    streams = Streams.from_seeds(list(range(_SAMPLES))).derive(WIND_STREAM)
    batch = ModelBatch(tuple(model for model in models if _is_built_in(model)), _SAMPLES)
    batch.start_episodes(
        np.arange(_SAMPLES), streams, lambda model, *own: model.sample(wind, own[0], step, simulation.period, own[1])
    )
    force, bob_force, _, velocity = (wind[:, columns] for columns in WIND_FIELDS.values())
    area = simulation.parameters.quadrotor_drag_area + simulation.parameters.bob_drag_area
    drag = 0.5 * AIR_DENSITY * area * np.linalg.norm(velocity, axis=1, keepdims=True) * velocity
    return float(np.linalg.norm(force + bob_force + drag, axis=1).max())


def warn_if_too_strong(models: tuple[Any, ...], simulation: Simulation) -> None:
    """Warn if the wind pushes a vehicle that is lighter than the paper's with more than its weight.

    Args:
        models: Wind models, as returned by `as_wind`.
        simulation: Physical parameters and control period.
    """
    weight = simulation.parameters.hover_thrust
    if weight >= PAPER.hover_thrust or (force := largest_force(models, simulation)) <= weight:
        return
    logger.warn(
        f"the wind pushes with up to {force:.2g} N and the vehicle weighs {weight:.2g} N, so it will fall: the named"
        f" winds and the defaults of the models suit the paper's vehicle of {PAPER.hover_thrust:.2g} N"
    )


def _is_built_in(model: Any) -> bool:
    return type(model) in KINDS.values() and all(map(_is_built_in, getattr(model, "parts", ())))
