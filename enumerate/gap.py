"""Owns every tolerance and every comparison of objective values. Nothing else compares costs."""

from __future__ import annotations

from math import inf

__all__ = [
    "DEFAULT_GAP",
    "closing_cost",
    "is_close",
    "is_closed",
    "is_proved",
    "may_gain",
    "relative_gap",
]

DEFAULT_GAP = 0.01
"""Relative gap below which a plan is called optimal unless the caller asks otherwise."""
CLOSE = 0.01
"""Relative distance to the best plan within which a subset gets further starts: local
optima of trial trips differed by up to 1 %."""

OUT_OF_REACH = 0.5
"""Share of the gap asked for that must be left on the transcription. Of the 1 % asked for on
``random/05`` 0.03 % is: after 7,200 programs the bound was 0.5 % below the transcribed cost."""


def relative_gap(cost: float, lower_bound: float) -> float:
    """Return (cost - bound) / max(abs(cost), 1), not below 0; ``inf`` without plan or bound.

    Examples
    --------
    >>> relative_gap(200.0, 198.0)
    0.01
    >>> relative_gap(200.0, float("-inf"))
    inf
    """
    if not (-inf < lower_bound and cost < inf):
        return inf
    return max(0.0, cost - lower_bound) / max(abs(cost), 1.0)


def is_closed(lower_bound: float, cost: float) -> bool:
    """Return whether a subset with this bound cannot be better than a plan of this cost.

    Examples
    --------
    >>> is_closed(201.0, 200.0), is_closed(199.0, 200.0)
    (True, False)
    """
    return lower_bound >= cost


def is_close(cost: float, best: float, share: float = CLOSE) -> bool:
    """Return whether a local optimum is near enough to the best, by a share, for further starts.

    Examples
    --------
    >>> is_close(201.0, 200.0), is_close(210.0, 200.0)
    (True, False)
    """
    return cost <= best + share * max(abs(best), 1.0)


def may_gain(lower_bound: float, best: float, share: float) -> bool:
    """Return whether a subset with this bound may be cheaper than the best plan by a share.

    Examples
    --------
    >>> may_gain(190.0, 200.0, 0.02), may_gain(197.0, 200.0, 0.02)
    (True, False)
    """
    return best == inf or lower_bound < best - share * max(abs(best), 1.0)


def is_proved(cost: float, transcribed: float, lower_bound: float, gap: float) -> bool:
    """Return whether a plan is proved to be within a gap of the best one.

    Bounds are of the transcription, costs of the drive: the gap between them says nothing
    below the difference between both costs of the plan itself, whichever is lower.

    Parameters
    ----------
    cost, transcribed : float
        Of the plan, as driven and on the transcription [currency].
    lower_bound : float
        Of every plan on the transcription [currency].
    gap : float
        Relative gap.

    Examples
    --------
    >>> is_proved(200.0, 200.1, 198.0, 0.01), is_proved(200.0, 204.0, 198.0, 0.01)
    (True, False)
    """
    apart = abs(cost - transcribed) / max(abs(cost), 1.0)
    return relative_gap(cost, lower_bound) <= gap * (1.0 + 1e-9) and apart <= gap


def closing_cost(cost: float, gap: float, transcribed: float = inf) -> float:
    """Return the cost from which on a bound closes a subset: cost less the relative gap.

    Nothing closes without a plan. Bounds are of the transcription. Where the drive costs so much
    more that no bound, or hardly one, comes within the gap, what is within the gap of the
    transcribed cost is closed: a finer grid would help, more proof would not.

    Examples
    --------
    >>> closing_cost(200.0, 0.01), closing_cost(200.0, 0.01, transcribed=190.0)
    (198.0, 188.1)
    """
    if cost == inf:
        return inf
    driven = cost - gap * max(abs(cost), 1.0)
    if transcribed == inf:
        return driven
    share = gap * max(abs(transcribed), 1.0)
    return driven if driven <= transcribed - OUT_OF_REACH * share else transcribed - share
