"""Owns the certificate of a fixed subset: what is convex, what is proved, how tight it is.

Collects the evidence of other files as one value with a text: curvature of the
maps, structure of the assembled program, the certified bound, tightness at the
optimum, and on request the verdict of cvxpy on the readable twin. Knows nothing
of other subsets, of plans and of their costs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import wrap
from typing import Any

import numpy as np

from relax.box import Box
from relax.certify import (
    Infeasible,
    LowerBound,
    Unproved,
    certify_infeasible,
    certify_lower_bound,
)
from relax.curvature import Verdict, judge_vehicle
from relax.instance import Instance
from relax.intervals import Interval
from relax.program import ConeProgram
from relax.reach import make_box
from relax.relaxation import build_relaxation
from relax.solve import SolveSettings, SolveStatus, solve_cone
from relax.tightness import LossWorth, TermTightness, measure_loss_worth, measure_tightness

__all__ = ["Certificate", "Structure", "Twin", "check_structure", "make_certificate"]

SETTINGS = SolveSettings(tolerance=1e-8)
"""Tight: tightness and worth are read from the solution; the bound needs no such accuracy."""
WIDTH = 80
"""Columns of the text."""
TERM = 30
"""Columns of a term's name."""


@dataclass(frozen=True)
class Structure:
    """What the assembled data of a program are made of.

    Parameters
    ----------
    variables, equalities, inequalities : int
        Columns, rows ``a'x = b`` and rows ``a'x <= b``.
    cones : mapping of int to int
        Number of second-order cones by size, as pairs (size, number).
    flaws : tuple of str
        What keeps the data from being a second-order cone program on a finite box with
        every row accounted for once; empty: it is one, hence convex.

    Examples
    --------
    >>> Structure(3, 1, 2, ((3, 1),), ()).convex
    True
    """

    variables: int
    equalities: int
    inequalities: int
    cones: tuple[tuple[int, int], ...]
    flaws: tuple[str, ...]

    @property
    def convex(self) -> bool:
        """Whether the program is convex by its structure: linear cost, linear rows, cones."""
        return not self.flaws


@dataclass(frozen=True)
class Twin:
    """Verdict of cvxpy's rules on the same relaxation written in cvxpy.

    Parameters
    ----------
    dcp, dpp : bool
        Disciplined convex, and disciplined parametrised in the prices.
    constraints : int
        Constraints of the problem.
    """

    dcp: bool
    dpp: bool
    constraints: int


def _named_twice_or_never(program: ConeProgram) -> list[str]:
    """Rows must carry one name each, and a name must stay in one block."""
    count = np.zeros(program.b.size, dtype=np.int64)
    borders = np.array([program.n_zero, program.n_zero + program.n_nonneg])
    flaws = []
    for name, rows in program.rows.items():
        np.add.at(count, rows, 1)
        if np.unique(np.searchsorted(borders, rows, side="right")).size > 1:
            flaws.append(f"the rows {name!r} are in several blocks")
    if np.any(count != 1):
        rows_without = int((count != 1).sum())
        has = "row has" if rows_without == 1 else "rows have"
        flaws.append(f"{rows_without} {has} no name or several")
    return flaws


def check_structure(program: ConeProgram) -> Structure:
    """Return what a program is made of, and what keeps it from being convex by structure.

    Parameters
    ----------
    program : ConeProgram
        Any program.

    Returns
    -------
    Structure
        Without flaws: linear cost, ``b - A x`` in {0} x R+ x second-order cones with
        constant finite data, every row in exactly one block under one name, and a
        finite box.

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> from relax.reach import make_box
    >>> from relax.relaxation import build_relaxation
    >>> instance = make_instance(load_trip("paper-400km"), (1,))
    >>> check_structure(build_relaxation(instance, make_box(instance))).convex
    True
    """
    m, n = program.A.shape
    sizes = np.array(program.soc_sizes, dtype=np.int64)
    flaws = []
    if min(program.n_zero, program.n_nonneg, m - 1) < 0 or program.b.shape != (m,):
        flaws.append("a block has no valid size")
    if program.n_zero + program.n_nonneg + int(sizes.sum()) != m:
        flaws.append("the blocks do not cover every row once")
    if np.any(sizes < 2):
        flaws.append("a cone is no second-order cone: it has fewer than 2 rows")
    if not all(np.isfinite(part).all() for part in (program.A.data, program.b, program.q)):
        flaws.append("a coefficient is not finite")
    if not all(part.shape == (n,) for part in (program.q, program.l, program.u)):
        flaws.append("cost or box do not have one entry per variable")
    elif not (np.isfinite(program.l) & np.isfinite(program.u)).all():
        flaws.append("a variable has no finite box")
    elif np.any(program.l > program.u):
        flaws.append("the box of a variable is empty")
    if not flaws:
        flaws = _named_twice_or_never(program)
    kinds, number = np.unique(sizes, return_counts=True)
    return Structure(
        variables=n,
        equalities=program.n_zero,
        inequalities=program.n_nonneg,
        cones=tuple((int(k), int(c)) for k, c in zip(kinds, number, strict=True)),
        flaws=tuple(flaws),
    )


