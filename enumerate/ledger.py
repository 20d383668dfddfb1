"""Owns the account of all 2^N subsets: each ends in exactly one row, with the reason.

A row speaks of one subset, or of a family: some chargers used, some undecided.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from enum import Enum
from math import comb, inf

from enumerate.subset import Subset
from enumerate.table import counted

__all__ = ["REFUSED", "Ledger", "Outcome", "Row"]

REFUSED = "plan refused in replay"
"""How the reason of a row begins whose plan did not hold when it was driven."""


class Outcome(Enum):
    """How a subset ended; the value is the sentence a user sees."""

    PLANNED = "planned"
    BOUNDED = "cannot be better"
    INFEASIBLE = "proved infeasible"
    UNPROVED = "not settled"


@dataclass(frozen=True)
class Row:
    """The end of one subset, or of a family of subsets.

    Parameters
    ----------
    subset : tuple of int
        Used chargers.
    outcome : Outcome
        How it ended.
    cost : float
        Cost of its best plan on the transcription, ``inf`` without one [currency].
    lower_bound : float
        Certified bound of the transcription, ``-inf`` without one, ``inf`` if
        proved infeasible [currency].
    reason : str
        Why, for people.
    programs : int
        Programs solved for it.
    undecided : tuple of int
        Chargers that may be used besides: then the row speaks of all these subsets.
    count : tuple of int or None
        Least and largest number of stops of a family.
    without : tuple of tuple of int
        Members of the family that have rows of their own.
    """

    subset: Subset
    outcome: Outcome
    cost: float = inf
    lower_bound: float = -inf
    reason: str = ""
    programs: int = 0
    undecided: Subset = ()
    count: tuple[int, int] | None = None
    without: tuple[Subset, ...] = ()

    @property
    def size(self) -> int:
        """Number of subsets the row speaks of.

        Examples
        --------
        >>> Row((0,), Outcome.BOUNDED, undecided=(1, 2), count=(2, 3)).size
        3
        """
        least, most = self.count or (0, len(self.subset) + len(self.undecided))
        used, free = len(self.subset), len(self.undecided)
        sizes = range(max(least - used, 0), min(most - used, free) + 1)
        return sum(comb(free, k) for k in sizes) - len(self.without)

    def holds(self, subset: Subset) -> bool:
        """Return whether the row speaks of a subset."""
        chosen = set(subset)
        least, most = self.count or (0, len(subset))
        return (
            set(self.subset) <= chosen <= {*self.subset, *self.undecided}
            and least <= len(chosen) <= most
            and tuple(subset) not in self.without
        )


@dataclass(frozen=True)
class Ledger:
    """All rows.

    Parameters
    ----------
    n_chargers : int
        Number of chargers N.
    rows : tuple of Row
        Their sizes add up to 2^N, and no subset is in two of them.

    Raises
    ------
    ValueError
        A subset is missing or appears twice.

    Examples
    --------
    >>> ledger = Ledger(1, (Row((), Outcome.INFEASIBLE), Row((0,), Outcome.PLANNED, 3.0, 2.0)))
    >>> ledger.counts()["planned"], ledger.lower_bound
    (1, 2.0)
    """

    n_chargers: int
    rows: tuple[Row, ...]

    def __post_init__(self) -> None:
        """Check that every subset is accounted for once."""
        n = self.n_chargers
        for row in self.rows:
            chosen = (*row.subset, *row.undecided)
            valid = list(row.subset) == sorted(row.subset) and len(set(chosen)) == len(chosen)
            if not valid or not all(0 <= i < n for i in chosen) or row.size < 0:
                raise ValueError(
                    f"the ledger accounts for chargers {chosen} of {n}, counted from 0, in one row"
                )
        total = sum(row.size for row in self.rows)
        if total != 2**n or _overlap(self.rows, n):
            raise ValueError(
                f"the ledger accounts for {counted(total, 'choice')} of stops in "
                f"{counted(len(self.rows), 'row')}, not for each of the {2**n} once"
            )

    @property
    def lower_bound(self) -> float:
        """Least bound of any subset [currency]; a subset proved infeasible counts as ``inf``."""
        return min(
            inf if row.outcome is Outcome.INFEASIBLE else row.lower_bound for row in self.rows
        )

    def counts(self) -> dict[str, int]:
        """Return the number of subsets by outcome, as in the JSON output."""
        number: Counter[Outcome] = Counter()
        for row in self.rows:
            number[row.outcome] += row.size
        return {
            "total": number.total(),
            "planned": number[Outcome.PLANNED],
            "bounded": number[Outcome.BOUNDED],
            "infeasible": number[Outcome.INFEASIBLE],
            "unproved": number[Outcome.UNPROVED],
        }


def _overlap(rows: tuple[Row, ...], n: int) -> bool:
    """Return whether some subset is in two rows."""
    single = {row.subset for row in rows if not row.undecided}
    families = [row for row in rows if row.undecided]
    if len(single) + len(families) != len(rows):
        return True
    if any(family.holds(subset) for family in families for subset in single):
        return True
    masks = [
        (sum(1 << i for i in r.subset), sum(1 << i for i in (*r.subset, *r.undecided)), r)
        for r in families
    ]
    for place, (on_a, all_a, a) in enumerate(masks):
        for on_b, all_b, b in masks[:place]:
            if on_a & ~all_b or on_b & ~all_a:
                continue  # a charger that one uses is left out by the other
            used, free = on_a | on_b, all_a & all_b
            (lo_a, hi_a), (lo_b, hi_b) = a.count or (0, n), b.count or (0, n)
            least = max(lo_a, lo_b, used.bit_count())
            if least <= min(hi_a, hi_b, free.bit_count()):
                return True
    return False
