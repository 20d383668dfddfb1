"""Owns the steps of a proof about one box: what each one shows, from a dual vector alone.

A step is a kind, a quantity and a dual vector. ``BoxProof.apply`` rebuilds what the
step speaks of, certifies it and changes box or bound; the same code runs while a
proof is found and while it is audited, so that a proof needs no trust in the solver
nor in the choice of its steps. Knows no solver.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from relax.box import Box
from relax.branch import Target, with_interval
from relax.certify import Infeasible, LowerBound, certify_infeasible, certify_lower_bound
from relax.instance import Instance
from relax.intervals import Interval
from relax.program import ConeProgram, add_cutoff
from relax.reach import propagate
from relax.relaxation import build_relaxation

__all__ = ["OBJECTIVE_SIZE", "BoxProof", "Closed", "Step"]

Array = npt.NDArray[np.float64]


OBJECTIVE_SIZE = 10.0
"""Weight of a quantity as an objective: the solver takes a tenth fewer iterations than with 1."""


class Closed(Exception):  # noqa: N818
    """The box holds no plan below the cutoff."""


@dataclass(frozen=True)
class Step:
    """One step of a proof.

    Parameters
    ----------
    kind : str
        ``"propagate"`` intervals, ``"relax"`` (bound the cost) or ``"shrink"`` (bound a quantity).
    dual : ndarray, shape (m,)
        Dual vector or ray, one entry per row of the step's program; empty for ``"propagate"``.
        In double precision: rounded to single, proofs near the cutoff took twice the steps.
    ray : bool
        Whether it is to show that the program has no point.
    target : Target or None
        The quantity of ``"shrink"``.
    sign : int
        1: its lower end, -1: its upper end.
    """

    kind: Literal["propagate", "relax", "shrink"]
    dual: Array = field(default_factory=lambda: np.zeros(0))
    ray: bool = False
    target: Target | None = None
    sign: int = 0


class BoxProof:
    """One box on its way to being closed: its bound, its present program, its steps.

    Parameters
    ----------
    instance : Instance
        Subset, or family of subsets, and grid.
    box : Box
        A valid box of it.
    cutoff : float
        Cost below which plans matter [currency].
    bound : float
        Lower bound known before [currency].

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> from relax.reach import make_box
    >>> instance = make_instance(load_trip("paper-400km"), (1,))
    >>> proof = BoxProof(instance, make_box(instance), cutoff=400.0)
    >>> proof.apply(Step("relax", np.zeros(proof.build().b.size)))
    >>> bool(np.isfinite(proof.bound)), len(proof.steps)  # what the box alone says
    (True, 1)
    """

    def __init__(self, instance: Instance, box: Box, cutoff: float, bound: float = -np.inf) -> None:
        self.instance, self.box, self.cutoff, self.bound = instance, box, cutoff, bound
        self.program: ConeProgram | None = None
        self.steps: list[Step] = []

    def build(self) -> ConeProgram:
        """Return the relaxation on the present box.

        Raises
        ------
        Closed
            The box is empty.
        """
        self.check()
        return build_relaxation(self.instance, self.box, lean=True)

    def check(self) -> None:
        """Raise ``Closed`` if the box is empty or holds no admissible number of stops."""
        optional, (least, most) = self.box.optional, self.box.count
        fixed = int(np.count_nonzero(~optional))
        if self.box.empty or fixed > most or optional.size < least or least > most:
            raise Closed

    def objective(self, target: Target, sign: int) -> ConeProgram:
        """Return the present program with a quantity as its objective, cost below the cutoff."""
        program = self.program
        assert program is not None, "relax before shrinking"
        columns = self.columns(target)
        q = np.zeros_like(program.q)
        q[columns] = sign * OBJECTIVE_SIZE * program.scale[columns]
        return replace(program, q=q, constant=0.0)

    def columns(self, target: Target) -> npt.NDArray[np.int64]:
        """Return the columns that add up to a quantity."""
        assert self.program is not None
        return np.atleast_1d(self.program.variables[target.variable][target.index]).ravel()

    def apply(self, step: Step, program: ConeProgram | None = None) -> None:
        """Do a step: certify what it claims, change box or bound, and keep it.

        Parameters
        ----------
        step : Step
            The step.
        program : ConeProgram, optional
            Its program if it is at hand; built anew otherwise.

        Raises
        ------
        Closed
            Nothing is left below the cutoff.
        """
        self.steps.append(step)
        z = step.dual
        if step.kind == "propagate":
            self.box = propagate(self.instance, self.box)
            self.check()
        elif step.kind == "relax":
            program = self.build() if program is None else program
            # what the cutoff took from the box costs at least the cutoff, not more
            self.bound = max(self.bound, min(self._value(program, step, z), self.cutoff))
            if self.bound >= self.cutoff:
                raise Closed
            finite = self.cutoff < np.inf
            self.program = add_cutoff(program, self.cutoff) if finite else program
        else:
            assert step.target is not None
            program = self.objective(step.target, step.sign) if program is None else program
            value = self._value(program, step, z) / OBJECTIVE_SIZE
            self._shrink(step.target, step.sign, np.nextafter(value, -np.inf))

    def _value(self, program: ConeProgram, step: Step, z: Array) -> float:
        """Return the safe bound of a program; closes if a ray shows that it has no point."""
        if step.ray and isinstance(certify_infeasible(program, z), Infeasible):
            raise Closed
        safe = certify_lower_bound(program, z)
        return safe.value if isinstance(safe, LowerBound) else -np.inf

    def _shrink(self, target: Target, sign: int, value: float) -> None:
        interval: Interval = getattr(self.box, target.name)
        lo, hi = interval.lo.copy(), interval.hi.copy()
        if sign > 0:
            lo[target.index] = max(lo[target.index], value)
        else:
            hi[target.index] = min(hi[target.index], -value)
        self.box = with_interval(self.box, target.name, Interval(lo, hi))
