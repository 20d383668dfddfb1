"""Owns the bound of a subset or family: box, relaxation, solve, certificate, in one call.

The value an enumerator works with: what is proved about a subset, and where to
start a refinement. Knows nothing of rows, cones and of other subsets.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relax.box import Box
from relax.certify import Infeasible, LowerBound, certify_infeasible, certify_lower_bound
from relax.instance import Instance
from relax.proof import Step
from relax.reach import make_box
from relax.relaxation import build_relaxation
from relax.relaxed_point import Optimum, RelaxedPoint, unpack_point
from relax.solve import SolveSettings, SolveStatus, solve_cone

ROOT_SETTINGS = SolveSettings(tolerance=1e-4)
"""The bound is safe at any tolerance, and the point only starts a refinement."""

__all__ = ["RelaxedSubset", "relax_subset"]


@dataclass(frozen=True)
class RelaxedSubset:
    """What one relaxation says about a subset or family.

    Parameters
    ----------
    status : SolveStatus
        How the solver ended (INFEASIBLE also when the box alone proved it).
    lower_bound : float or None
        Certified lower bound of every feasible plan's cost [currency]; None if
        nothing is proved, or if infeasible.
    point : RelaxedPoint or None
        Where the solver stopped, if it is usable as a start.
    infeasible : bool
        Proved that no control is feasible.
    steps : tuple of Step
        The proof: at most one dual vector.
    solve_s : float
        Time inside the solver; 0 if the box alone was enough [s].
    optimum : Optimum or None
        The solver's answer where it is usable, for ``tighten``.
    """

    status: SolveStatus
    lower_bound: float | None
    point: RelaxedPoint | None
    infeasible: bool
    steps: tuple[Step, ...]
    solve_s: float
    optimum: Optimum | None = None


def relax_subset(
    instance: Instance, box: Box | None = None, settings: SolveSettings | None = None
) -> RelaxedSubset:
    """Return a certified bound of a subset, or the proof that it is infeasible.

    Parameters
    ----------
    instance : Instance
        Subset and grid.
    box : Box, optional
        A valid box; ``make_box`` by default.
    settings : SolveSettings, optional
        Of the solver.

    Returns
    -------
    RelaxedSubset
        The bound holds whatever the solver did.

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> trip = load_trip("paper-400km")
    >>> relax_subset(make_instance(trip, ())).infeasible
    True
    >>> relax_subset(make_instance(trip, (1,))).lower_bound > 0.0
    True
    """
    box = make_box(instance) if box is None else box
    if box.empty:
        return RelaxedSubset(SolveStatus.INFEASIBLE, None, None, True, (), 0.0)
    program = build_relaxation(instance, box, lean=True)
    solution = solve_cone(program, settings or ROOT_SETTINGS)
    bound = certify_lower_bound(program, solution.z)
    infeasible = solution.status is SolveStatus.INFEASIBLE and isinstance(
        certify_infeasible(program, solution.z), Infeasible
    )
    usable = solution.status in (SolveStatus.SOLVED, SolveStatus.INACCURATE)
    usable = usable and bool(np.isfinite(solution.x).all())
    return RelaxedSubset(
        status=solution.status,
        lower_bound=bound.value if isinstance(bound, LowerBound) and not infeasible else None,
        point=unpack_point(program, solution.x) if usable else None,
        infeasible=infeasible,
        steps=(Step("relax", solution.z, solution.status is SolveStatus.INFEASIBLE),),
        solve_s=solution.solve_s,
        optimum=Optimum(box, program, solution.x, solution.z) if usable else None,
    )
