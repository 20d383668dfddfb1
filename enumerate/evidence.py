"""Owns the evidence of a search as data: boxes, cuts, dual vectors, and what is claimed.

Trees of nodes: a root is a family of subsets with the box that dynamics alone imply,
the parts of a node follow from where it was cut. Beside them the steps of a proof over
stages, the ledger's rows, the plan's controls and the numbers that were printed. Knows
nothing of how any of it was found, of files and of what is true.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from enumerate.ledger import Row
from enumerate.subset import Subset
from relax.branch import Branch
from relax.proof import Step

if TYPE_CHECKING:
    from enumerate.stage_parts import StageStep
    from relax.plan import Controls
    from relax.trip import Grid

__all__ = ["DrivenPlan", "Evidence", "ProofNode", "StageProof"]


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

    Examples
    --------
    >>> node = ProofNode(0, -1, 0, (1,), (), (1, 1), float("inf"), (), None, 300.0)
    >>> node.parent, node.bound
    (-1, 300.0)
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


@dataclass(frozen=True)
class StageProof:
    """A proof over stages: of every plan at once.

    Parameters
    ----------
    closing : float
        Cost below which plans mattered [currency].
    steps : tuple of StageStep
        What was done to the graph of stages, in order.
    bound : float
        Claim: no plan costs less [currency]; ``inf``: there is none.

    Examples
    --------
    >>> StageProof(400.0, (), float("-inf")).closing
    400.0
    """

    closing: float
    steps: tuple[StageStep, ...]
    bound: float


@dataclass(frozen=True)
class DrivenPlan:
    """What the car is told: enough to drive the plan again.

    Parameters
    ----------
    stops : tuple of int
        Chargers used, in driving order.
    controls : Controls
        Schedules of all powers.
    targets_kwh : tuple of float
        Internal energy at which charging ends, one per stop [kWh].

    Examples
    --------
    >>> from relax import idle_controls, load_trip, make_instance
    >>> instance = make_instance(load_trip("paper-400km"), (1,))
    >>> DrivenPlan((1,), idle_controls(instance, (20.0,)), (60.0,)).stops
    (1,)
    """

    stops: tuple[int, ...]
    controls: Controls
    targets_kwh: tuple[float, ...]


@dataclass(frozen=True)
class Evidence:
    """Everything that was claimed of a trip, with its proofs.

    Parameters
    ----------
    trip : str
        Name of the trip.
    fingerprint : str
        Hash of the numbers of the trip, see ``evidence_file.fingerprint``.
    n_chargers : int
        Number of chargers.
    grid : Grid
        Steps and cells of the transcription.
    status : str
        What the search called its result.
    cost, lower_bound, gap : float
        Replayed cost of the plan, bound of all plans, their relative gap.
    transcribed : float
        Cost of the plan on the transcription, ``inf`` without one.
    asked_gap : float or None
        Relative gap within which a plan is called optimal, None: the usual one.
    rows : tuple of Row
        The ledger's rows; that they account for every subset is itself a claim here.
    nodes : tuple of ProofNode
        The proofs.
    driven : DrivenPlan or None
        The plan, if there is one.
    stages : StageProof or None
        The proof over stages, if there is one.

    Examples
    --------
    >>> from relax.trip import Grid
    >>> claims = {name: float("inf") for name in ("cost", "lower_bound", "gap", "transcribed")}
    >>> rest = {"asked_gap": None, "rows": (), "nodes": ()}
    >>> Evidence("t", "0", 1, Grid(), "unknown", **claims, **rest).driven is None
    True
    """

    trip: str
    fingerprint: str
    n_chargers: int
    grid: Grid
    status: str
    cost: float
    lower_bound: float
    gap: float
    transcribed: float
    asked_gap: float | None
    rows: tuple[Row, ...]
    nodes: tuple[ProofNode, ...]
    driven: DrivenPlan | None = None
    stages: StageProof | None = None
