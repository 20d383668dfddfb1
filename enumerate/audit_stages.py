"""Owns the re-check of a proof over stages: its steps are done again on a graph of the trip.

The graph is the one that the search used; it certifies every step from its dual vector.
What it then bounds counts, not what is claimed. Knows nothing of solvers, of the search
and of the ledger.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import inf

import numpy as np

from enumerate.audit_tree import exceeds
from enumerate.evidence import StageProof
from enumerate.stage_graph import StageGraph
from relax.instance import Instance

__all__ = ["StageRecheck", "recheck_stages"]

CERTIFIED = ("cost", "empty", "shrink")
"""Steps with a dual vector."""


@dataclass(frozen=True)
class StageRecheck:
    """What a proof over stages is worth.

    Parameters
    ----------
    bound : float
        No plan costs less [currency]; ``-inf`` if a step could not be done, or there was none.
    steps, programs : int
        Steps done, and programs certified.
    failures : tuple of str
        What cannot be done, or is claimed and not proved.
    """

    bound: float = -inf
    steps: int = 0
    programs: int = 0
    failures: tuple[str, ...] = ()


def recheck_stages(
    family: Instance, proof: StageProof, progress: Callable[[int], None] | None = None
) -> StageRecheck:
    """Do the steps of a proof over stages again.

    Parameters
    ----------
    family : Instance
        All subsets of the trip: every stop optional.
    proof : StageProof
        Anything of the right types.
    progress : callable, optional
        Called with the number of steps done.

    Examples
    --------
    >>> from enumerate.stage_parts import StageStep
    >>> from relax import load_trip, make_instance
    >>> family = make_instance(load_trip("paper-400km"), (), undecided=(0, 1, 2))
    >>> recheck_stages(family, StageProof(400.0, (StageStep("open", 3),), 100.0)).failures
    ('stages: no plan costs less than 100.0, they claim; what is proved is -inf',)
    >>> recheck_stages(family, StageProof(400.0, (StageStep("open", 99),), 100.0)).failures
    ('stages: step 0 cannot be done: there is no arc 99',)
    """
    done = programs = 0
    try:
        graph = StageGraph(family, proof.closing)
        for step in proof.steps:
            with np.errstate(over="raise", invalid="raise", divide="raise"):
                graph.apply(step)
            graph.steps.clear()  # nobody reads them here
            done += 1
            programs += step.kind in CERTIFIED
            if progress is not None:
                progress(done)
    except (ArithmeticError, ValueError, LookupError, AssertionError) as error:
        reason = f"stages: step {done} cannot be done: {error}"
        return StageRecheck(-inf, done, programs, (reason,))  # a step half done proves nothing
    bound = graph.lower_bound
    if exceeds(proof.bound, bound):
        reason = (
            f"stages: no plan costs less than {proof.bound!r}, they claim; what is proved is "
            f"{bound!r}"
        )
        return StageRecheck(bound, done, programs, (reason,))
    return StageRecheck(bound, done, programs)
