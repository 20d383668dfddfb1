"""Owns the leaves of the search: a family of subsets with a box, and how it is cut.

A leaf is a partial decision: some chargers used, some left out, some undecided, with
a range for the number of stops, and a box that holds every plan of the family that
matters. Knows nothing of plans, of their costs and of the order of the search.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import comb, inf

import numpy as np
import numpy.typing as npt

from enumerate.subset import Subset
from relax.box import Box
from relax.branch import Branch, branch, decide
from relax.instance import Instance
from relax.proof import BoxProof, Closed, Step
from relax.reach import make_box
from relax.relaxed_point import Optimum, RelaxedPoint
from relax.tighten import tighten

__all__ = ["Examined", "Leaf", "cut", "cut_unbounded", "examine", "make_roots"]

FEW_SUBSETS = 12
"""Families of up to this many subsets are cut without being bounded first: their own bound costs
as much as that of two subsets, and closed one in three (``docs/relaxation.md``, section 6)."""
NEAR = 0.01
"""Share of the cutoff that is missing at most where a small family is bounded nevertheless."""


@dataclass(frozen=True)
class Leaf:
    """A family of subsets and a box of it.

    Parameters
    ----------
    subset : tuple of int
        Chargers that are used.
    undecided : tuple of int
        Chargers that may be used; all others are not.
    bound : float
        No plan of the family in the box costs less [currency].
    box : Box or None
        None: that of ``make_box``, with ``count``.
    count : tuple of int
        Least and largest number of stops.
    number, parent, part : int
        Its place in the evidence, that of the leaf it is a part of (-1: none), and
        which part.
    halved : bool
        An interval of its box has been cut.
    limit : float
        Least cutoff that shrank its box [currency]: what lies outside costs at least this,
        so no more is proved of the family. ``inf``: if the box is empty, it is infeasible.
    known : Optimum or None
        That of a root's relaxation, if it has been solved.
    """

    subset: Subset
    undecided: Subset
    bound: float
    box: Box | None
    count: tuple[int, int]
    number: int = -1
    parent: int = -1
    part: int = 0
    halved: bool = False
    limit: float = inf
    known: Optimum | None = None

    @property
    def n_subsets(self) -> int:
        """Number of subsets in the family."""
        least, most = (n - len(self.subset) for n in self.count)
        return sum(comb(len(self.undecided), k) for k in range(max(least, 0), most + 1))

    def start(self, instance: Instance) -> Box:
        """Return the box to work on."""
        if self.known is not None:
            return self.known.box
        return replace(make_box(instance), count=self.count) if self.box is None else self.box


@dataclass(frozen=True)
class Examined:
    """What became of a leaf.

    Parameters
    ----------
    leaf : Leaf
        The leaf.
    bound : float
        Its bound now [currency].
    closed : bool
        No plan of it costs less than the cutoff.
    infeasible : bool
        Proved empty without regard to cost: the box itself is.
    how : Branch or None
        Where it was cut.
    parts : tuple of Leaf
        What is left of it, numbered later.
    steps : tuple of Step
        The proof of all this.
    used : tuple of int
        Chargers that the relaxed optimum uses most, enough for the least number of stops.
    point : RelaxedPoint or None
        Relaxed optimum of a fixed subset.
    programs : int
        Cone programs solved.
    """

    leaf: Leaf
    bound: float
    closed: bool
    infeasible: bool
    how: Branch | None
    parts: tuple[Leaf, ...]
    steps: tuple[Step, ...]
    used: Subset
    point: RelaxedPoint | None
    programs: int


def make_roots(n_chargers: int) -> tuple[Leaf, ...]:
    """Return the family of all subsets as the only root.

    Examples
    --------
    >>> make_roots(2)[0].undecided
    (0, 1)
    """
    return (Leaf((), tuple(range(n_chargers)), -inf, None, (0, n_chargers)),)


def examine(
    make: Callable[[Subset, Subset], Instance], leaf: Leaf, cutoff: float, deadline: float = inf
) -> Examined:
    """Bound a leaf, shrink its box and cut it.

    Parameters
    ----------
    make : callable
        Instance of used and undecided chargers.
    leaf : Leaf
        The leaf.
    cutoff : float
        Cost below which plans matter [currency].
    deadline : float
        ``time.perf_counter()`` from which on no further program is begun [s].

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> trip = load_trip("paper-400km")
    >>> make = lambda used, maybe: make_instance(trip, used, undecided=maybe)
    >>> done = examine(make, make_roots(3)[0], cutoff=400.0)
    >>> [part.count for part in done.parts]  # one stop or more; none is infeasible by then
    [(0, 0), (1, 3)]
    """
    instance = make(leaf.subset, leaf.undecided)
    box = leaf.start(instance)
    done = tighten(
        instance,
        box,
        cutoff,
        bound=leaf.bound,
        fresh=leaf.box is None,
        whole=not leaf.halved,
        deadline=deadline,
        known=leaf.known,
    )
    parts: tuple[Leaf, ...] = ()
    shrunk = any(step.kind == "shrink" for step in done.steps)
    limit = min(leaf.limit, cutoff) if shrunk else leaf.limit
    bound = min(done.bound, limit)
    if not done.closed and done.how is not None:
        parts = cut(instance, replace(leaf, bound=bound, limit=limit), done.box, done.how)
    return Examined(
        leaf=leaf,
        bound=bound,
        closed=done.closed,
        infeasible=done.closed and limit == inf and done.proved < cutoff,
        how=None if done.closed else done.how,
        parts=parts,
        steps=done.steps,
        used=_likely(instance, done.box, done.used),
        point=done.point,
        programs=done.programs,
    )


def cut_unbounded(
    make: Callable[[Subset, Subset], Instance], leaf: Leaf, cutoff: float
) -> Examined | None:
    """Cut a small family without bounding it, or return None if it should be bounded.

    Parameters
    ----------
    make : callable
        Instance of used and undecided chargers.
    leaf : Leaf
        The leaf.
    cutoff : float
        Cost below which plans matter [currency]; ``inf`` without a plan: then bounds are
        wanted, because their optima suggest stops.

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> trip = load_trip("paper-400km")
    >>> make = lambda used, maybe: make_instance(trip, used, undecided=maybe)
    >>> done = cut_unbounded(make, Leaf((0,), (1, 2), 250.0, None, (2, 2)), cutoff=300.0)
    >>> [(part.subset, part.undecided) for part in done.parts]
    [((0, 1), ()), ((0,), (2,))]
    """
    missing = cutoff - leaf.bound
    if not leaf.undecided or leaf.n_subsets > FEW_SUBSETS:
        return None
    if not NEAR * abs(cutoff) < missing < inf:
        return None
    instance = make(leaf.subset, leaf.undecided)
    box = leaf.start(instance)
    try:
        BoxProof(instance, box, cutoff).check()
    except Closed:  # it holds nothing: to be closed, not cut
        return None
    how = Branch("use", stop=int(np.flatnonzero(box.optional)[0]))
    return Examined(
        leaf=leaf,
        bound=leaf.bound,
        closed=False,
        infeasible=False,
        how=how,
        parts=cut(instance, leaf, box, how),
        steps=(),
        used=(),
        point=None,
        programs=0,
    )


def cut(instance: Instance, leaf: Leaf, box: Box, how: Branch) -> tuple[Leaf, ...]:
    """Return both parts of a leaf.

    Parameters
    ----------
    instance : Instance
        Of the leaf.
    leaf : Leaf
        The leaf, with its bound.
    box : Box
        What is left of its box.
    how : Branch
        Where to cut.
    """
    out = []
    for first, part in zip((True, False), branch(box, how), strict=True):
        subset, undecided = leaf.subset, leaf.undecided
        if how.kind == "use":
            charger = instance.stops[how.stop].charger
            undecided = tuple(c for c in undecided if c != charger)
            if first:
                subset = tuple(sorted((*subset, charger)))
        if undecided and part.count[1] == len(subset):  # no further stop is allowed
            while part.optional.any():
                part = decide(part, int(np.flatnonzero(part.optional)[0]), False)
            undecided = ()
        out.append(
            Leaf(
                subset,
                undecided,
                leaf.bound,
                part,
                part.count,
                part=int(not first),
                limit=leaf.limit,
                halved=leaf.halved or how.kind == "halve",
            )
        )
    return tuple(out)


def _likely(instance: Instance, box: Box, used: npt.NDArray[np.float64]) -> Subset:
    """Chargers of the leaf's stops that are used by more than half, at least as many as needed."""
    if used.size != len(instance.stops):
        return instance.subset
    need = max(box.count[0], 1)
    order = np.argsort(-used, kind="stable")
    picked = [i for place, i in enumerate(order) if used[i] > 0.5 or place < need]
    return tuple(sorted(instance.stops[i].charger for i in picked))
