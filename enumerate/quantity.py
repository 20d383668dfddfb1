"""Owns which entries of a box a step of a proof may speak of, and whose columns bound them.

Knows nothing of proofs, graphs and solvers.
"""

from __future__ import annotations

from relax.box import Box
from relax.branch import Target

__all__ = ["COLUMNS", "is_quantity"]

COLUMNS = {
    "charge": "charge", "stay": "dwell", "dwell": "dwell", "temperature": "temperature",
    "stop_temperature": "border",
}  # fmt: skip
"""Intervals that a step may shrink, and the variables of the relaxation that they bound."""


def is_quantity(target: Target | None, box: Box) -> bool:
    """Return whether a target is an entry of the box, with the variables that belong to it.

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> from relax.reach import make_box
    >>> box = make_box(make_instance(load_trip("paper-400km"), (1,)))
    >>> [is_quantity(Target("charge", i, "charge"), box) for i in (0, 1, -1)]
    [True, False, False]
    >>> is_quantity(Target("charge", 0, "dwell"), box)  # bounds of another quantity
    False
    """
    if target is None or COLUMNS.get(target.name) != target.variable:
        return False
    shape = getattr(box, target.name).lo.shape
    at = target.index if isinstance(target.index, tuple) else (target.index,)
    return len(at) == len(shape) and all(0 <= i < n for i, n in zip(at, shape, strict=True))
