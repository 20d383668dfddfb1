"""Owns the trips whose proofs the tests audit, their plans, and what an audit needs around it.

Two chargers, six of them (families are bounded), and two on a grid so coarse that stages are
bounded at once. ``recheck`` replays nodes of a tree, ``check`` audits evidence, and
``audit_apart`` audits a file in a process of its own. A solver is loaded only when a plan is
asked for, so that such a process may import the trips from here.
"""

from __future__ import annotations

import dataclasses
import functools
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from trips import small_trip

from enumerate.audit import audit_evidence
from enumerate.audit_tree import Recheck
from enumerate.evidence import Evidence, ProofNode
from relax.instance import make_instance
from relax.trip import Grid, Trip

if TYPE_CHECKING:
    from enumerate import Result

__all__ = [
    "SIX",
    "STAGED",
    "TWO",
    "audit_apart",
    "check",
    "many_chargers",
    "plan_of_six",
    "plan_of_two",
    "recheck",
]


def many_chargers(n: int) -> Trip:
    """The small trip with chargers of both kinds all along, so that families are bounded."""
    trip = small_trip(time_value_per_h=30.0, start_soc=0.35)
    chargers = tuple(
        dataclasses.replace(
            trip.chargers[i % 2], name=f"c{i}", position_km=20.0 + 80.0 * i / (n - 1)
        )
        for i in range(n)
    )
    return dataclasses.replace(trip, chargers=chargers)


SIX = dataclasses.replace(many_chargers(6), grid=Grid(step_km=8.0, cells=6))
TWO = small_trip(start_soc=0.45, time_value_per_h=60.0)
STAGED = dataclasses.replace(TWO, grid=Grid(step_km=10.0, cells=4))


@functools.cache
def plan_of_six() -> Result:
    """Plan the six chargers to 1 %, with proofs."""
    from enumerate import Status, plan  # not above: it loads the solver

    found = plan(SIX, gap=0.01, keep_proofs=True)
    assert found.status is Status.OPTIMAL
    return found


@functools.cache
def plan_of_two() -> Result:
    """Plan the two chargers to 2 %, with proofs: quick to audit."""
    from enumerate import plan  # not above: it loads the solver

    return plan(TWO, gap=0.02, keep_proofs=True)


def check(evidence: Evidence) -> tuple[bool, str]:
    """Audit the evidence of six or of two chargers: whether it holds, and what fails."""
    found = audit_evidence(evidence, SIX if evidence.n_chargers == 6 else TWO)
    return found.holds, "\n".join(found.failures)


def recheck(trip: Trip, nodes: Iterable[ProofNode], grid: Grid | None = None) -> Recheck:
    """Replay the nodes of a tree."""
    proofs = Recheck(
        lambda used, maybe: make_instance(trip, used, grid, None, maybe), len(trip.chargers)
    )
    proofs.run(nodes)
    return proofs


def audit_apart(file: Path, trip: str) -> tuple[int, set[str]]:
    """Audit a file in a process of its own; ``trip`` is the name of its trip here.

    It must hold. Returns the steps over stages that were replayed, and every module loaded.
    """
    code = (
        f"import sys\nfrom audited import {trip}\nfrom enumerate import audit\n"
        f"found = audit(sys.argv[1], {trip})\nassert found.holds, found.failures\n"
        "print(found.stage_steps, *sorted(sys.modules))"
    )
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code, str(file)],
        capture_output=True, text=True, check=False,
        cwd=Path(__file__).resolve().parents[1],
        env={"PYTHONPATH": ":".join(p for p in sys.path if p)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    steps, *modules = done.stdout.split()
    return int(steps), {*modules}
