"""Owns the fingerprint of code: which files a module rests on, and whether they have changed.

Comments, docstrings and formatting do not count, so polishing a text does not make
measurements out of date. Knows nothing of solvers.
"""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

__all__ = ["code_digest", "reached"]

ROOT = Path(__file__).parent.parent


def _file(module: str) -> Path | None:
    path = ROOT / module.replace(".", "/")
    for file in (path.with_suffix(".py"), path / "__init__.py"):
        if file.is_file():
            return file
    return None


def _imports(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


@cache
def _tree(file: Path) -> ast.Module:
    return ast.parse(file.read_text(encoding="utf-8"))


def reached(root: str, packages: tuple[str, ...]) -> list[Path]:
    """Return the files of the packages that a module imports, directly or not, and its own.

    Examples
    --------
    >>> files = reached("enumerate.search", ("relax", "enumerate"))
    >>> {"search.py", "solve.py"} <= {file.name for file in files}
    True
    """
    seen: set[Path] = set()
    queue = [root]
    while queue:
        module = queue.pop()
        file = _file(module)
        inside = any(module == p or module.startswith(p + ".") for p in packages)
        if file is None or not inside or file in seen:
            continue
        seen.add(file)
        queue.extend(_imports(_tree(file)))
    return sorted(seen)


def _is_text(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


class _WithoutText(ast.NodeTransformer):
    """Removes statements that are only a string: docstrings, and texts below constants."""

    def visit_Expr(self, node: ast.Expr) -> ast.Expr | None:
        return None if _is_text(node) else node


@cache
def code_digest(root: str, packages: tuple[str, ...]) -> str:
    """Return ten hexadecimal digits that change with the code a module rests on.

    Parameters
    ----------
    root : str
        Module.
    packages : tuple of str
        What of its imports counts.

    Examples
    --------
    >>> len(code_digest("relax.simulate", ("relax",)))
    10
    """
    hasher = hashlib.sha256()
    for file in reached(root, packages):
        bare = _WithoutText().visit(ast.parse(file.read_text(encoding="utf-8")))
        hasher.update(f"{file.relative_to(ROOT).as_posix()} {ast.dump(bare)}".encode())
    return hasher.hexdigest()[:10]
