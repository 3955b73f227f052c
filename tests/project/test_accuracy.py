"""The measurements of docs/accuracy.md run with small numbers, and the page says what they found."""

from benchmarks import accuracy
from quadpend_gym.vehicles import VEHICLES
from tests.helpers.mujoco_engine import position_errors


def test_energy_hardly_drifts_in_an_episode() -> None:
    energy, episode, largest = accuracy.energy_drift(1000)
    assert 0.1 < energy < 10.0
    assert 0.0 < episode == largest < 1e-4


def test_shorter_substeps_help_where_the_rule_asks_for_them() -> None:
    name, period = "rod of 0.1 m, bob of 0.5 kg", 0.02
    body = accuracy.BODIES[name]
    run = position_errors(body, 0, accuracy.SECONDS, period, [2, 4, 20])
    assert run.errors[2] > 8.0 * run.errors[4]
    assert run.errors[20] < 1e-5 * body.rod_length
    assert "error with h" in accuracy.rule_table({(name, period): [run]})


def test_rigid_vehicles_agree_with_mujoco_at_their_periods() -> None:
    run = accuracy.rigid_comparison(VEHICLES["hummingbird"], 0, 0.01)
    assert run.errors[20] < 1e-7 < run.errors[1]
    assert "| hummingbird | 10 ms |" in accuracy.mujoco_table({("hummingbird", 0.01): [run]})
