"""Owns the calls to the solvers: the only file that imports clarabel and osqp.

A program goes in, raw arrays and a status come out. A status is never evidence:
lower bounds and infeasibility come from ``certify``, costs from simulation.
Knows nothing of cars, boxes or bounds.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Any, Literal

import clarabel
import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

if TYPE_CHECKING:
    from relax.program import ConeProgram

__all__ = [
    "ConeSolver",
    "QpSolution",
    "RawSolution",
    "SolveSettings",
    "SolveStatus",
    "solve_cone",
    "solve_objective",
    "solve_qp",
]

Array = npt.NDArray[np.float64]

OSQP_MAX_ITERATIONS = 20000
"""First-order iterations before giving up; trials needed 5,000 to 40,000 or never converged."""


class SolveStatus(Enum):
    """How a solver call ended; the value is the sentence a user sees.

    Examples
    --------
    >>> SolveStatus.SOLVED.value
    'the solver reached the asked tolerance'
    """

    SOLVED = "the solver reached the asked tolerance"
    INACCURATE = "the solver stopped near a solution, short of the asked tolerance"
    INFEASIBLE = "the solver found no feasible point and returned a ray that should prove it"
    FAILED = "the solver stopped without a usable point"


@dataclass(frozen=True)
class SolveSettings:
    """Settings of one conic solve.

    Parameters
    ----------
    tolerance : float
        Relative gap and feasibility tolerance; safe bounds hardly depend on it.
    max_iterations : int
        Interior-point iterations.
    time_limit_s : float
        Wall-clock limit [s].

    Examples
    --------
    >>> SolveSettings().tolerance
    1e-06
    """

    tolerance: float = 1e-6
    max_iterations: int = 100
    time_limit_s: float = float("inf")


@dataclass(frozen=True)
class RawSolution:
    """What a conic solver returned, unjudged.

    Parameters
    ----------
    x : ndarray, shape (n,)
        Primal point (or what the solver had when it stopped).
    z : ndarray, shape (m,)
        Dual point, or the infeasibility ray if ``status`` is INFEASIBLE.
    status : SolveStatus
        How the call ended.
    objective : float
        The solver's primal objective, constant excluded. Not a bound.
    iterations : int
        Interior-point iterations.
    solve_s : float
        Wall-clock time of the call [s].
    """

    x: Array
    z: Array
    status: SolveStatus
    objective: float
    iterations: int
    solve_s: float


@dataclass(frozen=True)
class QpSolution:
    """What a solver returned for a quadratic program, unjudged.

    Parameters
    ----------
    x : ndarray, shape (n,)
        Primal point.
    z : ndarray, shape (m,)
        Multipliers of the rows; those of inequalities are >= 0.
    status : SolveStatus
        How the call ended.
    iterations : int
        Iterations.
    solve_s : float
        Wall-clock time of the call [s].
    """

    x: Array
    z: Array
    status: SolveStatus
    iterations: int
    solve_s: float


_CLARABEL_STATUS = {
    "Solved": SolveStatus.SOLVED,
    "AlmostSolved": SolveStatus.INACCURATE,
    "PrimalInfeasible": SolveStatus.INFEASIBLE,
    "AlmostPrimalInfeasible": SolveStatus.INFEASIBLE,
}
_OSQP_STATUS = {
    "solved": SolveStatus.SOLVED,
    "solved inaccurate": SolveStatus.INACCURATE,
    "primal infeasible": SolveStatus.INFEASIBLE,
    "primal infeasible inaccurate": SolveStatus.INFEASIBLE,
}


def _options(settings: SolveSettings, refine: bool) -> Any:
    """Clarabel's settings for one thread."""
    options = clarabel.DefaultSettings()
    options.verbose = False
    options.max_threads = 1  # concurrency belongs to the caller: one subset, one thread
    options.direct_solve_method = "qdldl"
    options.presolve_enable = False  # rows must keep their places for the certifier
    options.max_iter = settings.max_iterations
    if np.isfinite(settings.time_limit_s):
        options.time_limit = settings.time_limit_s
    options.tol_gap_abs = options.tol_gap_rel = options.tol_feas = settings.tolerance
    options.tol_infeas_abs = options.tol_infeas_rel = settings.tolerance
    options.iterative_refinement_enable = refine
    return options


def _view(values: npt.NDArray[Any]) -> memoryview:
    """Return an array as Clarabel reads it: entry by entry, and then its numbers are quicker."""
    return np.ascontiguousarray(values).data


