"""Senseless vehicles: each is refused with one sentence that names the field."""

from pathlib import Path
from typing import Any

import pytest

from quadpend_gym.vehicles import VEHICLES, Vehicle, as_vehicle, mixing
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
    "mass in grams": ("mass", "mass = 5000", "vehicle.mass must be .* not 5000"),
    "no mass": ("mass", "", "vehicle lacks the field 'mass'"),
    "zero mass": ("mass", "mass = 0", "vehicle.mass must be .* not 0"),
    "negative mass": ("mass", "mass = -0.5", "vehicle.mass must be .* not -0.5"),
    "mass as text": ("mass", "mass = '0.5 kg'", "vehicle.mass must be a number, not '0.5 kg'"),
    "mass is nan": ("mass", "mass = nan", "vehicle.mass must be a finite number .* not nan"),
    "mass is true": ("mass", "mass = true", "vehicle.mass must be a number, not True"),
    "misspelt field": ("mass", "mas = 0.5", "no field 'mas' .did you mean 'mass'"),
    "unknown part": ("mass", "mass = 0.5\nwings = 2", "vehicle has no field 'wings'"),
    "too heavy for its rotors": ("mass", "mass = 3.0", "rotors.thrust must carry the weight of 29.9.* 4 N"),
    "inertia in g m2": ("inertia", "inertia = [3.2, 3.2, 5.5]", "at most 0.09 kg·m² .* 0.141 m .*be in g·m²"),
    "inertia in g cm2": ("inertia", "inertia = [32000, 32000, 55000]", "vehicle.inertia must be between"),
    "inertia of a point": ("inertia", "inertia = [1e-9, 1e-9, 1e-9]", "vehicle.inertia must be between"),
    "one number of inertia": ("inertia", "inertia = 0.003", "vehicle.inertia must be three numbers"),
    "two numbers of inertia": ("inertia", "inertia = [0.003, 0.003]", "vehicle.inertia must be three numbers"),
    "negative inertia": ("inertia", "inertia = [0.003, -0.003, 0.005]", "positive definite"),
    "impossible inertia": ("inertia", "inertia = [0.003, 0.003, 0.02]", "principal moments of which none exceeds"),
    "asymmetric inertia": ("inertia", "inertia = [[3e-3,1e-4,0],[0,3e-3,0],[0,0,5e-3]]", "must be symmetric"),
    "ragged inertia": ("inertia", "inertia = [[3e-3, 0], [0, 3e-3], 5e-3]", "vehicle.inertia must be three numbers"),
    "inertia as text": ("inertia", "inertia = ['a', 'b', 'c']", "vehicle.inertia must be a number, not 'a'"),
    "unknown pole": ("pole", "pole = 'hen'", "there is no pole 'hen' .did you mean 'hehn'"),
    "pole without length": ("pole", "pole = {mass = 0.05}", "pole lacks the field 'length'"),
    "pole as a number": ("pole", "pole = 0.5", "pole must be a Pole or a mapping of its fields, not 0.5"),
    "pole of no length": ("pole", "pole = {mass = 0.05, length = 0}", "pole.length must be"),
    "pole in millimetres": ("pole", "pole = {mass = 0.05, length = 500}", "pole.length must be .* m, not 500"),
    "pole of no mass": ("pole", "pole = {mass = 0, length = 0.5}", "pole.mass must be"),
    "inertia of no pole": ("pole", "pole = {mass = 0.05, length = 0.5, inertia = 1.0}", "pole.inertia must be"),
    "extent below length": ("pole", "pole = {mass = 0.05, length = 0.5, extent = 0.2}", "pole.extent must be"),
    "negative drag of the pole": ("pole", "pole = {mass = 0.05, length = 0.5, drag_area = -1}", "pole.drag_area must"),
    "three rotors": ("rotors.positions", "rotors.positions = [[1,0],[0,1],[-1,0]]", "rotors.positions must be four"),
    "rotors without positions": ("rotors.positions", "", "vehicle.rotors lacks the field 'positions'"),
    "rotors in one place": ("rotors.positions", "rotors.positions = [[0,0],[0,0],[0,0],[0,0]]", "independently"),
    "rotors on a line": ("rotors.positions", "rotors.positions = [[2,0],[1,0],[-1,0],[-2,0]]", "independently"),
    "rotors in millimetres": (
        "rotors.positions", "rotors.positions = [[99,99],[-99,99],[-99,-99],[99,-99]]", "rotors.positions must be .* 99"
    ),
    "rotors in front": (
        "rotors.positions", "rotors.positions = [[0.3,0.1],[0.1,0.1],[0.1,-0.1],[0.3,-0.1]]", "must allow hover within"
    ),
    "equal spins": ("rotors.spins", "rotors.spins = [1, 1, 1, 1]", "opposite spins"),
    "equal spins on each side": ("rotors.spins", "rotors.spins = [1, 1, -1, -1]", "opposite spins"),
    "one odd spin": ("rotors.spins", "rotors.spins = [1, 1, 1, -1]", "must allow hover within"),
    "spin as a speed": ("rotors.spins", "rotors.spins = [500, -500, 500, -500]", "rotors.spins must be four numbers"),
    "spins as text": ("rotors.spins", "rotors.spins = 'ccw'", "rotors.spins must be four numbers"),
    "weak rotors": ("rotors.thrust", "rotors.thrust = [0, 1.0]", "rotors.thrust must carry the weight"),
    "rotors that never idle": ("rotors.thrust", "rotors.thrust = [2, 4]", "rotors.thrust must allow less than"),
    "thrusts reversed": ("rotors.thrust", "rotors.thrust = [4, 0]", "rotors.thrust must be in the order"),
    "one thrust": ("rotors.thrust", "rotors.thrust = 4.0", "rotors.thrust must be a pair"),
    "negative thrust": ("rotors.thrust", "rotors.thrust = [-1, 4]", "rotors.thrust must be .* not -1"),
    "no torque": ("rotors.torque", "rotors.torque_per_thrust = 0", "rotors.torque_per_thrust must be"),
    "lag in ms": ("rotors.torque", "rotors.torque_per_thrust = 0.02\nrotors.lag_up = 15", "rotors.lag_up must be"),
    "negative lag": ("rotors.torque", "rotors.torque_per_thrust = 0.02\nrotors.lag_down = -1", "rotors.lag_down must"),
    "inertia without speed": (
        "rotors.torque", "rotors.torque_per_thrust = 0.02\nrotors.inertia = 1e-5", "rotors.thrust_coefficient must be"
    ),
    "rotors as a number": ("rotors", "rotors = 4", "vehicle.rotors must be a Rotors or a mapping"),
    "neither rotors nor torque": ("rotors", "", "vehicle.torque must be given"),
    "one torque": ("mass", "mass = 0.5\ntorque = 0.4", "vehicle.torque must be a pair"),
    "negative torque": ("mass", "mass = 0.5\ntorque = [-0.4, 0.1]", "vehicle.torque must be"),
    "flat pivot": ("mass", "mass = 0.5\npivot = [0, 0]", "vehicle.pivot must be a number or 3 numbers"),
    "pivot in millimetres": ("mass", "mass = 0.5\npivot = [0, 0, 50]", "vehicle.pivot must be .* not 50"),
    "pivot beside the rotors": ("pole", "pivot = [0.9, 0, 0]\npole = 'tube-150cm'", "and pivot must allow"),
    "no gravity": ("mass", "mass = 0.5\ngravity = 0", "vehicle.gravity must be"),
    "unknown attitude": ("mass", "mass = 0.5\nattitude = 'quaternion'", "vehicle.attitude must be 'rigid' or 'euler'"),
    "paper's attitude with rotors": ("mass", "mass = 0.5\nattitude = 'euler'", "'euler'.* has no rotors"),
    "unknown drag": ("mass", "mass = 0.5\ndrag.aera = 1", "vehicle.drag has no field 'aera' .did you mean 'area'"),
    "negative drag": ("mass", "mass = 0.5\ndrag.rotor = [-1, 0, 0]", "drag.rotor must be"),
    "no time constant": ("mass", "mass = 0.5\nrate_loop.time_constant = 0", "rate_loop.time_constant must be"),
    "rates in degrees": ("mass", "mass = 0.5\nrate_loop.roll_pitch = 600", "roll_pitch must .* rad/s, not 600"),
    "no name": ("mass", "mass = 0.5\nname = ''", "vehicle.name must be a text, not ''"),
    "broken TOML": ("mass", "mass = ", "is not valid TOML"),
}  # fmt: skip


