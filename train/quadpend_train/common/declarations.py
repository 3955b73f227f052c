"""What the code says about each field of a dataclass: its docstring, or the comments above it and on its lines."""

import ast
import inspect
import textwrap


def meanings(kind: type) -> dict[str, str]:
    """Return the sentences or comments about the fields of a class and of its bases, by the names of the fields."""
    found: dict[str, str] = {}
    for each in reversed(kind.__mro__):
        if hasattr(each, "__dataclass_fields__"):
            source = textwrap.dedent(inspect.getsource(each))
            (body,) = ast.parse(source).body
            assert isinstance(body, ast.ClassDef)
            for item, after in zip(body.body, [*body.body[1:], ast.Pass()], strict=True):
                if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name):
                    found[item.target.id] = _docstring(after) or _comments(source.splitlines(), item)
    return found


def _docstring(node: ast.AST) -> str:
    value = node.value.value if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) else ""
    return " ".join(str(value).split())


def _comments(lines: list[str], item: ast.AnnAssign) -> str:
    first = item.lineno - 1
    while lines[first - 1].strip().startswith("# "):
        first -= 1
    return " ".join(line.partition("# ")[2] for line in lines[first : item.end_lineno] if "# " in line)