@dataclass(frozen=True)
class _Columns:
    """A CSC matrix as Clarabel reads it."""

    data: memoryview
    indices: memoryview
    indptr: memoryview
    shape: tuple[int, int]
    has_canonical_format: bool = True

    @classmethod
    def of(cls, A: sp.csc_array) -> _Columns:
        """Return the columns of a matrix."""
        if not A.has_canonical_format:
            A = A.copy()
            A.sum_duplicates()
        return cls(_view(A.data), _view(A.indices), _view(A.indptr), A.shape)

    @classmethod
    def zero(cls, n: int) -> _Columns:
        """Return the zero matrix of shape (n, n)."""
        none = np.zeros(0)
        return cls(_view(none), _view(none), _view(np.zeros(n + 1, dtype=np.int64)), (n, n))


def _clarabel(
    P: _Columns, q: Array, A: _Columns, b: Array, cones: list[Any], settings: SolveSettings
) -> tuple[Any, SolveStatus, float]:
    """Call Clarabel; return its solution, our status and the time."""
    begin = time.perf_counter()
    cost, side = _view(q), _view(b)
    # without iterative refinement a solve takes half the time; nothing rests on the
    # solver's accuracy, and where it is missed the solve is repeated with refinement
    for refine in (False, True):
        solver = clarabel.DefaultSolver(P, cost, A, side, cones, _options(settings, refine))
        solution = solver.solve()
        status = _CLARABEL_STATUS.get(str(solution.status), SolveStatus.FAILED)
        if status in (SolveStatus.SOLVED, SolveStatus.INFEASIBLE):
            break
    return solution, status, time.perf_counter() - begin


def _cones(program: ConeProgram) -> list[Any]:
    cones: list[Any] = []
    if program.n_zero:
        cones.append(clarabel.ZeroConeT(program.n_zero))
    if program.n_nonneg:
        cones.append(clarabel.NonnegativeConeT(program.n_nonneg))
    cones.extend(clarabel.SecondOrderConeT(size) for size in program.soc_sizes)
    return cones


class ConeSolver:
    """Clarabel set up once for the rows of one program; ``solve_objective`` uses it.

    Parameters
    ----------
    program : ConeProgram
        Its rows count; its objective is replaced.
    settings : SolveSettings, optional
        Tolerance and limits.
    """

    def __init__(self, program: ConeProgram, settings: SolveSettings | None = None) -> None:
        self.program, self.settings = program, settings or SolveSettings()
        self.cones = _cones(program)
        self.ready: Any = None


def solve_objective(solver: ConeSolver, q: Array, *, changed: bool = False) -> RawSolution:
    """Minimise q'x over the rows that a solver is set up for.

    The set-up takes a quarter of the time of a solve; it is repeated only where the first
    answer is not accurate.

    Parameters
    ----------
    solver : ConeSolver
        Of the program.
    q : ndarray, shape (n,)
        Objective of the scaled variables.
    changed : bool
        Numbers of the program's A and b have changed in place; its pattern has not.

    Examples
    --------
    >>> from relax.program import make_cone_program
    >>> rows = [[-1.0], [1.0]]  # 2 <= x <= 5
    >>> program = make_cone_program([1.0], rows, [-2.0, 5.0], n_nonneg=2, l=[0.0], u=[9.0])
    >>> solver = ConeSolver(program)
    >>> [round(float(solve_objective(solver, np.array([q])).x[0]), 3) for q in (1.0, -1.0)]
    [2.0, 5.0]
    """
    begin = time.perf_counter()
    program, n = solver.program, q.size
    if solver.ready is None:
        solver.ready = clarabel.DefaultSolver(
            _Columns.zero(n), _view(q), _Columns.of(program.A), _view(program.b), solver.cones,
            _options(solver.settings, False),
        )  # fmt: skip
    elif changed:
        solver.ready.update(q=q, A=program.A.data, b=program.b)
    else:
        solver.ready.update(q=_view(q))
    solution = solver.ready.solve()
    status = _CLARABEL_STATUS.get(str(solution.status), SolveStatus.FAILED)
    if status not in (SolveStatus.SOLVED, SolveStatus.INFEASIBLE):
        A = _Columns.of(program.A)
        solution, status, _ = _clarabel(
            _Columns.zero(n), q, A, program.b, solver.cones, solver.settings
        )
    return _raw(solution, status, time.perf_counter() - begin)


