"""Senseless vehicles: each is refused with one sentence that names file and field."""

from pathlib import Path
from typing import Any

import pytest

from quadpend_gym.vehicles import as_vehicle
from tests.helpers.bad_input import assert_refused

GOOD = """
mass = 0.5
inertia = [0.0032, 0.0032, 0.0055]
pole = {mass = 0.05, length = 0.5}
rotors.positions = [[0.1, 0.1], [-0.1, 0.1], [-0.1, -0.1], [0.1, -0.1]]
rotors.spins = [1, -1, 1, -1]
rotors.thrust = [0.0, 4.0]
rotors.torque_per_thrust = 0.02
"""
SENSELESS = {  # what the line replaces, the line, and a pattern of the message
    "mass in grams": ("mass", "mass = 5000", "mass must be .* not 5000"),
    "too heavy for its rotors": ("mass", "mass = 3.0", "rotors.thrust of 0 to 4 N must allow hover"),
    "impossible inertia": ("inertia", "inertia = [0.003, 0.003, 0.02]", "principal moments of which none exceeds"),
    "unknown pole": ("pole", "pole = 'hen'", "there is no pole 'hen' .did you mean 'hehn'"),
    "three rotors": ("rotors.positions", "rotors.positions = [[1,0],[0,1],[-1,0]]", "rotors.positions must be"),
    "neither rotors nor torque": ("rotors", "", "torque must be given"),
    "broken TOML": ("mass", "mass = ", "is not valid TOML"),
}


def changed(field: str, line: str) -> str:
    """Return the good vehicle with the lines that begin with `field` replaced."""
    lines = [item for item in GOOD.splitlines() if not item.startswith(field)]
    return "\n".join([*lines, line]) + "\n"


@pytest.mark.parametrize("case", SENSELESS)
def test_a_senseless_vehicle_is_refused_with_one_sentence_that_names_file_and_field(case: str, tmp_path: Path) -> None:
    field, line, pattern = SENSELESS[case]
    path = tmp_path / "mine.toml"
    path.write_text(changed(field, line))
    assert_refused(lambda: as_vehicle(str(path)), f"mine.toml.*{pattern}")


@pytest.mark.parametrize(
    ("value", "pattern"),
    [("humingbird", "did you mean 'hummingbird'"), ("missing.toml", "cannot be read"), (7, "vehicle must be")],
)
def test_what_is_no_vehicle_is_refused(value: Any, pattern: str) -> None:
    assert_refused(lambda: as_vehicle(value), pattern)
