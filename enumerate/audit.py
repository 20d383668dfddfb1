"""Owns the audit: whether a file of proofs holds for a trip, without any solver.

Four questions: do the rows account for every subset once, does every proof hold (over
trees and over stages), does each row and the printed bound follow from the proofs, and
does the plan cost what is said. Imports neither solver nor search; what it takes on
trust is in ``docs/audit.md``.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from math import inf
from pathlib import Path

import numpy as np

from enumerate.audit_stages import StageRecheck, recheck_stages
from enumerate.audit_tree import Family, Recheck, exceeds
from enumerate.evidence import DrivenPlan, Evidence
from enumerate.evidence_file import fingerprint, load_proofs
from enumerate.gap import DEFAULT_GAP, closing_cost, is_proved, relative_gap
from enumerate.ledger import Ledger, Outcome, Row
from enumerate.subset import all_subsets
from enumerate.table import counted, number, paragraph, percent
from relax.errors import InputError
from relax.instance import Instance, make_drive, make_instance
from relax.replay import replay
from relax.simulate import FEASIBLE, simulate
from relax.trip import Trip

__all__ = ["Audit", "audit", "audit_evidence"]

COST_TOLERANCE = 1e-6
"""Relative difference of a cost replayed twice that is rounding of the integrator."""
SETTING_TOLERANCE = 1e-9
"""Excess of a control over its limit that is rounding [kW]."""
COUNTED = 10
"""Up to this many chargers every subset is looked up in the rows one by one, beside the
check by counting that is made in any case."""
SHOWN = 12
"""Failures printed; the others are counted."""


@dataclass(frozen=True)
class Audit:
    """What an audit found.

    Parameters
    ----------
    trip : str
        Name of the trip.
    currency : str
        Of all costs.
    failures : tuple of str
        Claims that do not hold, each by name; empty: all of them do.
    subsets, rows : int
        Subsets of chargers, and rows that account for them.
    nodes, programs : int
        Boxes rebuilt, and programs certified again.
    cost : float
        The plan's cost when driven again, ``inf`` without a plan [currency].
    lower_bound : float
        What no plan undercuts, by the proofs alone [currency].
    seconds : float
        Time taken [s].
    stage_steps : int
        Steps over stages done again.
    status : str
        What the file says is known, with the gap asked for.
    grid : str
        The grid that all bounds are of.

    Examples
    --------
    >>> found = Audit("t", "EUR", (), 8, 8, 12, 30, 200.0, 199.0, 1.0)
    >>> found.holds, found.gap
    (True, 0.005)
    """

    trip: str
    currency: str
    failures: tuple[str, ...]
    subsets: int
    rows: int
    nodes: int
    programs: int
    cost: float
    lower_bound: float
    seconds: float
    stage_steps: int = 0
    status: str = ""
    grid: str = ""

    @property
    def holds(self) -> bool:
        """Whether every claim was confirmed."""
        return not self.failures

    @property
    def gap(self) -> float:
        """Relative gap between the cost driven and the bound proved."""
        return relative_gap(self.cost, self.lower_bound)

    def __str__(self) -> str:
        failed = len(self.failures)
        verdict = "every claim holds"
        if failed:
            verdict = f"{counted(failed, 'claim')} {'fails' if failed == 1 else 'fail'}"
        stages = f"{counted(self.stage_steps, 'step')} over stages, " if self.stage_steps else ""
        lines = [
            paragraph("audit", f"{self.trip}: {verdict}."),
            paragraph("status", f"{self.status}."),
            paragraph(
                "checked",
                f"{counted(self.subsets, 'choice')} of stops in {counted(self.rows, 'row')}, "
                f"{counted(self.nodes, 'box', 'boxes')} rebuilt, "
                f"{stages}{counted(self.programs, 'program')} certified, "
                f"in {number(self.seconds, 2)} s; no solver.",
            ),
        ]
        if self.lower_bound < inf:
            text = f"{number(self.lower_bound, 4)} {self.currency}, proved of every plan"
        else:
            text = "there is no plan: proved of every choice of stops"
        text += f", on the file's grid of {self.grid}"
        lines.append(paragraph("bound", text + "."))
        if self.cost < inf:
            text = f"{number(self.cost, 4)} {self.currency}, driven again and within every limit"
            lines.append(paragraph("cost", text + "."))
            lines.append(paragraph("gap", f"{percent(self.gap, 4)} %."))
        lines += [paragraph("FAILS", text) for text in self.failures[:SHOWN]]
        if len(self.failures) > SHOWN:
            lines.append(paragraph("FAILS", f"and {len(self.failures) - SHOWN} more."))
        return "\n".join(lines)


def audit(
    path: str | Path, trip: Trip, progress: Callable[[int, int], None] | None = None
) -> Audit:
    """Check a file of proofs against a trip, without any solver.

    Parameters
    ----------
    path : str or Path
        Written by ``save_proofs``.
    trip : Trip
        The trip it should be of.
    progress : callable, optional
        Called with the number of boxes and steps over stages done, and of all.

    Returns
    -------
    Audit
        ``holds`` exactly if every claim was confirmed.

    Raises
    ------
    InputError
        The file is damaged, or of another trip.

    Examples
    --------
    >>> import tempfile
    >>> from enumerate import plan, save_proofs
    >>> from relax import load_trip
    >>> trip = load_trip("paper-400km", overrides={"route.ambient_c": 10})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     save_proofs(Path(folder) / "trip.proofs", trip, plan(trip, keep_proofs=True))
    ...     found = audit(Path(folder) / "trip.proofs", trip)
    >>> found.holds, found.subsets
    (True, 8)
    """
    evidence = load_proofs(path)
    if evidence.fingerprint != fingerprint(trip) or evidence.n_chargers != len(trip.chargers):
        allowed = f"proofs of the trip {trip.name!r} with the same numbers (--set as when planning)"
        raise InputError(str(path), "proofs of the trip", evidence.trip, allowed)
    return audit_evidence(evidence, trip, progress)


def audit_evidence(
    evidence: Evidence, trip: Trip, progress: Callable[[int, int], None] | None = None
) -> Audit:
    """Check evidence that is known to be of a trip.

    Parameters
    ----------
    evidence : Evidence
        Well-formed, as ``load_proofs`` returns it.
    trip : Trip
        The trip.
    progress : callable, optional
        Called with the number of boxes and steps over stages done, and of all.
    """
    begin = time.perf_counter()
    drive = make_drive(trip, evidence.grid.step_km)

    def make(subset: tuple[int, ...], undecided: tuple[int, ...]) -> Instance:
        return make_instance(trip, subset, evidence.grid, drive, undecided)

    proofs = Recheck(make, len(trip.chargers))
    total = len(evidence.nodes) + (0 if evidence.stages is None else len(evidence.stages.steps))

    def tell(done: int) -> None:
        if progress is not None:
            progress(done, total)

    proofs.run(evidence.nodes, lambda done, _: tell(done))
    stages = StageRecheck()
    if evidence.stages is not None:
        family = make((), tuple(range(len(trip.chargers))))
        stages = recheck_stages(family, evidence.stages, lambda done: tell(proofs.nodes + done))
    failures = [*proofs.failures, *stages.failures]
    accounted = _accounted(evidence)
    failures += accounted
    # rows that do not account for every choice claim nothing
    found = [] if accounted else _bounds(evidence, proofs, stages, failures)
    bound = stages.bound if accounted else min(found, default=-inf)
    own = stages.bound if accounted else _own_bound(evidence, found)
    cost = inf
    if evidence.driven is not None:
        try:
            cost = _driven(evidence, evidence.driven, trip, make, failures)
        except (ArithmeticError, ValueError, AssertionError) as error:
            failures.append(f"plan: it cannot be driven: {error}")
    if exceeds(own, evidence.transcribed):
        failures.append(
            f"plan: it costs {evidence.transcribed!r} on the grid, but no plan with its stops "
            f"costs less than {own!r}"
        )
    _sums(evidence, bound, cost, failures)
    return Audit(
        trip=trip.name,
        currency=trip.currency,
        failures=tuple(failures),
        subsets=2**evidence.n_chargers,
        rows=len(evidence.rows),
        nodes=proofs.nodes,
        programs=proofs.programs + stages.programs,
        cost=cost,
        lower_bound=bound,
        seconds=time.perf_counter() - begin,
        stage_steps=stages.steps,
        status=evidence.status[:20]
        + (f"; optimal is a gap of at most {percent(_asked(evidence), 2)} %" if cost < inf else ""),
        grid=f"{counted(drive.n_steps, 'driving step')}, "
        f"{counted(evidence.grid.cells, 'cell')} per stop",
    )


def _asked(evidence: Evidence) -> float:
    """Return the gap at which a plan counts as optimal."""
    return DEFAULT_GAP if evidence.asked_gap is None else evidence.asked_gap


def _accounted(evidence: Evidence) -> list[str]:
    """Return whether the rows account for each subset exactly once: none if they do."""
    try:
        Ledger(evidence.n_chargers, evidence.rows)
    except ValueError as error:
        return [f"rows: {error}"]
    if evidence.n_chargers <= COUNTED:
        for subset in all_subsets(evidence.n_chargers):
            times = sum(
                row.holds(subset) if row.undecided else row.subset == subset
                for row in evidence.rows
            )
            if times != 1:
                return [f"rows: the chargers {subset} are accounted for {times} times"]
    return []


def _name(row: Row) -> str:
    maybe = f" and any of {row.undecided}" if row.undecided else ""
    return f"row of the chargers {row.subset}{maybe}"


def _bounds(
    evidence: Evidence, proofs: Recheck, stages: StageRecheck, failures: list[str]
) -> list[float]:
    """Return what is proved of every row, and note the rows that claim more.

    What stages bound holds for every plan, and so for every row.
    """
    out = []
    limit = closing_cost(evidence.cost, _asked(evidence), evidence.transcribed)
    for row in evidence.rows:
        fixed, most = len(row.subset), len(row.subset) + len(row.undecided)
        count = (row.count or (fixed, most)) if row.undecided else (fixed, fixed)
        bound = max(proofs.bound(Family(row.subset, row.undecided, count)), stages.bound)
        out.append(bound)
        if row.outcome is Outcome.INFEASIBLE and bound < inf:
            failures.append(
                f"{_name(row)}: proved infeasible, it says; what is proved is that no plan costs "
                f"less than {bound!r}"
            )
        elif exceeds(row.lower_bound, bound):
            failures.append(
                f"{_name(row)}: claims that no plan costs less than {row.lower_bound!r}; what is "
                f"proved is {bound!r}"
            )
        if row.outcome is Outcome.BOUNDED and exceeds(limit, bound):
            failures.append(f"{_name(row)}: cannot be better, it says; that is not proved")
        if row.outcome is Outcome.PLANNED and exceeds(row.lower_bound, row.cost):
            failures.append(f"{_name(row)}: its plan costs less than its bound")
    return out


def _own_bound(evidence: Evidence, found: list[float]) -> float:
    """Return what is proved of plans with the driven one's stops."""
    if evidence.driven is None:
        return -inf
    stops = evidence.driven.stops
    return max(
        (b for row, b in zip(evidence.rows, found, strict=True) if row.holds(stops)), default=-inf
    )


