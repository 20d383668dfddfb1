"""Owns how plans are kept between runs: plain numbers out, a ``PlanReport`` back in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields
from math import isfinite
from typing import Any

import numpy as np

from relax.report import ChargeTrace, Deviation, DriveTrace, PlanReport, StopReport

__all__ = ["plain", "report_from", "report_to"]

DIGITS = 7
"""Significant digits kept of every number."""


def plain(value: Any) -> Any:
    """Return a value of JSON types; infinities become None.

    Examples
    --------
    >>> plain({"a": np.array([1.0, float("inf")]), (1, 2): 0.5})
    {'a': [1.0, None], '1 2': 0.5}
    """
    if isinstance(value, Mapping):
        return {
            " ".join(map(str, k)) if isinstance(k, tuple) else str(k): plain(v)
            for k, v in value.items()
        }
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, np.ndarray):
        return [plain(v) for v in value.tolist()]
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}") if isfinite(value) else None
    return value


def report_to(report: PlanReport) -> dict[str, Any]:
    """Return a plan as plain numbers."""
    found = plain(asdict(report))
    assert isinstance(found, dict)
    return found


def report_from(kept: Mapping[str, Any]) -> PlanReport:
    """Return the plan of plain numbers.

    Raises
    ------
    TypeError
        A field is missing or unknown: the numbers are of another version.
    """
    given = dict(kept)
    given["stops"] = tuple(StopReport(**s) for s in kept["stops"])
    given["drive"] = _trace(DriveTrace, kept["drive"])
    given["charge"] = tuple(_trace(ChargeTrace, c) for c in kept["charge"])
    given["deviation"] = Deviation(**kept["deviation"])
    return PlanReport(**given)


def _trace(kind: Any, kept: Mapping[str, Any]) -> Any:
    arrays = {k: np.array(v) if isinstance(v, list) else v for k, v in kept.items()}
    unknown = set(arrays) ^ {f.name for f in fields(kind)}
    if unknown:
        raise TypeError(f"{kind.__name__}: {', '.join(sorted(unknown))}")
    return kind(**arrays)
