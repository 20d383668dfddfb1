"""Owns the books of a search: open leaves, what closed families are worth, and the evidence.

Every subset is in exactly one family, and every family is covered by its leaves, at
any moment; so the least bound of all leaves bounds every plan. Knows nothing of how
leaves are examined and of how plans are found.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from math import inf

from enumerate.evidence import ProofNode
from enumerate.ledger import Outcome, Row
from enumerate.stage_graph import StageGraph
from enumerate.stage_parts import StageStep
from enumerate.subset import Subset
from enumerate.tree import Examined, Leaf
from relax.proof import Step

__all__ = ["Account"]

Key = tuple[Subset, Subset, tuple[int, int]]
"""Used and undecided chargers of a family, least and largest number of stops."""


@dataclass
class _Family:
    """What is known of the leaves of one family."""

    bounds: list[float] = field(default_factory=list)  # of leaves that are not looked at again
    infeasible: bool = True
    programs: int = 0


class Account:
    """Open leaves, closed families and evidence of one search.

    Parameters
    ----------
    n_chargers : int
        Number of chargers.
    keep_proofs : bool
        Keep every step for an audit.

    Examples
    --------
    >>> from enumerate.tree import make_roots
    >>> account = Account(2, keep_proofs=False)
    >>> account.plant(make_roots(2))
    >>> [row.size for row in account.rows({}, cutoff=100.0)]
    [4]
    """

    def __init__(self, n_chargers: int, keep_proofs: bool) -> None:
        self.n_chargers, self.keep_proofs = n_chargers, keep_proofs
        self.proofs: list[ProofNode] = []
        self.programs = 0  # of leaves and stages
        self.stages: tuple[StageStep, ...] = ()
        self.stage_closing, self.stage_bound = inf, -inf
        self._open: list[tuple[float, int, Leaf]] = []
        self._families: dict[Key, _Family] = {}
        self._number = 0
        self._examined = 0
        self._taken: dict[int, float] = {}  # bounds of leaves that are being examined
        self._rooted: set[Subset] = set()
        self._used: list[Subset] = []

    @property
    def open_bound(self) -> float:
        """Least bound of all leaves, open or not, or that of all stages [currency]."""
        closed = [b for f in self._families.values() for b in f.bounds]
        still = [*(entry[0] for entry in self._open[:1]), *self._taken.values()]
        leaves = min([*closed, *still], default=inf)
        return max(leaves, self.stage_bound)

    @property
    def progress(self) -> tuple[int, int]:
        """Leaves examined, and those plus the open ones."""
        return self._examined, self._examined + self.n_open

    @property
    def n_open(self) -> int:
        """Leaves to be examined."""
        return len(self._open)

    def plant(self, leaves: Iterable[Leaf]) -> None:
        """Add leaves that cover their families from the start."""
        for leaf in leaves:
            self._push(leaf)

    def _push(self, leaf: Leaf) -> None:
        leaf = replace(leaf, number=self._number)
        self._number += 1
        self.put_back([leaf])

    def root(self, row: Row, steps: tuple[Step, ...]) -> None:
        """Enter the bound of a fixed subset by its relaxation alone."""
        if row.subset in self._rooted:
            return
        self._rooted.add(row.subset)
        if self.keep_proofs:
            count = (len(row.subset), len(row.subset))
            bound = inf if row.outcome is Outcome.INFEASIBLE else row.lower_bound
            self.proofs.append(
                ProofNode(self._number, -1, 0, row.subset, (), count, inf, steps, None, bound)
            )
        self._number += 1

    def take(self, most: int, cutoff: float, families: bool = False) -> list[Leaf]:
        """Remove and return open leaves with bounds below the cutoff, least first.

        Only ``families`` if asked for: their relaxations suggest stops.
        """
        out: list[Leaf] = []
        aside = []
        if self.stage_bound >= cutoff:
            return out
        while self._open and len(out) < most and self._open[0][0] < cutoff:
            entry = heapq.heappop(self._open)
            if families and not entry[2].undecided:
                aside.append(entry)
            else:
                out.append(entry[2])
        for entry in aside:
            heapq.heappush(self._open, entry)
        self._taken |= {leaf.number: leaf.bound for leaf in out}
        return out

    def put_back(self, leaves: Iterable[Leaf]) -> None:
        """Return leaves that were taken and not examined."""
        for leaf in leaves:
            self._taken.pop(leaf.number, None)
            heapq.heappush(self._open, (leaf.bound, leaf.number, leaf))

    def enter_stages(self, graph: StageGraph, programs: int) -> None:
        """Enter what a proof over stages bounds: every plan."""
        self.programs += programs
        self.stage_closing, self.stage_bound = graph.given, graph.lower_bound
        if self.keep_proofs:
            self.stages = tuple(graph.steps)

    def enter(self, done: Examined, cutoff: float) -> None:
        """Enter what became of a leaf: its parts, or its last bound."""
        leaf = done.leaf
        self._taken.pop(leaf.number, None)
        self._examined += 1
        self.programs += done.programs
        family = self._families.setdefault(_key(leaf), _Family())
        family.programs += done.programs
        first = self._number
        for part in done.parts:
            self._push(replace(part, parent=leaf.number))
        if not done.parts:
            family.bounds.append(inf if done.infeasible else done.bound)
            family.infeasible &= done.infeasible
        if leaf.undecided and done.used:
            self._used.append(done.used)
        if self.keep_proofs:
            self.proofs.append(
                ProofNode(
                    leaf.number, leaf.parent, leaf.part, leaf.subset, leaf.undecided, leaf.count,
                    cutoff, done.steps, done.how, inf if done.infeasible else done.bound,
                )
            )  # fmt: skip
        assert first + len(done.parts) == self._number

    def suggestions(self) -> list[Subset]:
        """Return the stops that relaxed optima of families used, in the order they were met."""
        return list(dict.fromkeys(self._used))

    def decided(self) -> list[Subset]:
        """Return the subsets of open leaves in which nothing is undecided."""
        return sorted({leaf.subset for *_, leaf in self._open if not leaf.undecided})

    def rows(self, alone: Mapping[Subset, Row], cutoff: float) -> list[Row]:
        """Return one row per family and per subset handled alone; sizes add up to 2^N.

        Parameters
        ----------
        alone : mapping of subset to Row
            Subsets with rows of their own.
        cutoff : float
            Cost from which on a bound closes [currency].
        """
        families = {key: replace(f, bounds=list(f.bounds)) for key, f in self._families.items()}
        is_open: set[Key] = set()
        for bound, _, leaf in self._open:
            family = families.setdefault(_key(leaf), _Family())
            family.bounds.append(bound)
            family.infeasible = False
            is_open.add(_key(leaf))
        found = []
        for key, family in families.items():
            if not family.bounds:
                continue  # cut into parts that speak for it
            if not key[1] and key[2][0] > len(key[0]):
                continue  # a part with more stops than chargers are left: it has no members
            bound = min(family.bounds)
            outcome, reason = Outcome.UNPROVED, "not closed"
            if family.infeasible:
                outcome, reason = Outcome.INFEASIBLE, "out of reach or without a relaxed point"
            elif bound >= cutoff:
                outcome, reason = Outcome.BOUNDED, "no plan below the best one less the gap"
            found.append(
                Row(
                    key[0], outcome, inf, bound, reason, family.programs, key[1],
                    key[2] if key[1] else None,
                )
            )  # fmt: skip
        out = []
        rest = dict(alone)
        for row in found:
            inside = [s for s in alone if row.holds(s)]
            for subset in inside:
                rest[subset] = _joined(rest[subset], row)
            if row.undecided:
                row = replace(row, without=tuple(inside))
                if row.size:
                    out.append(row)
            elif not inside:
                out.append(row)
        return [self._with_stages(row, cutoff) for row in (*rest.values(), *out)]

    def _with_stages(self, row: Row, cutoff: float) -> Row:
        """Return a row with what stages bound."""
        if row.lower_bound >= self.stage_bound:
            return row
        row = replace(row, lower_bound=self.stage_bound)
        if row.outcome is Outcome.UNPROVED and self.stage_bound >= cutoff:
            reason = "no chain of stages below the best one less the gap"
            row = replace(row, outcome=Outcome.BOUNDED, reason=reason)
        return row


def _key(leaf: Leaf) -> Key:
    n = len(leaf.subset)
    decided = not leaf.undecided and leaf.count[0] <= n
    return leaf.subset, leaf.undecided, (n, n) if decided else leaf.count


def _joined(row: Row, family: Row) -> Row:
    """Return a subset's own row with what is known of its family."""
    bound = max(row.lower_bound, family.lower_bound)
    own = not family.undecided
    row = replace(
        row,
        lower_bound=bound,
        programs=row.programs + (family.programs if own else 0),
    )
    if row.outcome is Outcome.UNPROVED and family.outcome is not Outcome.UNPROVED:
        return replace(row, outcome=family.outcome, reason=family.reason)
    return row