def _driven(
    evidence: Evidence,
    plan: DrivenPlan,
    trip: Trip,
    make: Callable[[tuple[int, ...], tuple[int, ...]], Instance],
    failures: list[str],
) -> float:
    """Return what a plan costs when it is driven, and note what it breaks."""
    if len(set(plan.stops)) < len(plan.stops) or not all(
        0 <= c < len(trip.chargers) for c in plan.stops
    ):
        failures.append("plan: it stops at chargers that the trip does not have")
        return inf
    instance = make(plan.stops, ())
    reason = _unusable(plan, instance)
    if reason:
        failures.append(f"plan: {reason}")
        return inf
    with np.errstate(over="raise", invalid="raise", divide="raise"):
        driven = replay(trip, instance, plan.controls, plan.targets_kwh)
        on_grid = simulate(instance, plan.controls)
    if not _same(on_grid.cost, evidence.transcribed):
        failures.append(
            f"plan: it costs {on_grid.cost!r} on the grid, not {evidence.transcribed!r}"
        )
    most = float(on_grid.violation.max())
    if not most <= FEASIBLE + COST_TOLERANCE:
        failures.append(f"plan: on the grid it breaks a limit by {most:g}")
    failures += [f"plan: {violation}" for violation in driven.violations]
    return float(driven.cost) if driven.feasible else inf