@dataclass(frozen=True)
class Certificate:
    """Evidence about one fixed subset of chargers on one box.

    Parameters
    ----------
    vehicle : str
        Its name.
    subset : tuple of int
        Chargers used, by index.
    stops : tuple of str
        The same by name, or by place where names are not known.
    curvature : tuple of Verdict
        Shape of every map of the vehicle: what is convex as it is, and what is relaxed.
    structure : Structure or None
        Of the assembled program; None if the box is empty and there is none.
    bound : LowerBound, Infeasible or Unproved
        What is proved of every plan of the subset within the box.
    method : str
        How it was proved.
    objective : float
        The solver's own optimum, which proves nothing: to compare [currency].
    violation : float
        Largest violation of a scaled row or cone at the solver's point.
    tightness : tuple of TermTightness
        Relaxed against exact at the solver's point, term by term; empty without a point.
    worth : LossWorth or None
        What electricity and heat are worth where a loss arises; None without a point.
    twin : Twin or None
        Verdict on the cvxpy twin; None: not asked for.
    """

    vehicle: str
    subset: tuple[int, ...]
    stops: tuple[str, ...]
    curvature: tuple[Verdict, ...]
    structure: Structure | None
    bound: LowerBound | Infeasible | Unproved
    method: str
    objective: float
    violation: float
    tightness: tuple[TermTightness, ...]
    worth: LossWorth | None
    twin: Twin | None = None

    def __str__(self) -> str:
        parts = [
            ["Curvature of the maps", *(str(v) for v in self.curvature)],
            ["Program", *self._structure_text()],
            ["Bound", *self._bound_text()],
            ["Tightness at the relaxed optimum: relaxed minus exact", *self._tightness_text()],
            ["Twin in cvxpy", *self._twin_text()],
        ]
        used = ", ".join(self.stops) or "none"
        lines = wrap(f"Certificate: {self.vehicle}; stops: {used}", WIDTH, subsequent_indent="    ")
        for title, *rest in parts:
            lines.append(title)
            for line in rest:
                lines += (
                    wrap(line, WIDTH, initial_indent="  ", subsequent_indent="    ")
                    if len(line) > WIDTH - 2
                    else ["  " + line]
                )  # a table's line keeps its blanks
        return "\n".join(line.rstrip() for line in lines)

    def _structure_text(self) -> list[str]:
        s = self.structure
        if s is None:
            return ["none: the box is empty"]
        cones = ", ".join(f"{number} of size {size}" for size, number in s.cones) or "none"
        return [
            f"{s.variables} variables on a finite box, linear cost",
            f"{s.equalities} linear equalities, {s.inequalities} linear inequalities",
            f"second-order cones: {cones}",
            *(f"FLAW: {flaw}" for flaw in s.flaws),
            *(["convex by structure: nothing else occurs"] if s.convex else []),
        ]

    def _bound_text(self) -> list[str]:
        if isinstance(self.bound, LowerBound):
            first = f"proved: no plan on this box costs less than {self.bound.value:.4f}"
        elif isinstance(self.bound, Infeasible):
            first = "proved: no plan on this box is feasible"
        else:
            first = f"nothing proved: {self.bound.reason}"
        out = [first, f"by {self.method}"]
        if np.isfinite(self.objective):
            out.append(
                f"the solver's own value, no proof: {self.objective:.4f}; "
                f"largest violation of a scaled row {self.violation:.1e}"
            )
        return out

    def _tightness_text(self) -> list[str]:
        if not self.tightness:
            return ["none: the solver left no point"]
        lines = [
            f"{'':<{TERM}}{'largest':>8}{'largest':>9}{'at':>7}{'above':>8}{'below':>8}{'net':>8}",
            f"{'term':<{TERM}}{'kW':>8}{'kWh':>9}{'km':>7}{'kWh':>8}{'kWh':>8}{'kWh':>8}",
        ]
        for t in self.tightness:
            at = f"{t.where_km:7.1f}" if t.largest_kwh > 1e-9 else f"{'-':>7}"
            lines.append(
                f"{f'{t.label} {t.term}':<{TERM}}{t.largest_kw:8.3f}{t.largest_kwh:9.4f}{at}"
                f"{t.above_kwh:8.3f}{t.below_kwh:8.3f}{t.net_kwh:8.3f}"
            )
        w = self.worth
        if w is not None:
            pairs = [
                (name, (heat > electricity), electricity.size)
                for name, electricity, heat in (
                    ("driving steps", w.drive_electricity, w.drive_heat),
                    ("charging cells", w.stop_electricity, w.stop_heat),
                )
            ]
            counts = " and ".join(f"{int(on.sum())} of {size} {name}" for name, on, size in pairs)
            lines.append(
                f"heat is worth more than electricity in {counts}: "
                "there a loss relaxed from below alone would not be tight"
            )
        return lines

    def _twin_text(self) -> list[str]:
        if self.twin is None:
            return ["not asked for"]
        yes = {True: "yes", False: "NO"}
        return [
            f"{self.twin.constraints} constraints",
            f"disciplined convex (DCP): {yes[self.twin.dcp]}",
            f"disciplined parametrised (DPP): {yes[self.twin.dpp]}",
        ]


