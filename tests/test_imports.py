"""Who may import whom: the arrows of the architecture, and what a plain import loads."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FILES = sorted([*ROOT.glob("relax/**/*.py"), *ROOT.glob("enumerate/**/*.py")])
NAMES = [str(f.relative_to(ROOT)) for f in FILES]

ONLY_IN = {
    "clarabel": {"relax/solve.py"},
    "osqp": {"relax/solve.py"},
    "cvxpy": {"relax/spec.py"},
    "matplotlib": {"relax/panels.py", "relax/plot.py"},
    "casadi": set(),
    "pandas": set(),
    "benchmarks": set(),
    "tests": set(),
}
"""Third parties, and the only files that may name them."""

JUDGES = {"relax/certify.py", "relax/commands.py", "relax/exact.py", "relax/replay.py"}
"""They neither solve nor write programs."""

WRITERS = {
    "relax.solve",
    "relax.program",
    "relax.relaxation",
    "relax.relaxation_drive",
    "relax.relaxation_stops",
    "relax.relaxation_model",
    "relax.refinement",
    "relax.descent",
    "relax.completion",
    "relax.quadratic",
    "relax.step_layout",
    "relax.expansion",
    "relax.envelopes",
    "relax.envelopes_charge",
    "relax.spec",
    "relax.bound",
    "relax.tighten",
}

SUGGESTS = {
    "relax.refinement",
    "relax.descent",
    "relax.completion",
    "relax.quadratic",
    "relax.expansion",
    "relax.starts",
}
"""Approximations: nothing that proves may rest on them."""

PROVES = {
    "relax/box.py",
    "relax/reach.py",
    "relax/reach_heat.py",
    "relax/intervals.py",
    "relax/envelopes.py",
    "relax/envelopes_charge.py",
    "relax/program.py",
    "relax/relaxation.py",
    "relax/relaxation_drive.py",
    "relax/relaxation_stops.py",
    "relax/relaxation_model.py",
    "relax/certify.py",
    "relax/bound.py",
    "relax/tighten.py",
    "relax/commands.py",
    "relax/exact.py",
    "relax/replay.py",
}

PURE = {"relax/maps.py", "relax/physics.py", "relax/errors.py", "relax/sparse.py"}
"""The foundation knows nothing of the rest but the errors."""


def imported(source: str, typing_too: bool = True) -> Iterator[str]:
    """Yield the full name of everything a file imports, at any depth.

    ``from a import b`` yields both ``a`` and ``a.b``: b may be a module. Without
    ``typing_too``, what stands under ``if TYPE_CHECKING`` is left out.
    """
    tree = ast.parse(source)
    skipped: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            skipped.update(id(n) for part in node.body for n in ast.walk(part))
    for node in ast.walk(tree):
        if not typing_too and id(node) in skipped:
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
            module = node.module or ""
            yield module
            yield from (f"{module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
            if node.args and isinstance(node.args[0], ast.Constant):
                yield str(node.args[0].value)


def top(name: str) -> str:
    return name.split(".", 1)[0]


def names_in(file: str, typing_too: bool = True) -> set[str]:
    return set(imported((ROOT / file).read_text(encoding="utf-8"), typing_too))


def test_the_walk_sees_every_way_to_import() -> None:
    """The tool is tested before it judges."""
    source = """
import clarabel as c
from relax.solve import solve_qp
from relax import program
if TYPE_CHECKING:
    import casadi
def f():
    from cvxpy import Variable
    return import_module("osqp")
