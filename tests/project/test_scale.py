"""The simulated cluster has the durations that can be computed by hand."""

import pytest

from benchmarks import scale
from benchmarks.scale import Costs, simulate
from quadpend_train.common.executors import executor

FREE = Costs(0.0, 0.0, 0.0)


def test_simulated_cluster_divides_equal_cells_among_its_workers() -> None:
    assert simulate([2.0] * 100, 1, FREE) == pytest.approx(200.0)
    assert simulate([2.0] * 100, 10, FREE) == pytest.approx(20.0)
    assert simulate([2.0] * 100, 1000, FREE) == pytest.approx(2.0)
    assert simulate([], 10, FREE) == 0.0


def test_start_driver_and_network_limit_a_cluster() -> None:
    assert simulate([2.0] * 10, 10, Costs(7.0, 0.0, 0.0)) == pytest.approx(9.0)
    assert simulate([0.0] * 1000, 1000, Costs(0.0, 0.1, 0.0)) == pytest.approx(100.0, rel=0.01)
    assert simulate([0.0] * 10, 1000, Costs(0.0, 0.0, scale.BANDWIDTH)) == pytest.approx(10.0)


def test_a_long_cell_at_the_end_and_slow_workers_delay_a_study() -> None:
    study = [1.0] * 99 + [10.0]
    assert simulate(study, 100, FREE) == pytest.approx(10.0)
    assert simulate(study, 10, FREE) > simulate(sorted(study, reverse=True), 10, FREE)
    assert simulate([1.0] * 100, 100, FREE, slow_share=1.0) == pytest.approx(scale.SLOW_FACTOR)


def test_measurements_fill_the_tables(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scale, "PROCESSES", (1,))
    monkeypatch.setattr(scale, "measure_cluster", lambda _: (Costs(1.0, 0.01, 1e4), 3.0))
    study = scale.cells(["lqr", "flatness"], ["calm"], 2)
    measured = scale.measure(study)
    parts = scale.tables(measured, [10])
    assert set(parts) == {"processes", "costs", "cluster", "memory"}
    assert "| 1,000 |" in parts["cluster"]
    assert "| 10 |" in parts["memory"]


def test_a_failed_cell_ends_the_measurement() -> None:
    with pytest.raises(RuntimeError, match="a failed"):
        scale.measure_executor(executor(), {"a": lambda: 1 / 0})
