"""Owns the account of the choices of stops as text: what each costs or is bounded by, and why.

Reads the ledger of a ``Result``; decides nothing. What is not known is shown as ``-``,
never as 0.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations
from math import inf, isfinite

from enumerate.gap import relative_gap
from enumerate.ledger import Outcome, Row
from enumerate.result import Result
from enumerate.subset import Subset
from enumerate.table import MISSING, NO_BREAK, counted, number, paragraph, percent, table, unbroken

__all__ = ["format_choices", "format_unused"]

MAX_ROWS = 16
"""Rows listed one by one; of more, the best ones and a line per outcome for the others."""
FEW_NAMES = 2
"""Up to this many undecided chargers are named."""
MANY_STOPS, MOST_CHANGES = 3, 2
"""Beside a plan of this many stops, others are named by their changes, up to so many of them."""
FEW_LEFT_OUT = 3
"""Up to this many chargers that a family leaves out are named."""
FEW_MEMBERS = 64
"""Up to this many choices of a family are looked through, to name a single one that is left."""


def _name(result: Result, row: Row, best: Row | None = None) -> str:
    """Return the stops a row speaks of: one choice, or a family of them with its size."""
    names = [unbroken(name) for name in result.chargers]
    members = _members(row) if row.undecided else [row.subset]
    if members is not None and len(members) == 1:
        return _beside(names, members[0], best) or _sum(names[i] for i in members[0]) or "no stop"
    free, used = len(row.undecided), len(row.subset)
    least, most = row.count or (0, used + free)
    least, most = max(least - used, 0), min(most - used, free)
    if least == most:
        many = "all" if least == free else f"{least} of"
    elif least == 0:
        many = "any of" if most == free else f"up to {most} of"
    else:
        many = f"at least {least} of" if most == free else f"{least} to {most} of"
    if free <= FEW_NAMES:
        which = f"{many} {', '.join(names[i] for i in row.undecided)}"
    else:
        which = f"{many} {free} {'others' if used else 'chargers'}"
        left = [n for i, n in zip(range(len(names)), names, strict=True) if not _may_use(row, i)]
        if len(left) > FEW_LEFT_OUT:
            which += f", {len(left)} left out"
        elif left:
            which += f", without {', '.join(left)}"
    choices = counted(row.size, "choice")
    if row.without:
        choices = "the other " + ("choice" if row.size == 1 else choices)
    return _sum([*(names[i] for i in row.subset), f"{which} ({choices})"])


def _sum(parts: Iterable[str]) -> str:
    """Return parts with plus signs, which begin a line rather than end one."""
    return f" +{NO_BREAK}".join(parts)


def _beside(names: list[str], subset: Subset, best: Row | None) -> str:
    """Return a choice by what it has more and less than the plan, if that is short; or nothing."""
    if best is None or len(best.subset) < MANY_STOPS or subset == best.subset:
        return ""
    less = [f"-{NO_BREAK}{names[i]}" for i in best.subset if i not in subset]
    more = [f"+{NO_BREAK}{names[i]}" for i in subset if i not in best.subset]
    if len(less) + len(more) > MOST_CHANGES:
        return ""
    return " ".join(["plan", *less, *more])


def _may_use(row: Row, charger: int) -> bool:
    """Return whether some choice of a row uses a charger."""
    return charger in row.subset or charger in row.undecided


def _members(row: Row) -> list[Subset] | None:
    """Return the choices a row speaks of, if they are few enough to look through."""
    if row.size + len(row.without) > FEW_MEMBERS:
        return None
    used = len(row.subset)
    least, most = row.count or (0, used + len(row.undecided))
    return [
        subset
        for size in range(max(least - used, 0), min(most - used, len(row.undecided)) + 1)
        for more in combinations(row.undecided, size)
        if (subset := tuple(sorted((*row.subset, *more)))) not in row.without
    ]


def _best_row(result: Result) -> Row | None:
    """Return the row of the reported plan."""
    if result.plan is None:
        return None
    stops = sorted(s.charger for s in result.plan.stops)
    for row in result.ledger.rows:
        if not row.undecided and sorted(result.chargers[i] for i in row.subset) == stops:
            return row
    return None


def _beaten(row: Row, best: Row | None) -> bool:
    """Return whether no plan of a row is better than the best, by any share."""
    return best is not None and row.lower_bound >= best.cost


def _saving(result: Result, rows: list[Row], best: Row | None) -> str:
    """Return how much cheaper than the plan those of some rows could be, by what is proved [%]."""
    bound = min(row.lower_bound for row in rows)
    if all(row.outcome is Outcome.INFEASIBLE for row in rows) or not isfinite(bound):
        return MISSING
    beaten = best is not None and bound >= best.cost
    return percent(0.0 if beaten else relative_gap(result.cost, bound), 2)


def _difference(row: Row, best: Row, unit: str = "") -> str:
    """Return by how much another choice's plan is dearer, or what makes it cheaper on the grid."""
    more = row.cost - best.cost
    which = "more" if more >= 0.0 else "less on the grid"
    return f"{number(abs(more), 2)}{unit} {which}"


def _why(row: Row, best: Row | None) -> str:
    """Return how a choice or family ended, beside the best plan."""
    if best is not None and row is best:
        return "the plan"
    if best is not None and row.outcome is Outcome.PLANNED:
        text = f"costs {_difference(row, best)}"
        return text if isfinite(row.lower_bound) else f"{text}; less is not ruled out"
    if best is not None and row.outcome is Outcome.BOUNDED:
        if _beaten(row, best):
            return f"costs at least {number(row.lower_bound - best.cost, 2)} more"
        return "cannot save more"
    reason = "" if row.undecided and row.outcome is Outcome.UNPROVED else row.reason
    return f"{row.outcome.value}: {reason}" if reason else row.outcome.value