def changed(field: str, line: str) -> str:
    """Return the good vehicle with the lines that begin with `field` replaced."""
    lines = [item for item in GOOD.splitlines() if not item.startswith(field)]
    return "\n".join([*lines, line]) + "\n"


def test_the_good_vehicle_is_accepted(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(GOOD)
    assert as_vehicle(tmp_path / "mine.toml").mass == 0.5


@pytest.mark.parametrize("case", SENSELESS)
def test_a_senseless_vehicle_is_refused_with_one_sentence_that_names_file_and_field(case: str, tmp_path: Path) -> None:
    field, line, pattern = SENSELESS[case]
    path = tmp_path / "mine.toml"
    path.write_text(changed(field, line))
    assert_refused(lambda: as_vehicle(str(path)), f"mine.toml.*{pattern}", (TypeError, ValueError))


@pytest.mark.parametrize(
    ("value", "pattern"),
    [
        ("humingbird", "there is no vehicle 'humingbird' .did you mean 'hummingbird'.*TOML file"),
        ("missing.toml", "the vehicle file 'missing.toml' cannot be read"),
        (7, "vehicle must be a Vehicle or a mapping of its fields, not 7"),
        (None, "vehicle must be a Vehicle or a mapping of its fields, not None"),
        ({}, "vehicle lacks the field 'name'"),
        (VEHICLES, "vehicle has no field 'crazyflie'"),
    ],
)
def test_what_is_no_vehicle_is_refused(value: Any, pattern: str) -> None:
    assert_refused(lambda: as_vehicle(value), pattern, (TypeError, ValueError))


def test_a_folder_and_a_binary_file_are_no_vehicles(tmp_path: Path) -> None:
    (tmp_path / "folder.toml").mkdir()
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    assert_refused(lambda: as_vehicle(tmp_path / "folder.toml"), "folder.toml' cannot be read", ValueError)
    assert_refused(lambda: as_vehicle(tmp_path / "binary.toml"), "binary.toml is not valid TOML", ValueError)


def test_a_vehicle_without_rotors_has_no_mixing() -> None:
    vehicle = Vehicle("mine", 0.5, (0.003, 0.003, 0.005), VEHICLES["paper"].pole, torque=(0.4, 0.1))
    assert_refused(lambda: mixing(vehicle), "the vehicle 'mine' has no rotors", ValueError)


def test_the_papers_attitude_model_has_no_pole_inertia() -> None:
    paper = {"name": "mine", "mass": 0.5, "inertia": (0.1, 0.1, 0.1), "attitude": "euler", "torque": (5, 1)}
    assert_refused(lambda: as_vehicle({**paper, "pole": "hehn"}), "'euler'.* has no pole.inertia", ValueError)
    assert_refused(
        lambda: as_vehicle({**paper, "pole": "paper", "pivot": (0, 0, 0.1)}), "'euler'.* has no pivot", ValueError
    )
