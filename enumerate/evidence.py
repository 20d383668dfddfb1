"""Owns the evidence of a search as data: which box was cut where, and by which dual vectors.

Trees of nodes: a root is a family of subsets with the box that dynamics alone imply,
the parts of a node follow from where it was cut. Knows nothing of how it was found.
"""

from __future__ import annotations

from dataclasses import dataclass

from enumerate.subset import Subset
from relax.branch import Branch
from relax.proof import Step

__all__ = ["ProofNode"]


@dataclass(frozen=True)
class ProofNode:
    """One box of a proof.

    Parameters
    ----------
    number : int
        Its place among all nodes.
    parent : int
        The node it is a part of, -1 for a root.
    part : int
        0 for the first, 1 for the second part of its parent.
    subset, undecided : tuple of int
        Chargers used, and those that may be used.
    count : tuple of int
        Least and largest number of stops.
    cutoff : float
        Cost below which plans mattered when it was looked at [currency]; ``inf`` if
        all of them do.
    steps : tuple of Step
        What was shown, in order.
    how : Branch or None
        Where it was cut.
    bound : float
        Claim: no plan in it costs less [currency]; ``inf``: it holds none.
    """

    number: int
    parent: int
    part: int
    subset: Subset
    undecided: Subset
    count: tuple[int, int]
    cutoff: float
    steps: tuple[Step, ...]
    how: Branch | None
    bound: float
