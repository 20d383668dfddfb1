"""Owns the account of all 2^N subsets: each ends in exactly one row, with the reason."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from enum import Enum
from math import inf

from enumerate.subset import Subset

__all__ = ["Ledger", "Outcome", "Row"]


class Outcome(Enum):
    """How a subset ended; the value is the sentence a user sees."""

    PLANNED = "planned"
    BOUNDED = "cannot be better"
    INFEASIBLE = "proved infeasible"
    UNPROVED = "not settled"


@dataclass(frozen=True)
class Row:
    """One subset's end.

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
    seconds : float
        Time spent on it [s].
    """

    subset: Subset
    outcome: Outcome
    cost: float = inf
    lower_bound: float = -inf
    reason: str = ""
    programs: int = 0
    seconds: float = 0.0


@dataclass(frozen=True)
class Ledger:
    """All rows, one per subset.

    Parameters
    ----------
    n_chargers : int
        Number of chargers N.
    rows : tuple of Row
        Exactly 2^N rows.

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
        seen = {row.subset for row in self.rows}
        valid = all(
            list(s) == sorted(set(s)) and all(0 <= i < self.n_chargers for i in s) for s in seen
        )
        if not valid or len(seen) != len(self.rows) or len(seen) != 2**self.n_chargers:
            raise ValueError(
                f"the ledger accounts for {len(seen)} subsets in {len(self.rows)} rows, "
                f"not for each of the {2**self.n_chargers} once"
            )

    @property
    def lower_bound(self) -> float:
        """Least bound of any subset [currency]; a subset proved infeasible counts as ``inf``."""
        return min(
            inf if row.outcome is Outcome.INFEASIBLE else row.lower_bound for row in self.rows
        )

    def counts(self) -> dict[str, int]:
        """Return the number of subsets by outcome, as in the JSON output."""
        number = Counter(row.outcome for row in self.rows)
        return {
            "total": len(self.rows),
            "planned": number[Outcome.PLANNED],
            "bounded": number[Outcome.BOUNDED],
            "infeasible": number[Outcome.INFEASIBLE],
            "unproved": number[Outcome.UNPROVED],
        }
