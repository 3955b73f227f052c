"""Equations of motion, the delay of the loop, its linearisation and the inputs of a hybrid are defined once each.

A definition in another place fails here. Exceptions are listed with their reason; the list may only become shorter.
"""

import ast
import re
from collections.abc import Callable

from tests.helpers.sources import ROOT

FILES = [
    path
    for part in ("quadpend_gym", "baselines", "train/quadpend_train")
    for path in sorted((ROOT / part).rglob("*.py"))
]
NODES = {str(path.relative_to(ROOT)): [*ast.walk(ast.parse(path.read_text(encoding="utf-8")))] for path in FILES}

DELAYS = {
    "quadpend_gym/envs/loops.py": "when an action acts: the schedule of every row",
    "quadpend_gym/physics/plant_kernel.py": "the action that acts in a substep of the schedule",
    "quadpend_gym/core/delays.py": "values of rows some steps later, for models of sensors and actuators",
    "quadpend_gym/sensors.py": "model: whole steps of a measurement",
    "quadpend_gym/actuators.py": "model: whole steps of an action",
    # Read from these:
    "quadpend_gym/engines/functions.py": "the number of actions under way in the schedule",
    "quadpend_gym/device/control_step.py": "`delay` in CasADi, for C and CUDA",
    "train/quadpend_train/training/flight.py": "the last states under the known delay of the sensors",
    "train/quadpend_train/cli/flight_logs.py": "the delay between motors and motion of a log",
    "train/quadpend_train/flight_logs/replay.py": "the delay between motors and motion of a log",
    # Exceptions:
    "baselines/quadpend_baselines/estimation/loop.py": "actions under way and actuators, as the observer follows them",
    "baselines/quadpend_baselines/hybrid/scheduled_gain.py": "actions under way in the memory of a network",
    "train/quadpend_train/cli/flying.py": "when a sample leaves the desk, by the clock on the wall",
    "train/quadpend_train/links/desk.py": "when a sample leaves the desk, by the clock on the wall",
    "quadpend_gym/wrappers.py": "a history of observations, no delay",
    "baselines/quadpend_baselines/modelling/linear_loop.py": "a shift register, as a linear system needs it",
}
JACOBIANS = {
    "baselines/quadpend_baselines/modelling/linear_model.py": "central differences of a function of rows",
    # Exceptions:
    "baselines/quadpend_baselines/modelling/linear_loop.py": "of a policy with memory, over several steps",
    "quadpend_gym/device/control_step.py": "CasADi's gradient of one substep, as C and CUDA",
    "train/quadpend_train/flight_logs/identify.py": "of a fit with respect to the quantities of a vehicle",
}
# Comparisons of the settings of a rigid vehicle with None: the paper's vehicle has none, and numba compiles laws and
# observers for one attitude model.
PLANTS = {
    "baselines/quadpend_baselines/modelling/equivalent.py",
    "baselines/quadpend_baselines/estimation/chains.py",
    "baselines/quadpend_baselines/estimation/deso.py",
    "baselines/quadpend_baselines/estimation/kalman.py",
    "baselines/quadpend_baselines/estimation/prediction.py",
    "baselines/quadpend_baselines/controllers/adrc.py",
    "baselines/quadpend_baselines/controllers/dual_mode.py",
    "baselines/quadpend_baselines/controllers/flatness.py",
    "baselines/quadpend_baselines/controllers/lqg.py",
    "baselines/quadpend_baselines/controllers/lqr.py",
    "train/quadpend_train/common/lifted.py",
}


