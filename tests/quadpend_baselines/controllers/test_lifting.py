"""CasADi reads the control laws and the observer: the expressions compute what the compiled functions compute."""

from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from quadpend_baselines.controllers.dual_mode import DualMode, dual_mode
from quadpend_baselines.controllers.dual_mode import unpack_gains as unpack_dual_mode
from quadpend_baselines.controllers.flatness import Flatness, flatness, unpack_gains
from quadpend_baselines.controllers.lqr import Lqr, lqr
from quadpend_baselines.controllers.lqr import unpack_numbers as unpack_lqr
from quadpend_baselines.estimation.estimate import DRAG, LOOP, Estimate
from quadpend_baselines.gains import gains_for
from quadpend_baselines.modelling.equivalent import equivalent_model
from quadpend_baselines.modelling.quantities import Derivatives, Forces, VehicleState
from quadpend_gym import Simulation
from quadpend_gym.engines import lift, vector
from quadpend_gym.physics.rigid_settings import make_rigid_settings
from quadpend_gym.physics.state import State
from quadpend_gym.physics.vectors import Four, Vec3
from tests.helpers.controllers import true_estimate

SIMULATIONS = {"paper": Simulation(), "hummingbird": Simulation(vehicle="hummingbird", interface="body_rates")}
ROWS = 5


def vectors(kind: Any, symbol: Any) -> Any:
    """Return a named tuple of vectors with the entries of a vector of CasADi."""
    return kind._make(Vec3(*ca.vertsplit(part)) for part in ca.vertsplit(symbol, 3))


@pytest.mark.parametrize("name", SIMULATIONS)
@pytest.mark.parametrize("law", ["flatness", "lqi", "dual-mode"])
def test_a_law_in_casadi_is_the_compiled_one(law: str, name: str) -> None:
    simulation, rng = SIMULATIONS[name], np.random.default_rng(1)
    gains, model = gains_for(law, simulation), equivalent_model(simulation).numbers
    rigid = make_rigid_settings(simulation) if name == "hummingbird" else None
    state, wind = ca.SX.sym("state", 18), ca.SX.sym("wind", 9)
    reference, memory = ca.SX.sym("reference", 25), ca.SX.sym("memory", 3)
    wanted = Derivatives(
        *(Vec3(*ca.vertsplit(part)) for part in ca.vertsplit(reference[:21], 3)), Four(*ca.vertsplit(reference[21:]))
    )
    inputs = vectors(VehicleState, state), vectors(Forces, wind), wanted
    controller: Any = {"flatness": Flatness, "lqi": Lqr, "dual-mode": DualMode}[law](gains, simulation)
    packed, _ = controller._numbers
    if law == "flatness":
        command = lift(flatness)(*inputs, unpack_gains(packed[0]), model, rigid)
    elif law == "lqi":
        integral = Vec3(*ca.vertsplit(memory))
        command, _ = lift(lqr)(inputs[0], inputs[2], integral, packed[0], unpack_lqr(packed[1]), model, rigid)
    else:
        command = lift(dual_mode)(*inputs, unpack_dual_mode(packed[0]), *packed[1:4], model, rigid)
    function = ca.Function("law", [state, wind, reference, memory], [vector(command)])

    states, winds = 0.1 * rng.normal(size=(ROWS, 18)), 0.01 * rng.normal(size=(ROWS, 9))
    s = State(states)
    s.direction[:, 2] = 1.0
    s.direction[:] /= np.linalg.norm(s.direction, axis=1, keepdims=True)
    orders, yaws = 0.1 * rng.normal(size=(ROWS, 5, 3)), 0.1 * rng.normal(size=(ROWS, 3))
    measurement = Estimate(np.zeros((ROWS, LOOP)))
    measurement.state[:], measurement.reference[:], measurement.yaw[:] = states, orders, yaws
    moving = measurement.array[:, DRAG:LOOP]
    moving[:] = 0.1 * rng.uniform(size=moving.shape)  # velocity and coefficients of the drag
    memories: Any = 0.01 * rng.normal(size=(ROWS, 3))
    given = memories if law == "lqi" else ()
    expected, _ = controller.command(true_estimate(measurement, winds), given)
    references = np.hstack([orders.reshape(ROWS, -1), yaws, moving])
    for row in range(ROWS):
        found = np.array(function(states[row], winds[row], references[row], memories[row])).ravel()
        assert_allclose(found, expected[row], rtol=1e-9, atol=1e-9)
