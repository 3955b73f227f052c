"""Observers of integrator chains: poles of the error, prediction, disturbance estimates, and the switching term."""

import numpy as np
import pytest

from quadpend_baselines.estimation.observers import (
    ESO_INPUT,
    LUENBERGER_INPUT,
    chain,
    characteristic_polynomial,
    current_gain,
    design_observers,
    input_gain,
    update_observers,
)
from quadpend_baselines.gains import ObserverGains

GAINS = [ObserverGains(500.0), ObserverGains(15.0, damping=0.7)]


@pytest.mark.parametrize("gains", GAINS)
@pytest.mark.parametrize("period", [1e-3, 1e-2])
def test_poles_of_the_sampled_error_are_the_exponentials_of_the_continuous_ones(
    gains: ObserverGains, period: float
) -> None:
    gain = current_gain(gains, period)
    error_matrix = (np.eye(4) - np.outer(gain, [1, 0, 0, 0])) @ chain(period)
    designed = np.poly(np.exp(np.roots(characteristic_polynomial(gains)) * period))
    np.testing.assert_allclose(np.poly(error_matrix), designed, atol=1e-8)
    assert np.max(np.abs(np.linalg.eigvals(error_matrix))) < 1.0


@pytest.mark.parametrize("driven", [ESO_INPUT, LUENBERGER_INPUT])
def test_prediction_is_exact_for_a_constant_input(driven: int) -> None:
    """A chain with a constant input is a polynomial in time; an observer without initial error keeps no error."""
    period, known_input = 0.01, 3.0
    bank = design_observers([(driven, ObserverGains())], period)
    start = np.array([1.0, -2.0, 0.5, 4.0])
    estimate = start.reshape(4, 1).copy()
    for step in range(1, 50):
        true = chain(step * period) @ start + known_input * input_gain(driven, step * period)
        update_observers(estimate, 0, (known_input,), (known_input,), (true[0],), bank, period)
        np.testing.assert_allclose(estimate[:, 0], true, rtol=1e-7, atol=1e-7)


def _last_correction(gains: ObserverGains, error: float) -> float:
    estimate = np.zeros((4, 1))
    update_observers(estimate, 0, (0.0,), (0.0,), (error,), design_observers([(ESO_INPUT, gains)], 0.01), 0.01)
    return float(estimate[3, 0])


def test_switching_term_is_linear_inside_its_layer_and_saturates_outside() -> None:
    linear, saturated = ObserverGains(50.0), ObserverGains(50.0, switching=10.0)
    sign = ObserverGains(50.0, switching=10.0, layer=0.0)
    assert _last_correction(saturated, 1e-9) == _last_correction(linear, 1e-9)
    assert _last_correction(saturated, 1.0) == pytest.approx(10.0 * 0.01)
    assert _last_correction(linear, 1.0) > 1.0
    assert [_last_correction(sign, error) for error in (1e-9, -3.0, 0.0)] == pytest.approx([0.1, -0.1, 0.0])
