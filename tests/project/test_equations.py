"""The equations of motion exist once: numba compiles them, and `quadpend_gym.engines` reads the same functions."""

import ast
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[2]
DEFINITIONS = {
    "quadpend_gym/physics/dynamics.py": (
        "thrust_axis",
        "euler_acceleration",
        "unconstrained_acceleration",
        "direction_acceleration",
        "centre_acceleration",
    ),
    "quadpend_gym/physics/rigid_body.py": ("free_body_rate", "pivot_force", "derivative"),
    "quadpend_gym/physics/attitude.py": ("rotation_matrix", "quaternion_rate", "euler_rate", "body_rate"),
    "quadpend_gym/physics/rotors.py": ("allocate", "rate_loop", "thrusts_after", "propeller_momentum"),
    "quadpend_gym/physics/drag.py": ("drag_force",),
}


def sources() -> dict[str, ast.Module]:
    files = (file for folder in ("quadpend_gym", "baselines", "train") for file in (ROOT / folder).rglob("*.py"))
    return {file.relative_to(ROOT).as_posix(): ast.parse(file.read_text(encoding="utf-8")) for file in files}


def test_every_equation_of_motion_has_one_definition() -> None:
    found = defaultdict(list)
    for path, tree in sources().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef):
                found[node.name].append(path)
    expected = {name: [path] for path, names in DEFINITIONS.items() for name in names}
    # The derivative of a Taylor series has the name of that of a motion.
    found["derivative"].remove("baselines/quadpend_baselines/modelling/taylor.py")
    assert {name: found[name] for name in expected} == expected
