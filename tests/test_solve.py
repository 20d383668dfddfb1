"""The solvers behind one interface: solved, infeasible, unbounded and badly scaled programs, the
answers checked against the data and not against the status."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp

from relax.program import make_cone_program
from relax.solve import SolveSettings, SolveStatus, solve_cone, solve_qp

SOLVERS = ["clarabel", "osqp"]


def qp(seed: int, n: int = 15, n_eq: int = 4, n_in: int = 20):
    """A program with planted optimum: x, z and the active rows first."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(n, n))
    H = root @ root.T / n + 0.1 * np.eye(n)
    A = rng.normal(size=(n_eq + n_in, n))
    x, z, s = rng.normal(size=n), rng.normal(size=n_eq + n_in), np.zeros(n_eq + n_in)
    active = rng.random(n_in) < 0.4
    z[n_eq:] = np.where(active, np.abs(z[n_eq:]) + 0.1, 0.0)
    s[n_eq:] = np.where(active, 0.0, rng.uniform(0.1, 2.0, n_in))
    q = -H @ x - A.T @ z
    return sp.csc_array(np.triu(H)), q, sp.csc_array(A), A @ x + s, n_eq, x, z


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("seed", range(8))
def test_planted_quadratic_programs_are_returned(seed: int, solver: str) -> None:
    P, q, A, b, n_eq, x, _ = qp(seed)
    found = solve_qp(P, q, A, b, n_eq, solver=solver, tolerance=1e-8)
    assert found.status is SolveStatus.SOLVED
    assert found.x == pytest.approx(x, abs=1e-4)
    H = P.toarray() + np.triu(P.toarray(), 1).T
    assert H @ found.x + q + A.T @ found.z == pytest.approx(np.zeros(x.size), abs=1e-4)
    assert (found.z[n_eq:] >= -1e-6).all()
    assert found.iterations > 0 and found.solve_s > 0.0


@pytest.mark.parametrize("solver", SOLVERS)
def test_infeasible_and_unbounded_are_told_apart(solver: str) -> None:
    flat, rows = sp.csc_array((1, 1)), sp.csc_array(np.array([[1.0], [-1.0]]))
    none = solve_qp(flat, np.array([1.0]), rows, np.array([0.0, -1.0]), 0, solver=solver)
    assert none.status is SolveStatus.INFEASIBLE
    down = solve_qp(flat, np.array([-1.0]), rows[[1]].tocsc(), np.array([0.0]), 0, solver=solver)
    assert down.status is SolveStatus.FAILED


def test_equalities_come_first() -> None:
    P, A = sp.csc_array(np.eye(2)), sp.csc_array(np.array([[1.0, 1.0], [1.0, 0.0]]))
    found = solve_qp(P, np.zeros(2), A, np.array([2.0, 0.5]), n_eq=1)
    assert found.x == pytest.approx([0.5, 1.5], abs=1e-5)  # x + y = 2 and x <= 0.5


def test_an_unknown_solver_is_refused() -> None:
    P, q, A, b, n_eq, _, _ = qp(0)
    with pytest.raises(ValueError, match="allowed: 'clarabel', 'osqp'"):
        solve_qp(P, q, A, b, n_eq, solver="simplex")  # type: ignore[arg-type]


def test_a_cone_is_a_cone() -> None:
    # min -x - y with |(x, y)| <= 1
    program = make_cone_program(
        [-1.0, -1.0], [[0.0, 0.0], [-1.0, 0.0], [0.0, -1.0]], [1.0, 0.0, 0.0],
        soc_sizes=(3,), l=[-2.0, -2.0], u=[2.0, 2.0],
    )  # fmt: skip
    found = solve_cone(program, SolveSettings(tolerance=1e-8))
    assert found.status is SolveStatus.SOLVED
    assert found.x == pytest.approx([0.5**0.5, 0.5**0.5], abs=1e-6)
    assert found.objective == pytest.approx(-(2.0**0.5), abs=1e-6)
    assert program.slack(found.x).min() > -1e-6


def test_too_few_iterations_are_not_solved() -> None:
    program = make_cone_program([1.0], [[-1.0]], [-2.0], n_nonneg=1, l=[0.0], u=[9.0])
    assert solve_cone(program, SolveSettings(max_iterations=1)).status is SolveStatus.FAILED
    quick = solve_cone(program, SolveSettings(time_limit_s=0.0))
    assert quick.status is SolveStatus.FAILED


def test_every_status_is_a_sentence() -> None:
    for status in SolveStatus:
        assert len(status.value.split()) > 5
    assert len({s.value for s in SolveStatus}) == len(SolveStatus)


def test_only_solve_imports_solvers() -> None:
    root = Path(__file__).resolve().parents[1]
    for path in [*root.glob("relax/*.py"), *root.glob("enumerate/*.py")]:
        found = set()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                found.add((node.module or "").split(".")[0])
        if path.name != "solve.py":
            assert not found & {"clarabel", "osqp"}, path.name
        if path.name != "spec.py":
            assert "cvxpy" not in found, path.name