"""
    got = set(imported(source))
    assert {"clarabel", "relax.solve", "relax.program", "casadi", "cvxpy", "osqp"} <= got
    assert "casadi" not in set(imported(source, typing_too=False))


def test_the_packages_are_found() -> None:
    assert {"relax/simulate.py", "relax/replay.py", "enumerate/search.py"} <= set(NAMES)
    assert (JUDGES | PURE) <= set(NAMES)


@pytest.mark.parametrize("file", NAMES)
def test_no_file_imports_what_is_not_its_business(file: str) -> None:
    for name in names_in(file):
        allowed = ONLY_IN.get(top(name))
        assert allowed is None or file in allowed, f"{file} imports {name}"
        if file.startswith("relax/"):
            assert top(name) != "enumerate", f"{file} imports {name}"


@pytest.mark.parametrize("file", sorted(JUDGES))
def test_the_judges_know_no_solver_and_no_writer_of_programs(file: str) -> None:
    found = names_in(file, typing_too=False)
    assert not found & WRITERS, found & WRITERS


def _reached(file: str) -> set[str]:
    """Modules of relax that a file pulls in at run time, directly or not."""
    seen: set[str] = set()
    queue = [file]
    while queue:
        for name in names_in(queue.pop(), typing_too=False):
            path = name.replace(".", "/") + ".py"
            if path in NAMES and name not in seen:
                seen.add(name)
                queue.append(path)
    return seen


@pytest.mark.parametrize("file", sorted(JUDGES))
def test_the_judges_reach_no_solver_through_others(file: str) -> None:
    """The container of a program's arrays may be known; who fills or solves it may not."""
    assert not _reached(file) & (WRITERS - {"relax.program"})


@pytest.mark.parametrize("file", sorted(PROVES & set(NAMES)))
def test_no_proof_rests_on_an_approximation(file: str) -> None:
    found = names_in(file, typing_too=False) & SUGGESTS
    assert not found, f"{file} imports {found}"


@pytest.mark.parametrize("file", sorted(PURE))
def test_the_foundation_imports_only_errors(file: str) -> None:
    ours = {n for n in names_in(file) if top(n) in {"relax", "enumerate"}}
    assert {n for n in ours if not n.startswith("relax.errors")} == set()


@pytest.mark.parametrize("file", NAMES)
def test_every_module_states_what_it_owns_and_exports(file: str) -> None:
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    assert ast.get_docstring(tree), f"{file} has no header"
    if not file.endswith(("__init__.py", "__main__.py")):
        names = [ast.unparse(n) for n in tree.body if isinstance(n, ast.Assign)]
        assert any(n.startswith("__all__") for n in names), f"{file} has no __all__"


@pytest.mark.parametrize("statement", ["import relax", "from enumerate import plan"])
def test_a_plain_import_loads_nothing_heavy(statement: str) -> None:
    """cvxpy alone costs half a second; the planner must not pay for what it does not use."""
    code = f"{statement}\nimport sys\nprint(' '.join(sorted(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        capture_output=True,
        text=True,
        cwd=ROOT,
        check=True,
    )
    loaded = {top(name) for name in done.stdout.split()}
    assert "relax" in loaded
    assert not loaded & {"cvxpy", "matplotlib", "pandas", "casadi", "pytest", "IPython"}


def test_planning_loads_nothing_heavy_either() -> None:
    code = (
        "from relax import load_trip\nfrom enumerate import plan\nimport sys\n"
        "plan(load_trip('paper-400km'), time_limit_s=0.2)\n"
        "print(' '.join(sorted(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True
    )
    loaded = {top(name) for name in done.stdout.split()}
    assert "clarabel" in loaded
    assert not loaded & {"cvxpy", "matplotlib", "pandas", "casadi"}


def test_the_maths_page_names_functions_and_tests_that_exist() -> None:
    """Every labelled equation has its function and its test; renaming one breaks this."""
    page = (ROOT / "docs" / "maths.md").read_text(encoding="utf-8")
    cited = re.findall(r"`(test_\w+\.py)::(\w+)`", page)
    assert len(cited) > 30
    for file, name in cited:
        assert f"def {name}(" in (ROOT / "tests" / file).read_text(encoding="utf-8"), name
    rows = re.findall(r"^\| \(([EPTJ]\d*)\) \|(.*)\|$", page, flags=re.M)
    assert [label for label, _ in rows] == [
        "E1", *(f"P{i}" for i in range(1, 8)), *(f"T{i}" for i in range(1, 11)), "J"
    ]  # fmt: skip
    source = "\n".join(f.read_text(encoding="utf-8") for f in FILES)
    for label, row in rows:
        functions = re.findall(r"`([\w.]+)`", row.rsplit("|", 2)[1])
        assert functions, label
        for name in functions:
            assert f"def {name.rsplit('.', 1)[-1]}(" in source, (label, name)
        assert "test_" in row.rsplit("|", 1)[1] or "same" in row.rsplit("|", 1)[1], label
