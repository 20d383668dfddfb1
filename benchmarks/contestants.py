"""Owns who takes part in the comparison: names, what each needs, which version it is.

What is not installed does not take part. Knows nothing of how a solver is called.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from math import nan
from typing import Any

from benchmarks.runs import (
    ASKED_GAP,
    Answer,
    Limits,
    run_bonmin,
    run_driver,
    run_dynamic,
    run_enumerated,
    run_ours,
    run_scip,
)
from benchmarks.sources import code_digest
from relax.trip import Trip

__all__ = ["CONTESTANTS", "FAST", "OURS", "Contestant", "find"]


@dataclass(frozen=True)
class Contestant:
    """A solver as it takes part.

    Parameters
    ----------
    name : str
        In results and on the command line.
    words : str
        What it is, for the report.
    run : callable
        Plans a trip within limits.
    needs : tuple of str
        Modules that must be there.
    root : str
        Module whose code decides the result, with what it imports.
    counted : tuple of str
        Packages of ours that count as its code.
    packages : tuple of str
        Installed packages whose version counts.
    kind : str
        ``ours``, ``peer`` or ``rule`` (no optimisation).
    needs_our_time : bool
        Its limit is our time, so ours must have run.
    gap : float
        Relative gap that it is asked to prove.
    """

    name: str
    words: str
    run: Callable[[Trip, Limits], Answer]
    needs: tuple[str, ...]
    root: str
    counted: tuple[str, ...]
    packages: tuple[str, ...]
    kind: str = "peer"
    needs_our_time: bool = False
    gap: float = nan

    @property
    def available(self) -> bool:
        """Whether everything it needs is there."""
        return all(_exists(module) for module in self.needs)

    @property
    def version(self) -> str:
        """Versions of its packages and a digest of its code; comments do not count."""
        parts = [f"{name}={_version(name)}" for name in self.packages]
        return " ".join([*parts, f"code={code_digest(self.root, self.counted)}"])


@cache
def _exists(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:
        return False


@cache
def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "none"


OURS = "evrelax-1%"
"""The contestant whose proof others are compared with."""
FAST = "evrelax"
"""The contestant that plans without a gap being asked for."""


def _us(name: str, words: str, gap: float | None) -> Contestant:
    return Contestant(
        name,
        words,
        partial(run_ours, gap=gap),
        (),
        "enumerate.search",
        ("relax", "enumerate"),
        ("clarabel", "numpy"),
        "ours",
        gap=nan if gap is None else gap,
    )


def _peer(
    name: str,
    words: str,
    run: Callable[[Trip, Limits], Answer],
    module: str,
    packages: tuple[str, ...],
    **more: Any,
) -> Contestant:
    home = "benchmarks.reference"
    root = f"{home}.{module}"
    return Contestant(name, words, run, (root, *packages), root, (home,), packages, **more)


def _enumeration(
    solver: str, name: str, starts: str, multi_start: bool, integrator: str = "midpoint"
) -> Contestant:
    words = f"{solver.upper()} for every choice of stops, {starts}"
    run = partial(run_enumerated, solver=solver, multi_start=multi_start, integrator=integrator)
    return _peer(name, words, run, "search", ("casadi",))


CONTESTANTS: tuple[Contestant, ...] = (
    _peer("driver-plain", "a driver with rules, no preheating", partial(run_driver, rules="PLAIN"),
          "driver", (), kind="rule"),
    _peer("driver-preheating", "a driver with rules who preheats",
          partial(run_driver, rules="PREHEATING"), "driver", (), kind="rule"),
    _us(FAST, "evrelax, no gap asked for", None),
    _us(OURS, f"evrelax, a gap of {100 * ASKED_GAP:g} % asked for", ASKED_GAP),
    _enumeration("ipopt", "ipopt", "one start each", False),
    _enumeration("fatrop", "fatrop", "one start each", False),
    _enumeration("ipopt", "ipopt-rk4", "one start each, explicit Runge-Kutta", False, "rk4"),
    _enumeration("ipopt", "ipopt-multistart", "up to 12 starts each", True),
    _enumeration("fatrop", "fatrop-multistart", "up to 12 starts each", True),
    _peer("bonmin", "BONMIN, binaries for the stops", partial(run_bonmin, integrator="midpoint"),
          "bonmin", ("casadi",)),
    _peer("bonmin-rk4", "BONMIN on explicit Runge-Kutta steps, as in the paper",
          partial(run_bonmin, integrator="rk4"), "bonmin", ("casadi",)),
    _peer("dynamic", "dynamic programming over all choices of stops", run_dynamic, "dynamic", ()),
    _peer("scip-our-time", f"SCIP asked for {100 * ASKED_GAP:g} %, stopped at our finishing time",
          partial(run_scip, ours=True), "scip", ("pyscipopt",), needs_our_time=True),
    _peer("scip", f"SCIP asked for {100 * ASKED_GAP:g} %, until the time limit",
          partial(run_scip, ours=False), "scip", ("pyscipopt",)),
)  # fmt: skip
"""All that is known, fast ones first; ``available`` says which are installed."""


def find(names: list[str]) -> tuple[Contestant, ...]:
    """Return the contestants of these names, all that are installed without names.

    Raises
    ------
    ValueError
        A name is unknown, or what it needs is not installed.

    Examples
    --------
    >>> [c.name for c in find(["evrelax"])]
    ['evrelax']
    """
    if not names:
        return tuple(c for c in CONTESTANTS if c.available)
    known = {c.name: c for c in CONTESTANTS}
    for name in names:
        if name not in known:
            raise ValueError(f"unknown solver {name!r}; known: {', '.join(known)}")
        if not known[name].available:
            raise ValueError(f"{name} needs {', '.join(known[name].needs)}")
    return tuple(c for c in CONTESTANTS if c.name in names)