def format_choices(result: Result) -> str:
    """Return the comparison of all choices of stops: cost or bound, and how each ended.

    Parameters
    ----------
    result : Result
        From ``plan``.

    Examples
    --------
    >>> from enumerate import plan
    >>> from relax import load_trip
    >>> result = plan(load_trip("paper-400km", overrides={"route.ambient_c": 10}))
    >>> "8 choices of stops: " in format_choices(result)
    True
    """
    best = _best_row(result)
    rows = sorted(
        result.ledger.rows,
        key=lambda r: (
            r is not best,
            r.cost,
            r.outcome is Outcome.INFEASIBLE,
            r.lower_bound if isfinite(r.lower_bound) else inf,
            len(r.subset),
        ),
    )
    shown = rows if len(rows) <= MAX_ROWS else rows[: MAX_ROWS - len(Outcome)]
    entries = [(_name(result, r, best), _why(r, best), [r]) for r in shown]
    entries += [
        (counted(_size(alike), "other choice"), said, alike)
        for said, alike in _kinds(result, rows[len(shown) :], best)
    ]
    columns = {
        "stops": [name for name, *_ in entries],
        f"plan\n{result.currency}": [number(min(r.cost for r in of), 2) for *_, of in entries],
        f"bound\n{result.currency}": [
            number(min(r.lower_bound for r in of), 2) for *_, of in entries
        ],
        "could\nsave %": [_saving(result, of, best) for *_, of in entries],
        "outcome": [said for _, said, _ in entries],
    }
    if best is None:
        del columns["could\nsave %"]
    if all(row.outcome is Outcome.INFEASIBLE for row in rows):
        columns = {head: columns[head] for head in ("stops", "outcome")}
    listed = table(list(columns), zip(*columns.values(), strict=True), words_last=True)
    notes = [
        f"{counted(_size(rows), 'choice')} of stops: "
        + ", ".join(f"{_size(r)} {said}" for said, r in _kinds(result, rows, best))
        + "."
    ]
    if result.programs:
        were = "program was" if result.programs == 1 else "programs were"
        notes.append(f"{result.programs} {were} solved for it.")
    if any(isfinite(r.cost) or isfinite(r.lower_bound) for r in rows):
        note = "Costs and bounds here are those of the transcription."
        if best is not None:
            note += " Could save: against the plan, at most."
            if any(row.cost < best.cost for row in rows):
                note += " Of those that cost less on the grid, the ones driven cost more."
        notes.append(note)
    return "\n".join([listed, *(paragraph("", note, 0) for note in notes)])


def _size(rows: list[Row]) -> int:
    """Return the number of choices that rows speak of."""
    return sum(row.size for row in rows)


def _kinds(result: Result, rows: list[Row], best: Row | None) -> list[tuple[str, list[Row]]]:
    """Return rows by outcome, with the words for it.

    What is only proved not to save more than some share is apart from what cannot be better.
    """
    found = []
    for outcome in Outcome:
        alike = [row for row in rows if row.outcome is outcome]
        closed = outcome is Outcome.BOUNDED and best is not None
        near = [row for row in alike if closed and not _beaten(row, best)]
        far = [row for row in alike if row not in near]
        if far:
            found.append((outcome.value, far))
        if near:
            found.append((f"cannot save more than {_saving(result, near, best)} %", near))
    return found


def format_unused(result: Result) -> str:
    """Return a line per charger that the plan does not use: what using it would cost.

    Parameters
    ----------
    result : Result
        From ``plan``; without a plan there is nothing to say.

    Examples
    --------
    >>> from enumerate import plan
    >>> from relax import load_trip
    >>> result = plan(load_trip("paper-400km", overrides={"route.ambient_c": 10}))
    >>> print(format_unused(result).splitlines()[0])
    not used  what plans with it cost
    """
    best = _best_row(result)
    if best is None:
        return ""
    unused = [i for i in range(len(result.chargers)) if i not in best.subset]
    if not unused or len(unused) > MAX_ROWS:
        return ""  # a line each would bury the rest
    lines = []
    for i in unused:
        rows = [r for r in result.ledger.rows if _may_use(r, i)]
        lines.append([result.chargers[i], _unused_reason(result, rows, best)])
    return table(["not used", "what plans with it cost"], lines, words_last=True)


def _unused_reason(result: Result, rows: list[Row], best: Row) -> str:
    """Return what is known of all choices with a charger; families may hold others besides."""
    planned = min((r for r in rows if r.cost < inf), key=lambda r: r.cost, default=None)
    if planned is not None:
        difference = _difference(planned, best, f" {result.currency}")
        return f"the best found {difference} ({_name(result, planned, best)})"
    if all(r.outcome is Outcome.INFEASIBLE for r in rows):
        return "every choice of stops with it is proved infeasible"
    least = min((r.lower_bound for r in rows if r.outcome is not Outcome.INFEASIBLE), default=-inf)
    if least >= best.cost:
        more = number(least - best.cost, 2)
        return f"at least {more} {result.currency} more"
    if not isfinite(least):
        return "none was found, and none is ruled out"
    share = percent(relative_gap(result.cost, least), 2)
    if all(r.outcome in (Outcome.BOUNDED, Outcome.INFEASIBLE) for r in rows):
        return f"at best {share} % less: proved"
    return f"none was found; up to {share} % less is not ruled out"
