"""Owns the re-check of proof trees: every box rebuilt, every step certified again.

A root's box follows from its family of subsets, a part's box from its parent's last box and
the cut; steps are done by ``BoxProof`` from their dual vectors alone. What is cut but never
looked at keeps its parent's bound. Nothing stated in a node is believed. Knows nothing of
solvers, of the search and of the ledger.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import inf, isfinite

import numpy as np

from enumerate.evidence import ProofNode
from enumerate.quantity import is_quantity
from enumerate.subset import Subset
from relax.box import Box
from relax.branch import Branch, branch, decide
from relax.instance import Instance
from relax.intervals import Interval
from relax.proof import BoxProof, Closed, Step
from relax.reach import make_box

__all__ = ["Family", "Recheck", "exceeds"]

TOLERANCE = 1e-9
"""Relative excess of a claim over what is recomputed that is summation order on another
machine; on the same one the numbers agree to the last bit."""


def exceeds(claim: float, proved: float) -> bool:
    """Return whether a bound is claimed that is above the proved one by more than rounding.

    Examples
    --------
    >>> exceeds(100.0 + 1e-9, 100.0), exceeds(100.1, 100.0), exceeds(float("inf"), 100.0)
    (False, True, True)
    """
    if claim == proved or claim == -inf:
        return False
    slack = TOLERANCE * max(1.0, abs(proved)) if isfinite(proved) else 0.0
    return not claim <= proved + slack


@dataclass(frozen=True)
class Family:
    """Subsets between two, with a range for their size.

    Parameters
    ----------
    subset, undecided : tuple of int
        Chargers in all of them, and those that may be in besides.
    count : tuple of int
        Least and largest size.

    Examples
    --------
    >>> whole, part = Family((), (0, 1, 2), (0, 3)), Family((1,), (2,), (1, 2))
    >>> whole.covers(part), part.covers(whole), part.meets(Family((0,), (2,), (0, 3)))
    (True, False, False)
    """

    subset: Subset
    undecided: Subset
    count: tuple[int, int]

    @cached_property
    def masks(self) -> tuple[int, int]:
        """Chargers in all subsets and chargers in any, as bits."""
        used = sum(1 << c for c in self.subset)
        every = used | sum(1 << c for c in self.undecided)
        if self.count[0] >= every.bit_count():
            used = every  # no subset is large enough but the whole
        elif self.count[1] <= used.bit_count():
            every = used
        return used, every

    def covers(self, other: Family) -> bool:
        """Return whether every subset of the other family is in this one."""
        (used, every), (used_o, every_o) = self.masks, other.masks
        least = max(other.count[0], used_o.bit_count())
        most = min(other.count[1], every_o.bit_count())
        if least > most:
            return True  # there is none
        inside = not (used & ~used_o or every_o & ~every)
        return inside and self.count[0] <= least and most <= self.count[1]

    def meets(self, other: Family) -> bool:
        """Return whether some subset is in both."""
        (used, every), (used_o, every_o) = self.masks, other.masks
        if used & ~every_o or used_o & ~every:
            return False
        least = max(self.count[0], other.count[0], (used | used_o).bit_count())
        return least <= min(self.count[1], other.count[1], (every & every_o).bit_count())


@dataclass(frozen=True)
class _Leaf:
    """A family, or a box of it, and what no plan in it undercuts; ``inf``: it holds none."""

    family: Family
    value: float


@dataclass(frozen=True)
class _Task:
    """A node to look at: the family and box that follow from its parent, and what is known."""

    node: ProofNode
    family: Family
    box: Box | None
    known: float
    limit: float  # least cutoff that shrank the box: plans outside it cost at least this


@dataclass
class Recheck:
    """Re-checks all trees of a proof.

    Parameters
    ----------
    make : callable
        Instance of used and undecided chargers.
    n_chargers : int
        Number of chargers.

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> trip = load_trip("paper-400km")
    >>> check = Recheck(lambda used, maybe: make_instance(trip, used, undecided=maybe), 3)
    >>> check.run([ProofNode(0, -1, 0, (), (), (0, 0), inf, (), None, inf)])
    >>> check.failures, check.bound(Family((), (), (0, 0)))  # out of reach: the box is empty
    ([], inf)
    >>> check.bound(Family((0,), (), (1, 1)))  # nothing is proved of it
    -inf
    """

    make: Callable[[Subset, Subset], Instance]
    n_chargers: int
    failures: list[str] = field(default_factory=list)
    nodes: int = 0
    programs: int = 0
    _trees: list[tuple[Family, list[_Leaf]]] = field(default_factory=list)

    def bound(self, family: Family) -> float:
        """Return what no plan of a family undercuts; ``inf`` if it is proved to hold none.

        Within a tree the least of the leaves counts, of several trees the best.
        """
        found = [
            min((leaf.value for leaf in leaves if leaf.family.meets(family)), default=inf)
            for root, leaves in self._trees
            if root.covers(family)
        ]
        return max(found, default=-inf)

    def run(
        self, nodes: Iterable[ProofNode], progress: Callable[[int, int], None] | None = None
    ) -> None:
        """Look at every node once, roots in the order of their numbers.

        Parameters
        ----------
        nodes : iterable of ProofNode
            In any order.
        progress : callable, optional
            Called with the number of nodes done and of all.
        """
        listed = sorted(nodes, key=lambda n: n.number)
        by_number: dict[int, ProofNode] = {}
        parts: dict[tuple[int, int], ProofNode] = {}
        roots = []
        for node in listed:
            key = (node.parent, node.part)
            if node.number < 0 or node.number in by_number:
                self._fail(node, "its number is taken by another")
            elif not self._plausible(node):
                self._fail(node, "its chargers, its part or its cutoff are none")
            elif node.parent == -1:
                by_number[node.number] = node
                roots.append(node)
            elif key in parts:
                self._fail(node, f"node {node.parent} has that part already")
            else:
                by_number[node.number] = parts[key] = node
        seen: set[int] = set()
        for root in roots:
            family = Family(root.subset, root.undecided, root.count)
            leaves: list[_Leaf] = []
            queue = [_Task(root, family, None, self.bound(family), inf)]
            while queue:
                task = queue.pop()
                seen.add(task.node.number)
                queue += self._look(task, leaves, parts)
                self.nodes += 1
                if progress is not None:
                    progress(self.nodes, len(listed))
            self._trees.append((family, leaves))
        for number, node in by_number.items():
            if number not in seen:
                self._fail(node, f"it is a part of node {node.parent}, which is not there or uncut")

    def _fail(self, node: ProofNode, text: str) -> None:
        self.failures.append(f"node {node.number}: {text}")

    def _plausible(self, node: ProofNode) -> bool:
        chosen = (*node.subset, *node.undecided)
        return (
            all(0 <= c < self.n_chargers for c in chosen)
            and len(set(chosen)) == len(chosen)
            and node.part in (0, 1)
            and node.cutoff > -inf
        )

    def _look(
        self, task: _Task, leaves: list[_Leaf], parts: dict[tuple[int, int], ProofNode]
    ) -> list[_Task]:
        """Prove a node again; enter its leaves, return its parts."""
        node, family = task.node, task.family
        if Family(node.subset, node.undecided, node.count) != family:
            self._fail(node, f"it is not part {node.part} of node {node.parent}")
        instance = self.make(family.subset, family.undecided)
        box = replace(make_box(instance), count=family.count) if task.box is None else task.box
        proof = BoxProof(instance, box, node.cutoff, task.known)
        closed, own = self._steps(node, proof)
        limit = min(task.limit, own)
        # emptied: whatever the cost, unless a cutoff shrank the box
        value = inf if closed and proof.bound < node.cutoff else proof.bound
        if exceeds(node.bound, min(value, own)):
            self._fail(
                node, f"claims that no plan costs less than {node.bound!r}; "
                f"what is proved is {min(value, own)!r}",
            )  # fmt: skip
        how = None if closed else self._sound(node, proof)
        if how is None:
            leaves.append(_Leaf(family, min(value, limit)))
            return []
        out = []
        for part, (inner, rest) in zip((0, 1), _cut(instance, family, proof.box, how), strict=True):
            child = parts.get((node.number, part))
            if child is None:
                leaves.append(_Leaf(inner, min(value, limit)))
            else:
                out.append(_Task(child, inner, rest, proof.bound, limit))
        return out

    def _steps(self, node: ProofNode, proof: BoxProof) -> tuple[bool, float]:
        """Do a node's steps: whether they close it, and the cutoff if one shrank the box."""
        own = inf
        try:
            proof.check()
            for place, step in zip(range(len(node.steps)), node.steps, strict=True):
                reason = _unsound(step, proof)
                if reason:
                    self._fail(node, f"step {place} {reason}")
                    break
                if step.kind == "shrink":
                    own = node.cutoff
                self.programs += step.kind != "propagate"
                proof.steps.clear()  # nobody reads them here
                try:
                    with np.errstate(over="raise", invalid="raise", divide="raise"):
                        proof.apply(step)
                except (ArithmeticError, ValueError, IndexError, AssertionError) as error:
                    self._fail(node, f"step {place} cannot be done: {error}")
                    break
        except Closed:
            return True, own
        return False, own

    def _sound(self, node: ProofNode, proof: BoxProof) -> Branch | None:
        """Return a node's cut if it is one of its box."""
        how, box = node.how, proof.box
        if how is None:
            return None
        good = False
        if how.kind == "use":
            good = 0 <= how.stop < box.optional.size and bool(box.optional[how.stop])
        elif how.kind == "count":
            good = float(how.at).is_integer() and box.count[0] <= how.at < box.count[1]
        elif how.kind == "halve" and is_quantity(how.target, box):
            assert how.target is not None
            interval: Interval = getattr(box, how.target.name)
            at = how.target.index
            good = bool(interval.lo[at] <= how.at <= interval.hi[at])
        if not good:
            self._fail(node, "it is cut where its box cannot be cut")
            return None
        return how


