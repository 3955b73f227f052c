"""Linear filters of white noise keep their variance at every sampling period."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quadpend_gym import Dryden
from quadpend_gym.wind.filters import discretise


@pytest.mark.parametrize("period", [1e-4, 1e-2, 1.0, 1000.0])
def test_the_stationary_covariance_is_invariant(period: float) -> None:
    """Φ P Φᵀ + L Lᵀ = P, relative to the standard deviations."""
    system = Dryden("severe").filter
    discrete, covariance = discretise(system, period), system.stationary_covariance
    after = discrete.transition @ covariance @ discrete.transition.T + discrete.noise_gain @ discrete.noise_gain.T
    scale = np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    assert_allclose(after / scale, covariance / scale, rtol=0.0, atol=1e-12)
