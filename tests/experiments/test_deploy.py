"""Policies as C pass their golden vectors on this computer and on the emulated chip, within its budget."""

from pathlib import Path

import pytest

from experiments import deploy


@pytest.mark.extras
@pytest.mark.skipif(bool(deploy.MISSING), reason=f"not installed: {', '.join(deploy.MISSING)}")
@pytest.mark.parametrize(
    ("name", "scenario"), [(name, scenario) for scenario, names in deploy.POLICIES.items() for name in names]
)
def test_a_policy_passes_on_the_chip_within_its_budget(name: str, scenario: str, tmp_path: Path) -> None:
    found = deploy.measure(name, scenario, tmp_path)
    assert found.flash <= 220_000
    assert found.ram <= 36_000
    assert found.instructions <= 450_000