def _unsound(step: Step, proof: BoxProof) -> str:
    """Return why a step is none, empty if it is one."""
    if step.kind != "shrink":
        return ""
    if step.sign not in (1, -1) or not is_quantity(step.target, proof.box):
        return "shrinks what is no quantity of its box"
    if proof.program is None:
        return "shrinks before the cost is bounded"
    assert step.target is not None
    if np.any(proof.columns(step.target) < 0):
        return "shrinks a quantity that its program does not have"
    return ""


def _cut(instance: Instance, family: Family, box: Box, how: Branch) -> list[tuple[Family, Box]]:
    """Return both parts of a family and box; with no further stop allowed, none is undecided.

    Written apart from the search's own ``tree.cut``: the audit imports none of it.
    """
    out = []
    for first, part in zip((True, False), branch(box, how), strict=True):
        subset, undecided = family.subset, family.undecided
        if how.kind == "use":
            charger = instance.stops[how.stop].charger
            undecided = tuple(c for c in undecided if c != charger)
            if first:
                subset = tuple(sorted((*subset, charger)))
        if undecided and part.count[1] == len(subset):
            while part.optional.any():
                part = decide(part, int(np.flatnonzero(part.optional)[0]), False)
            undecided = ()
        out.append((Family(subset, undecided, part.count), part))
    return out
