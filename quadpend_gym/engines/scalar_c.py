"""Functions of CasADi as plain C: one assignment for each operation, for microcontrollers.

The C that CasADi writes (`generated_c`) checks pointers and has arguments that a compiler with all warnings complains
about. This one is a function without branches and memory. It calls q_sqrt, q_sin and so on; its numbers have the type
``real``, to which the macro ``R`` converts constants.
"""

from textwrap import wrap
from typing import Any

import casadi as ca

_OPERATIONS = {
    ca.OP_ASSIGN: "{0}",
    ca.OP_ADD: "{0} + {1}",
    ca.OP_SUB: "{0} - {1}",
    ca.OP_MUL: "{0} * {1}",
    ca.OP_DIV: "{0} / {1}",
    ca.OP_NEG: "-{0}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "{0} + {0}",
    ca.OP_INV: "1 / {0}",
    ca.OP_LT: "{0} < {1}",
    ca.OP_LE: "{0} <= {1}",
    ca.OP_EQ: "{0} == {1}",
    ca.OP_NE: "{0} != {1}",
    ca.OP_NOT: "!{0}",
    ca.OP_AND: "{0} != 0 && {1} != 0",
    ca.OP_OR: "{0} != 0 || {1} != 0",
    ca.OP_IF_ELSE_ZERO: "{0} != 0 ? {1} : 0",
    ca.OP_FMIN: "q_min({0}, {1})",
    ca.OP_FMAX: "q_max({0}, {1})",
    **{
        getattr(ca, f"OP_{name.upper()}"): f"q_{call}({{0}}{', {1}' * (name == 'atan2')})"
        for name, call in (
            *((name, name) for name in ("floor", "sqrt", "sin", "cos", "asin", "atan2", "exp", "expm1", "log", "tanh")),
            ("sign", "sign"),
            ("fabs", "abs"),
        )
    },
}


def scalar_c(function: Any) -> str:
    """Return a static C function without result, with the arguments and then the results of a function as arrays.

    Their names are those of the function, which must differ. It may call one other function (``never_inline``), of one
    argument and with one result; its C comes first.
    """
    names = [function.name_in(i) for i in range(function.n_in())]
    results = [function.name_out(i) for i in range(function.n_out())]
    arguments = [f"const real *{name}" for name in names] + [f"real *{name}" for name in results]
    others = "".join(map(scalar_c, function.find_functions()))
    lines = [f"{others}static void {function.name()}({', '.join(arguments)}) {{"]
    steps = range(function.n_instructions())
    used = {i for k in steps if function.instruction_id(k) != ca.OP_OUTPUT for i in function.instruction_output(k)}
    used.discard(-1)  # a result of a call that is not used
    lines += wrap(f"real {', '.join(f'w{i}' for i in sorted(used))};", 118)
    for k in steps:
        operation, into, out_of = (getattr(function, f"instruction_{what}")(k) for what in ("id", "output", "input"))
        if operation == ca.OP_INPUT:
            lines.append(f"w{into[0]} = {names[out_of[0]]}[{out_of[1]}];")
        elif operation == ca.OP_OUTPUT:
            lines.append(f"{results[into[0]]}[{into[1]}] = w{out_of[0]};")
        elif operation == ca.OP_CALL:
            (called,) = function.find_functions()
            lines.append(
                f"{{ real x[] = {{{', '.join(f'w{i}' for i in out_of)}}}, y[{len(into)}]; {called.name()}(x, y);"
            )
            lines += wrap(" ".join(f"w{i} = y[{j}];" for j, i in enumerate(into) if i in used) + " }", 118)
        elif operation == ca.OP_CONST:
            lines.append(f"w{into[0]} = R({function.instruction_constant(k)!r});")
        else:
            value = _OPERATIONS[operation].format(*(f"w{i}" for i in out_of))
            lines.append(f"w{into[0]} = {value};")
    lines += [f"(void){name};" for name in (*names, *results)]
    return "\n  ".join(lines) + "\n}\n"