def _judge_twin(instance: Instance, box: Box) -> Twin:
    from relax.spec import make_spec  # cvxpy takes half a second to import

    problem: Any = make_spec(instance, box).problem  # its type stub lacks ``dpp``
    return Twin(
        dcp=bool(problem.is_dcp()),
        dpp=bool(problem.is_dcp(dpp=True)),
        constraints=len(problem.constraints),
    )


def make_certificate(
    instance: Instance,
    box: Box | None = None,
    *,
    names: Sequence[str] | None = None,
    with_twin: bool = False,
    settings: SolveSettings | None = None,
) -> Certificate:
    """Relax a fixed subset and return the evidence.

    Parameters
    ----------
    instance : Instance
        Subset and grid.
    box : Box, optional
        A valid box, for example a tightened one; ``make_box`` by default. The bound
        then holds for plans within it.
    names : sequence of str, optional
        Of all chargers of the trip; without them, stops are told by their place.
    with_twin : bool
        Also write the relaxation in cvxpy and ask for its verdict (takes seconds).
    settings : SolveSettings, optional
        Of the solver; the bound is safe whatever they are.

    Returns
    -------
    Certificate
        Prints as text of at most 80 columns.

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> trip = load_trip("paper-400km")
    >>> names = [charger.name for charger in trip.chargers]
    >>> certificate = make_certificate(make_instance(trip, (0, 2)), names=names)
    >>> certificate.structure.convex, certificate.bound.value > 0.0
    (True, True)
    >>> str(certificate).splitlines()[0]
    'Certificate: paper-2022; stops: km 100, km 300'
    """
    box = make_box(instance) if box is None else box
    curvature = judge_vehicle(instance.vehicle)
    name, node_km = instance.vehicle.name, instance.drive.node_km
    stops = tuple(
        f"charger at {node_km[s.node]:.0f} km" if names is None else names[s.charger]
        for s in instance.stops
    )
    if box.empty:
        interval: Interval = getattr(box, box.empty)
        margin = float((interval.lo - interval.hi).max())
        method = f"interval reachability: nothing is left for {box.empty.replace('_', ' ')}"
        return Certificate(
            name, instance.subset, stops, curvature, None, Infeasible(margin), method,
            np.nan, np.nan, (), None,
        )  # fmt: skip
    program = build_relaxation(instance, box)
    solution = solve_cone(program, settings or SETTINGS)
    bound: LowerBound | Infeasible | Unproved = certify_lower_bound(program, solution.z)
    method = "(C1) from the solver's dual vector, rounding errors subtracted"
    if solution.status is SolveStatus.INFEASIBLE:
        ray = certify_infeasible(program, solution.z)
        if isinstance(ray, Infeasible):
            bound = ray
            method = "(C2) from the solver's ray, which separates by more than rounding"
    usable = solution.status in (SolveStatus.SOLVED, SolveStatus.INACCURATE)
    usable = usable and bool(np.isfinite(solution.x).all())
    return Certificate(
        vehicle=name,
        subset=instance.subset,
        stops=stops,
        curvature=curvature,
        structure=check_structure(program),
        bound=bound,
        method=f"{method}; {solution.status.value}",
        objective=solution.objective + program.constant if usable else np.nan,
        violation=max(0.0, -float(program.slack(solution.x).min())) if usable else np.nan,
        tightness=measure_tightness(instance, program, solution.x) if usable else (),
        worth=measure_loss_worth(instance, program, solution.z) if usable else None,
        twin=_judge_twin(instance, box) if with_twin else None,
    )
