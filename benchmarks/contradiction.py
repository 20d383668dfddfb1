"""Owns what an audit of one trip notes: its effort, its counts and the contradictions found.

Also the judge whether a trajectory lies in a box. Knows nothing of who claims what.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from math import inf, isfinite
from typing import Any

import numpy as np

from relax.box import Box
from relax.instance import Instance
from relax.plan import Trajectory

__all__ = ["LIGHT", "ROUNDING", "Audit", "Effort", "Finding", "outside"]

ROUNDING = 1e-6
"""Relative excess of a bound over a cost that counts as rounding; plans meet limits to 2e-5 kWh."""
BOX_TOLERANCE = 1e-6
"""How far outside a box counts as rounding [kWh, K, kW, h]."""


@dataclass(frozen=True)
class Effort:
    """How much is tried per trip.

    Parameters
    ----------
    subsets : int
        Subsets audited in full; the others by root bound and random drives.
    starts, drives : int
        Random starts refined and random drives tried per subset.
    plan_s, prove_s : float
        Time limits of the search and of each proof [s].
    closings, advances : int
        Proofs over stages that are begun, at most two, and how far each is taken.
    stages_s : float
        Time limit of each of them [s].
    """

    subsets: int = 3
    starts: int = 1
    drives: int = 5
    plan_s: float = 5.0
    prove_s: float = 1.0
    closings: int = 2
    advances: int = 12
    stages_s: float = 1.0


LIGHT = Effort(subsets=1, starts=1, drives=2, plan_s=1.0, prove_s=0.25, closings=1, stages_s=0.6)
"""What most trips of a long campaign get."""


@dataclass(frozen=True)
class Finding:
    """Something that contradicts something.

    Parameters
    ----------
    kind : str
        Which rule is broken.
    subset : tuple of int or None
        Where.
    detail : str
        The numbers.
    """

    kind: str
    subset: tuple[int, ...] | None
    detail: str


@dataclass
class Audit:
    """What was checked of one trip and what was found.

    Parameters
    ----------
    counts : Counter of str
        How often each thing was checked.
    findings : list of Finding
        Contradictions.
    worst : float
        Least relative distance from a bound up to a cost; negative: beyond it.
    worst_kind : str
        Which bound that was.
    facts : dict
        Of the search: status, cost, bound.
    """

    counts: Counter[str] = field(default_factory=Counter)
    findings: list[Finding] = field(default_factory=list)
    worst: float = inf
    worst_kind: str = ""
    facts: dict[str, Any] = field(default_factory=dict)

    def found(self, kind: str, subset: tuple[int, ...] | None, detail: str) -> None:
        """Note a contradiction."""
        self.findings.append(Finding(kind, subset, detail))

    def bound(
        self,
        kind: str,
        subset: tuple[int, ...] | None,
        bound: float,
        cost: float,
        slack: float | None = None,
    ) -> None:
        """Check that a bound does not exceed a cost; one known to ``slack`` has no margin."""
        if not (isfinite(cost) and bound > -inf):
            return
        self.counts["bounds"] += 1
        margin = (cost + (slack or 0.0) - bound) / max(abs(cost), 1.0)
        if slack is None and margin < self.worst:
            self.worst, self.worst_kind = margin, kind
        if not margin >= -ROUNDING:
            self.found(f"{kind} above a cost", subset, f"bound {bound!r}, cost {cost!r}")


def outside(box: Box, instance: Instance, trajectory: Trajectory) -> str:
    """Return the quantity by which a trajectory lies outside a box, empty if inside."""
    stops = trajectory.stops
    S, K = len(stops), instance.cells
    energy = np.array([s.energy_kwh for s in stops]).reshape(S, K + 1)
    dwell = np.array([s.dwell_h for s in stops]).reshape(S, K)
    out = np.array([s.detour_out_kwh for s in instance.stops])
    for name, value in (
        ("energy", trajectory.energy_kwh),
        ("temperature", trajectory.temperature_c),
        ("power", trajectory.power_kw),
        ("charge", energy[:, -1] - energy[:, 0]),
        ("arrive", energy[:, 0]),
        ("leave", energy[:, -1] - out),
        ("stop_temperature", np.array([s.temperature_c for s in stops]).reshape(S, K + 1)),
        ("dwell", dwell),
        ("stay", dwell.sum(axis=1)),
    ):
        interval = getattr(box, name)
        size = BOX_TOLERANCE * (1.0 + np.abs(value))
        beyond = np.maximum(interval.lo - value, value - interval.hi) - size
        if beyond.size and beyond.max() > 0.0:
            at = np.unravel_index(int(beyond.argmax()), beyond.shape)
            where = ", ".join(str(int(i)) for i in at)
            return f"{name}[{where}] by {float(beyond.max()):.3g}"
    return ""
