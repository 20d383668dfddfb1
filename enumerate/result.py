"""Owns the result of a search as a frozen value, and its JSON form."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from enum import Enum
from functools import cached_property
from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np

from enumerate.evidence import ProofNode, StageProof
from enumerate.gap import DEFAULT_GAP, relative_gap
from enumerate.ledger import Ledger
from relax.trip import Grid

if TYPE_CHECKING:
    from enumerate.diagnose import Diagnosis
    from relax.certificate import Certificate
    from relax.driven import Replay
    from relax.execute import Execution
    from relax.instance import Instance
    from relax.report import PlanReport

__all__ = ["Result", "Status"]


class Status(Enum):
    """What is known at the end of a search; the value is its name in the JSON output."""

    OPTIMAL = "optimal"
    FEASIBLE = "feasible"
    INFEASIBLE = "infeasible"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class Result:
    """What ``plan`` returns.

    Parameters
    ----------
    trip : str
        Name of the trip.
    currency : str
        Currency of all costs.
    status : Status
        ``optimal`` within the asked gap, ``feasible``, ``infeasible`` or ``unknown``.
    cost : float
        Replayed cost of the plan, ``inf`` without one [currency].
    transcribed_cost : float
        Its cost on the transcription, to compare with the bound [currency].
    lower_bound : float
        Certified bound over all subsets and controls of the transcription [currency].
    plan : PlanReport or None
        The plan.
    replay : Replay or None
        The drive that judged it.
    ledger : Ledger
        Rows of subsets and of families: every subset is in one.
    chargers : tuple of str
        Names, by index.
    asked_gap : float or None
        Relative gap that was to be proved; None: the quick bounds only.
    timings_s : dict of str to float
        Wall-clock time by phase [s].
    interrupted : str
        Why the search ended early, empty if it did not.
    programs : int
        Programs solved in all: relaxations, bound problems, quadratic programs.
    proofs : tuple of ProofNode
        Evidence of all bounds, if it was to be kept.
    diagnosis : Diagnosis or None
        Without a plan: how far the car gets and what would help.
    grid : Grid
        Steps and cells of the transcription.
    instance : Instance or None
        Transcription of the plan's subset.
    execution : Execution or None
        The plan as the car is told: its controls and charging targets.
    stages : StageProof or None
        Evidence of the bound over stages, if there is one and it was to be kept.
    """

    trip: str
    currency: str
    status: Status
    cost: float
    transcribed_cost: float
    lower_bound: float
    plan: PlanReport | None
    replay: Replay | None
    ledger: Ledger
    chargers: tuple[str, ...]
    timings_s: dict[str, float]
    asked_gap: float | None = None
    interrupted: str = ""
    programs: int = 0
    proofs: tuple[ProofNode, ...] = ()
    diagnosis: Diagnosis | None = None
    grid: Grid = field(default_factory=Grid)
    instance: Instance | None = field(default=None, repr=False, compare=False)
    execution: Execution | None = field(default=None, repr=False, compare=False)
    stages: StageProof | None = field(default=None, repr=False, compare=False)

    @cached_property
    def certificate(self) -> Certificate | None:
        """Convexity certificate of the plan's subset, printed by ``str``; None without a plan.

        Made when it is first asked for, which solves one program; kept from then on.

        Examples
        --------
        >>> from enumerate import plan
        >>> from relax import load_trip
        >>> result = plan(load_trip("paper-400km", overrides={"route.ambient_c": 10}))
        >>> result.certificate.structure.convex
        True
        """
        if self.instance is None:
            return None
        from relax.certificate import make_certificate  # imports a solver

        return make_certificate(self.instance, names=self.chargers)

    @property
    def gap(self) -> float:
        """Relative gap between cost and bound; ``inf`` while either is missing."""
        return relative_gap(self.cost, self.lower_bound)

    @property
    def optimal_gap(self) -> float:
        """Relative gap within which a plan is called optimal: the asked one, or 1 %."""
        return DEFAULT_GAP if self.asked_gap is None else self.asked_gap

    @property
    def is_feasible(self) -> bool:
        """Whether there is a plan that held in replay."""
        return self.plan is not None

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form: plain numbers, strings, lists; missing numbers are ``None``."""
        plan = None
        if self.plan is not None:
            plan = {
                "stops": [asdict(s) | {"average_kw": s.average_kw} for s in self.plan.stops],
                "grid_kwh": self.plan.grid_kwh,
                "charging_h": self.plan.charging_h,
                "detour_h": self.plan.detour_h,
                "driving_h": self.plan.driving_h,
                "final_soc": self.plan.final_soc,
                "final_temperature_c": self.plan.final_temperature_c,
                "totals_kwh": self.plan.totals_kwh,
                "drive": asdict(self.plan.drive),
                "charge": [asdict(c) for c in self.plan.charge],
                "deviation": asdict(self.plan.deviation),
            }
        replayed = None
        if self.replay is not None:
            replayed = {
                "feasible": self.replay.feasible,
                "cost": self.replay.cost,
                "violations": [str(v) for v in self.replay.violations],
            }
        names = self.chargers
        rows = [
            {
                "stops": [names[i] for i in row.subset],
                "undecided": [names[i] for i in row.undecided],
                "subsets": row.size,
                "outcome": row.outcome.value,
                "cost": row.cost,
                "lower_bound": row.lower_bound,
                "reason": row.reason,
            }
            for row in self.ledger.rows
        ]
        value = {
            "trip": self.trip,
            "status": self.status.value,
            "cost": self.cost,
            "transcribed_cost": self.transcribed_cost,
            "lower_bound": self.lower_bound,
            "gap": self.gap,
            "asked_gap": self.asked_gap,
            "currency": self.currency,
            "plan": plan,
            "replay": replayed,
            "subsets": self.ledger.counts(),
            "programs": self.programs,
            "rows": rows,
            "timings_s": self.timings_s,
            "interrupted": self.interrupted,
            "diagnosis": None if self.diagnosis is None else asdict(self.diagnosis),
        }
        plain = _plain(value)
        assert isinstance(plain, dict)
        return plain


def _plain(value: Any) -> Any:
    """Return a value of JSON types; infinities and NaN become None."""
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, np.ndarray):
        return [_plain(v) for v in value.tolist()]
    if isinstance(value, float | np.floating):
        return float(value) if isfinite(value) else None
    return value
