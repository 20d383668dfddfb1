"""Owns stage steps as a table of numbers: one row per step, beside all their dual vectors.

Thousands of steps make one array and not thousands of them. What is read is checked for
its types and sizes; whether a step can be done is not asked here.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from enumerate.stage_parts import StageStep
from relax.branch import Target

__all__ = ["COLUMNS", "from_table", "to_table"]

Array = npt.NDArray[np.float64]

KINDS = (
    "open", "cost", "empty", "shrink", "propagate", "halve", "narrow", "split", "plane", "closing",
)  # fmt: skip
"""Kinds by their number in the table."""
COLUMNS = (
    "kind", "at", "dual entries", "slope energy", "slope temperature", "state energy",
    "state temperature", "target", "sign", "value", "ray",
)  # fmt: skip
WHOLE = [COLUMNS.index(name) for name in ("kind", "at", "dual entries", "target", "sign", "ray")]
LARGEST = float(2**53)


def to_table(steps: Sequence[StageStep]) -> tuple[Array, list[Target]]:
    """Return steps as a table, without their dual vectors, and the targets that it numbers.

    Parameters
    ----------
    steps : sequence of StageStep
        In order.

    Returns
    -------
    table : ndarray, shape (n, len(COLUMNS))
        ``dual entries`` is the length of a dual vector, ``target`` -1 without one.
    targets : list of Target
        By number.

    Examples
    --------
    >>> table, targets = to_table([StageStep("open", 3), StageStep("split", 1, value=40.0)])
    >>> table.shape, targets
    ((2, 11), [])
    """
    numbers: dict[Target, int] = {}
    rows = []
    for s in steps:
        place = -1 if s.target is None else numbers.setdefault(s.target, len(numbers))
        rows.append(
            (KINDS.index(s.kind), s.at, s.dual.size, *s.slope, *s.state, place, s.sign, s.value,
             s.ray)
        )  # fmt: skip
    table = np.array(rows, dtype=np.float64).reshape(len(rows), len(COLUMNS))
    return table, list(numbers)


def from_table(
    table: npt.NDArray[np.float64], targets: Sequence[Target], duals: Array
) -> tuple[StageStep, ...]:
    """Return the steps of a table.

    Parameters
    ----------
    table : ndarray, shape (n, len(COLUMNS))
        As ``to_table`` returns it, or anything else.
    targets : sequence of Target
        By number.
    duals : ndarray
        All dual vectors, one after the other.

    Raises
    ------
    ValueError
        Numbers that are whole are not, or name what there is not.

    Examples
    --------
    >>> step = StageStep("cost", 3, np.ones(2), (0.5, 0.0))
    >>> again = from_table(*to_table([step]), np.ones(2))[0]
    >>> again.kind, again.at, again.slope, again.dual.tolist()
    ('cost', 3, (0.5, 0.0), [1.0, 1.0])
    """
    if table.ndim != 2 or table.shape[1] != len(COLUMNS):
        raise ValueError("its table of stages has other columns")
    whole = table[:, WHOLE]
    if not np.all((np.abs(whole) <= LARGEST) & (whole == np.round(whole))):
        raise ValueError("its table of stages holds fractions of whole numbers")
    kind, _, size, target, _, ray = whole.T
    for name, values, least, most in (
        ("kinds", kind, 0, len(KINDS) - 1),
        ("sizes", size, 0, duals.size),
        ("targets", target, -1, len(targets) - 1),
        ("flags", ray, 0, 1),
    ):
        if not np.all((values >= least) & (values <= most)):
            raise ValueError(f"its table of stages holds {name} that there are not")
    ends = np.cumsum(size).astype(np.int64).tolist()
    if (ends[-1] if ends else 0) != duals.size:
        raise ValueError("its dual vectors do not have the sizes stated")
    known = [*targets, None]  # -1 is the last
    out = []
    for first, last, row in zip([0, *ends], ends, table.tolist(), strict=False):
        number, at, _, slope_e, slope_t, state_e, state_t, place, sign, value, is_ray = row
        out.append(
            StageStep(
                KINDS[int(number)],  # type: ignore[arg-type]
                int(at), duals[first:last], (slope_e, slope_t), (state_e, state_t),
                known[int(place)], int(sign), value, bool(is_ray),
            )
        )  # fmt: skip
    return tuple(out)
