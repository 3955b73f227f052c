"""Hash of source code that ignores comments, docstrings, messages of exceptions and layout.

The names of cached results contain this hash. A change of a comment, of a docstring or of the message in a ``raise``
statement does not change it; a change of a number, a name, another string or an expression does.
"""

import ast
import hashlib
from collections.abc import Iterable
from pathlib import Path


def source_hash(paths: Iterable[Path]) -> str:
    """Return the hash of the syntax trees of Python files, of the bytes of others, and of the paths in their packages.

    The hash does not depend on the order of `paths`, on where the packages are installed, or on the Python version, as
    long as the version does not parse the same source differently.

    Args:
        paths: Python files, other files, whose bytes count, and folders, whose Python files are all included.

    Returns:
        SHA-256 in hexadecimal digits.

    Raises:
        FileNotFoundError: If a path does not exist.
        SyntaxError: If a file is not valid Python.
    """
    files = {file.resolve() for path in paths for file in (sorted(path.rglob("*.py")) if path.is_dir() else [path])}
    digest = hashlib.sha256()
    for name, file in sorted((_name(file), file) for file in files):
        content = file.read_bytes()
        digest.update(f"{name}\0{_dump(ast.parse(content)) if file.suffix == '.py' else content!r}\0".encode())
    return digest.hexdigest()


def _name(file: Path) -> str:
    """Return the path relative to the folder that holds the outermost package of `file`, with forward slashes."""
    root = file.parent
    while (root / "__init__.py").exists():
        root = root.parent
    return file.relative_to(root).as_posix()


def _dump(node: object) -> str:
    """Return a text for a syntax tree: as `ast.dump`, but without docstrings, messages, absent fields and empty lists.

    Python versions differ in which absent fields `ast.dump` writes.
    """
    if isinstance(node, list):
        return f"[{', '.join(_dump(item) for item in node if not _is_docstring(item))}]"
    if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
        return f"Raise({_dump(node.exc.func)})"
    if isinstance(node, ast.AST):
        present = [(name, value) for name, value in ast.iter_fields(node) if value is not None and value != []]
        return f"{type(node).__name__}({', '.join(f'{name}={_dump(value)}' for name, value in present)})"
    return repr(node)


def _is_docstring(node: object) -> bool:
    """Whether `node` is a statement that consists of a string only."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