def _unusable(plan: DrivenPlan, instance: Instance) -> str:
    """Return why controls are none of the car, empty if they are."""
    vehicle, c = instance.vehicle, plan.controls
    if instance.subset != plan.stops:
        return "its stops are not in driving order"
    if c.heater_kw.shape != (instance.drive.n_steps,):
        return "it has controls for another number of steps"
    limits = {
        "heater_kw": vehicle.heater_kw,
        "cooling_kw": vehicle.cooling_kw,
        "heat_pump_kw": vehicle.heat_pump_kw,
    }
    for part in (c, *c.stops):
        for name, most in limits.items():
            values = getattr(part, name)
            if not np.all((values >= 0.0) & (values <= most + SETTING_TOLERANCE)):
                return f"{name} outside 0 .. {most:g}"
    for stop, target in zip(c.stops, plan.targets_kwh, strict=True):
        if not np.all(stop.power_kw > 0.0) or not -inf < target < inf:
            return "a stop does not charge"
    return ""


def _same(found: float, claimed: float) -> bool:
    """Return whether two costs agree but for rounding; ``inf`` agrees with itself."""
    return found == claimed or abs(found - claimed) <= COST_TOLERANCE * max(1.0, abs(claimed)) < inf


def _sums(evidence: Evidence, bound: float, cost: float, failures: list[str]) -> None:
    """Note printed numbers that do not follow: cost, bound, gap, status."""
    if exceeds(evidence.lower_bound, bound):
        failures.append(f"bound: {evidence.lower_bound!r} is claimed, {bound!r} is proved")
    if not _same(cost, evidence.cost):
        failures.append(f"cost: {evidence.cost!r} is claimed, the drive costs {cost!r}")
    gap = relative_gap(cost, bound)
    if not (gap == evidence.gap or gap <= evidence.gap + COST_TOLERANCE):
        failures.append(f"gap: {evidence.gap!r} is claimed, {gap!r} is proved")
    asked = _asked(evidence)
    if evidence.status == "optimal" and not is_proved(
        cost, evidence.transcribed, bound, asked + COST_TOLERANCE
    ):
        failures.append(
            f"status: optimal within {asked:g} is claimed, {gap:g} is proved of a plan that costs "
            f"{evidence.transcribed!r} on the grid and {cost!r} driven"
        )
    if evidence.status == "infeasible" and bound < inf:
        failures.append("status: infeasible is claimed, not proved")
    known = ("optimal", "feasible") if evidence.driven is not None else ("infeasible", "unknown")
    if evidence.status not in known:
        whether = "without a plan" if evidence.driven is None else "with a plan"
        failures.append(f"status: {evidence.status[:20]!r} is none {whether}")
    if evidence.driven is None and evidence.transcribed < inf:
        failures.append("plan: it has a cost on the grid, but there is none")
