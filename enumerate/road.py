"""Owns which plans have been driven on the continuous model, and the cheapest that holds."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from math import inf

from enumerate.ledger import REFUSED, Outcome, Row
from enumerate.subset import Subset
from enumerate.tasks import Node, Setting
from relax.execute import Execution, execute
from relax.refinement import Refined

__all__ = ["Road"]


class Road:
    """The plans driven so far; ``execution`` and ``node`` are those of the cheapest that holds."""

    def __init__(self) -> None:
        self.execution: Execution | None = None
        self.node: Node | None = None
        self._last: dict[Subset, Refined] = {}  # the last plan driven of each

    @property
    def cost(self) -> float:
        """Cost of the cheapest plan driven [currency]."""
        done = self.execution
        return inf if done is None or done.replay is None else done.replay.cost

    def is_new(self, node: Node) -> bool:
        """Whether the plan of a node has not been driven."""
        return node.refined is not self._last.get(node.row.subset)

    def next(self, planned: Iterable[Node], best: Node | None, late: bool) -> Node | None:
        """Return the cheapest plan not driven, if it is the best or may be so on the road.

        Parameters
        ----------
        planned : iterable of Node
            All that have a plan.
        best : Node or None
            The cheapest of them on the grid.
        late : bool
            Time is up: the best plan is driven all the same.
        """
        node = min(filter(self.is_new, planned), key=lambda n: n.row.cost, default=None)
        if node is None or node is best:
            return node
        return None if late or node.row.cost >= self.cost else node

    def drive(self, setting: Setting, node: Node, patient: bool) -> Row:
        """Drive the plan of a node; return its row at the cost of the plan as repaired.

        Parameters
        ----------
        setting : Setting
            What every task needs.
        node : Node
            A subset with a plan.
        patient : bool
            Its repairs are worth more than the moment: no deadline.
        """
        assert node.refined is not None
        settings = replace(setting.refine, deadline=inf) if patient else setting.refine
        subset = node.row.subset
        done = execute(setting.trip, setting.instance(subset), node.refined, settings)
        self._last[subset] = node.refined
        if done.reason:
            reason = f"{REFUSED}: {done.reason}"
            return replace(node.row, outcome=Outcome.UNPROVED, cost=inf, reason=reason)
        if done.replay is not None and done.replay.cost < self.cost:
            self.execution, self.node = done, node
        return replace(node.row, cost=done.trajectory.cost)
