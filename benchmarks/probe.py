"""Owns watching the packages from outside: where the time goes, and what Clarabel itself reports.

Functions are replaced wherever a module of ours holds them, for as long as a ``with`` block
lasts; nothing in the packages changes. Times are exclusive: what a watched function spends in
another one counts there. Not for several threads.
"""

from __future__ import annotations

import sys
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import wraps
from importlib import import_module
from time import perf_counter
from types import ModuleType
from typing import Any

__all__ = ["PARTS", "Probe", "watch"]

PARTS: Mapping[str, tuple[str, ...]] = {
    "assembly": (
        "relax.instance.make_drive",
        "relax.instance.make_instance",
        "relax.relaxation.build_relaxation",
        "relax.program.add_cutoff",
        "relax.relaxed_point.unpack_point",
    ),
    "reach": ("relax.reach.make_box", "relax.reach.propagate"),
    "solve": (
        "relax.solve.solve_cone",
        "relax.solve.solve_qp",
        "relax.solve.solve_objective",
    ),
    "certify": ("relax.certify.certify_lower_bound", "relax.certify.certify_infeasible"),
    "refine": (
        "relax.starts.best_start",
        "relax.starts.split_starts",
        "relax.refinement.refine",
        "relax.refinement.refine_best",
    ),
    "replay": ("relax.execute.execute", "relax.replay.replay", "relax.report.make_report"),
}
"""Functions by the part of the work they are; what none of them does is the search itself."""
OURS = ("relax", "enumerate")


@dataclass
class Probe:
    """What was seen.

    Parameters
    ----------
    own_s : dict
        Time by function, without what other watched functions spent in it [s].
    calls : Counter
        Calls by function.
    reported_s : list of float
        Clarabel's own time of every solve, its setup included [s].
    kept : dict of str to list
        Arguments and result of every call of the functions asked for.
    """

    own_s: defaultdict[str, float] = field(default_factory=lambda: defaultdict(float))
    calls: Counter[str] = field(default_factory=Counter)
    reported_s: list[float] = field(default_factory=list)
    kept: dict[str, list[tuple[tuple[Any, ...], Any]]] = field(default_factory=dict)
    _inner_s: list[float] = field(default_factory=list)

    @property
    def programs(self) -> int:
        """Programs handed to a solver."""
        return sum(self.calls[name] for name in PARTS["solve"])

    def parts_s(self) -> dict[str, float]:
        """Return the time by part [s]."""
        return {part: sum(self.own_s[name] for name in names) for part, names in PARTS.items()}

    def wrap(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function that does the same and is counted under a name."""

        @wraps(function)
        def watched(*args: Any, **keywords: Any) -> Any:
            self._inner_s.append(0.0)
            begin = perf_counter()
            try:
                result = function(*args, **keywords)
            finally:
                spent = perf_counter() - begin
                self.own_s[name] += spent - self._inner_s.pop()
                self.calls[name] += 1
                if self._inner_s:
                    self._inner_s[-1] += spent
            if name in self.kept:
                self.kept[name].append((args, result))
            return result

        return watched


class _Clarabel:
    """The module ``clarabel``, its solver reporting every time to a probe."""

    def __init__(self, module: ModuleType, times: list[float]) -> None:
        self._module, self._times = module, times

    def __getattr__(self, name: str) -> Any:
        return getattr(self._module, name)

    def DefaultSolver(self, *data: Any) -> Any:
        """Return a solver; its ``solve`` notes the time that it reports."""
        solver, times = self._module.DefaultSolver(*data), self._times

        class Reporting:
            def solve(self) -> Any:
                solution = solver.solve()
                times.append(float(solution.solve_time))
                return solution

            def update(self, **changes: Any) -> None:
                solver.update(**changes)

        return Reporting()


def _modules() -> Iterator[ModuleType]:
    for name, module in list(sys.modules.items()):
        if module is not None and name.split(".", 1)[0] in OURS:
            yield module


def _swap(pairs: Mapping[int, Any]) -> None:
    """Replace objects, named by their identity, in every module of ours."""
    for module in _modules():
        for name, value in list(vars(module).items()):
            if id(value) in pairs:
                setattr(module, name, pairs[id(value)])


@contextmanager
def watch(names: tuple[str, ...] | None = None, keep: tuple[str, ...] = ()) -> Iterator[Probe]:
    """Watch functions of the packages while the block lasts.

    Parameters
    ----------
    names : tuple of str, optional
        Full names; those of ``PARTS`` by default.
    keep : tuple of str
        Those of them whose arguments and results are wanted.

    Raises
    ------
    AttributeError
        A function of that name is not there any more.

    Examples
    --------
    >>> from enumerate import plan
    >>> from benchmarks.cases import SMOKE
    >>> with watch() as probe:
    ...     result = plan(SMOKE.load())
    >>> probe.programs == len(probe.reported_s) > 0
    True
    >>> 0.0 < sum(probe.parts_s().values()) <= result.timings_s["total"] * 1.01
    True
    """
    probe = Probe(kept={name: [] for name in keep})
    swapped: list[tuple[Any, Any]] = []
    for name in names if names is not None else sum(PARTS.values(), ()):
        home, function = name.rsplit(".", 1)
        import_module(home)
        original = getattr(sys.modules[home], function)
        swapped.append((original, probe.wrap(name, original)))
    solve = sys.modules["relax.solve"]
    clarabel = vars(solve)["clarabel"]
    _swap({id(original): replacement for original, replacement in swapped})
    vars(solve)["clarabel"] = _Clarabel(clarabel, probe.reported_s)
    try:
        yield probe
    finally:
        vars(solve)["clarabel"] = clarabel
        _swap({id(replacement): original for original, replacement in swapped})