def _raw(solution: Any, status: SolveStatus, seconds: float) -> RawSolution:
    return RawSolution(
        x=np.array(solution.x),
        z=np.array(solution.z),
        status=status,
        objective=float(solution.obj_val),
        iterations=int(solution.iterations),
        solve_s=seconds,
    )


def solve_cone(program: ConeProgram, settings: SolveSettings | None = None) -> RawSolution:
    """Solve min q'x subject to A x + s = b, s in a product of cones, with Clarabel.

    Parameters
    ----------
    program : ConeProgram
        Rows in the order zero cone, nonnegative cone, second-order cones. Its box is
        not imposed: what must hold is in its rows.
    settings : SolveSettings, optional
        Tolerance and limits.

    Returns
    -------
    RawSolution
        Primal and dual arrays, to be judged by ``certify``.

    Examples
    --------
    >>> from relax.program import make_cone_program
    >>> program = make_cone_program([1.0], [[-1.0]], [-2.0], n_nonneg=1, l=[0.0], u=[9.0])
    >>> solution = solve_cone(program)  # min x subject to x >= 2
    >>> solution.status.name, round(float(solution.x[0]), 4)
    ('SOLVED', 2.0)
    """
    zero, A = _Columns.zero(program.q.size), _Columns.of(program.A)
    solution, status, seconds = _clarabel(
        zero, program.q, A, program.b, _cones(program), settings or SolveSettings()
    )
    return _raw(solution, status, seconds)


def solve_qp(
    P: sp.csc_array,
    q: Array,
    A: sp.csc_array,
    b: Array,
    n_eq: int,
    solver: Literal["clarabel", "osqp"] = "clarabel",
    tolerance: float = 1e-6,
) -> QpSolution:
    """Solve min 1/2 x'Px + q'x subject to A x = b in the first rows, A x <= b in the rest.

    Parameters
    ----------
    P : csc_array, shape (n, n)
        Upper triangle of the Hessian, positive semidefinite.
    q : ndarray, shape (n,)
        Linear cost.
    A : csc_array, shape (m, n)
        Rows, equalities first.
    b : ndarray, shape (m,)
        Right-hand side; finite.
    n_eq : int
        Number of equalities.
    solver : str
        ``"clarabel"`` (interior point) or ``"osqp"`` (first order).
    tolerance : float
        Gap and feasibility tolerance.

    Returns
    -------
    QpSolution
        Primal point and multipliers, with the sign of z'(A x - b) in the Lagrangian.

    Raises
    ------
    ValueError
        An unknown solver.

    Examples
    --------
    >>> P, A = sp.csc_array([[2.0]]), sp.csc_array([[-1.0]])
    >>> found = solve_qp(P, np.array([0.0]), A, np.array([-3.0]), n_eq=0)  # min x^2, x >= 3
    >>> round(float(found.x[0]), 4), round(float(found.z[0]), 3)
    (3.0, 6.0)
    """
    if solver == "clarabel":
        cones: list[Any] = []
        if n_eq:
            cones.append(clarabel.ZeroConeT(n_eq))
        if b.size > n_eq:
            cones.append(clarabel.NonnegativeConeT(b.size - n_eq))
        settings = SolveSettings(tolerance=tolerance, max_iterations=200)
        solution, status, seconds = _clarabel(_Columns.of(P), q, _Columns.of(A), b, cones, settings)
        return QpSolution(
            np.array(solution.x), np.array(solution.z), status, int(solution.iterations), seconds
        )
    if solver != "osqp":
        raise ValueError(f"unknown solver {solver!r}; allowed: 'clarabel', 'osqp'")
    import osqp  # only here: half of the import time of this file

    begin = time.perf_counter()
    lower = b.copy()
    lower[n_eq:] = -np.inf
    # osqp 1.1 still checks for the matrix classes of scipy, not its arrays
    model = osqp.OSQP()
    model.setup(
        sp.csc_matrix(P),
        q,
        sp.csc_matrix(A),
        lower,
        b,
        verbose=False,
        eps_abs=tolerance,
        eps_rel=tolerance,
        max_iter=OSQP_MAX_ITERATIONS,
    )
    result = model.solve(raise_error=False)
    status = _OSQP_STATUS.get(str(result.info.status), SolveStatus.FAILED)
    return QpSolution(
        np.asarray(result.x, dtype=np.float64),
        np.asarray(result.y, dtype=np.float64),
        status,
        int(result.info.iter),
        time.perf_counter() - begin,
    )