EQUATIONS = {
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


def files(is_one: Callable[[ast.AST], bool]) -> set[str]:
    """Return the files that contain a node."""
    return {name for name, nodes in NODES.items() if any(map(is_one, nodes))}


def called(node: ast.AST) -> str:
    """Return the name of a function that is called; empty for other nodes."""
    return str(getattr(node.func, "attr", getattr(node.func, "id", ""))) if isinstance(node, ast.Call) else ""


def delays(node: ast.AST) -> bool:
    """Whether a node is a delay by its name, has a delay as an argument, or moves the elements of an array."""
    if isinstance(node, ast.FunctionDef) and "delay" in {item.arg for item in node.args.args}:
        return True
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        return bool(re.search("^_?delay(ed)?$|Delay$|^Schedule$|queue|register|under_way|acting", node.name))
    if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Subscript):
        moved = isinstance(node.value, ast.Subscript) and node.value.value
        return bool(moved) and ast.unparse(moved) == ast.unparse(node.targets[0].value)
    return False


def linearises(node: ast.AST) -> bool:
    """Whether a node is an own Jacobian, one of a library, or a difference quotient."""
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Div):
        is_difference = any(isinstance(item, ast.Sub) for item in ast.walk(node.left))
        return is_difference and re.search("_step|step_size|epsilon", ast.unparse(node.right), re.I) is not None
    if isinstance(node, ast.FunctionDef):
        return re.search("jacobian|linearis", node.name) is not None and not calls_jacobian(node)
    is_library = isinstance(node, ast.Call) and ast.unparse(node.func).startswith(("ca.", "casadi.", "np.", "torch."))
    return is_library and called(node) in ("jacobian", "jtimes", "hessian", "gradient", "grad")


def calls_jacobian(node: ast.AST) -> bool:
    return any(called(item) == "jacobian" for item in ast.walk(node))


def compares_a_plant(node: ast.AST) -> bool:
    is_comparison = isinstance(node, ast.Compare) and isinstance(node.ops[0], ast.Is | ast.IsNot)
    return is_comparison and re.search(r"(^|[_.])(plant|rigid)$", ast.unparse(node.left)) is not None


CLASSES = [node for nodes in NODES.values() for node in nodes if isinstance(node, ast.ClassDef)]
LAWS = {"Law", "Controller", "Hybrid", "NoController"}
for _ in range(3):  # generations of subclasses
    LAWS |= {node.name for node in CLASSES if LAWS & {ast.unparse(base) for base in node.bases}}


def asks_for_a_law(node: ast.AST) -> bool:
    if not isinstance(node, ast.Call) or called(node) != "isinstance":
        return False
    return bool(LAWS & {item.id for item in ast.walk(node.args[1]) if isinstance(item, ast.Name)})


def test_every_equation_of_motion_is_defined_once() -> None:
    """Numba compiles them, and `quadpend_gym.engines` reads the same functions."""
    expected = {name: {path} for path, names in EQUATIONS.items() for name in names}
    found: dict[str, set[str]] = {name: set() for name in expected}
    for file, nodes in NODES.items():
        for node in nodes:
            if isinstance(node, ast.FunctionDef) and node.name in expected:
                found[node.name].add(file)
    found["derivative"].remove("baselines/quadpend_baselines/modelling/taylor.py")  # of a Taylor series
    assert found == expected


def test_the_delay_of_the_loop_is_defined_once() -> None:
    assert files(delays) == set(DELAYS)


def test_the_jacobian_is_defined_once() -> None:
    assert files(linearises) == set(JACOBIANS)


def test_the_inputs_of_a_hybrid_are_defined_once() -> None:
    """As parts, which numba and CasADi read; what a step knows is filled in for both."""
    hybrid = {name for name in NODES if name.startswith("baselines/quadpend_baselines/hybrid/")}
    assert files(lambda node: called(node) == "InputPart") <= hybrid
    assert files(lambda node: called(node) == "Seen") == {
        "baselines/quadpend_baselines/hybrid/hybrids.py",
        "train/quadpend_train/common/lifted.py",
    }


def test_no_plant_is_compared_with_none() -> None:
    assert files(compares_a_plant) == PLANTS


def test_no_base_asks_which_law_it_flies() -> None:
    assert not files(asks_for_a_law)
