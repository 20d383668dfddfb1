"""Owns what a search does for a gap: leaves and stages are bounded until the plan is proved.

What a proof meets on the way and cannot close is planned. Knows no solver.
"""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from functools import partial
from math import inf

from enumerate.explore import Search
from enumerate.gap import closing_cost, is_close
from enumerate.ledger import Outcome
from enumerate.stage_graph import StageGraph
from enumerate.stage_parts import StageStep
from enumerate.stage_search import StageSearch
from enumerate.subset import Subset
from enumerate.tasks import refine_point
from enumerate.tree import Examined, Leaf

__all__ = ["by_stages", "prove"]

STAGES_STOPS = 3
"""All plans are bounded together, stage by stage, if the best has this many stops: cutting a
subset multiplies over its stops. With 20 or 24 chargers and one stop, stages gained nothing in
30 s and took four times the memory of families (``benchmarks.scale``)."""
MOST_PATHS = 4
"""Subsets planned because a path of stages used them."""
AHEAD = 8
"""Leaves of a proof handed out before the first of them is entered; fixed, so that any number of
workers examines the same ones. Nearly all have to be closed anyway, and they take very different
times: of fewer, one worker would wait for the other."""
PATHS_EVERY = 8
"""Paths of stages of which one is planned: most change little."""
STAGE_NEAR = 0.03
"""Share of the cost that is missing when paths of stages begin to be planned."""
LEAF_STARTS = 2
"""Starts that a proof may add for one subset."""
FIRST_STARTS = 8
"""The same as long as there is no plan."""


def by_stages(search: Search) -> bool:
    """Whether all plans are bounded together; stages know no limit of all stops' time."""
    stops = 0 if search.best is None else len(search.best.row.subset)
    limited = search.setting.trip.stop_time_h < inf
    return not search.single and stops >= STAGES_STOPS and not limited


def prove(search: Search, gap: float) -> None:
    """Cut and bound whatever could be cheaper than the driven plan by more than the gap.

    Without a plan, whatever is not infeasible: what is left of it tells where to start again.
    """
    search.proving = True
    if search.road.execution is not None and by_stages(search):
        _prove_by_stages(search, gap)
    if search.single:
        search.account.plant(
            Leaf(s, (), n.row.lower_bound, None, (len(s), len(s)), known=search.optima.get(s))
            for s, n in search.nodes.items()
            if n.row.outcome is not Outcome.INFEASIBLE and s not in search.together
        )
    with closing(search.examine_all(partial(_cutoff, search, gap), AHEAD)) as examined:
        for done in examined:
            if not done.leaf.undecided and not done.closed:
                _plan_leaf(search, done)
                if search.best is not None and search.road.is_new(search.best):
                    search.drive()


def _cutoff(search: Search, gap: float) -> float:
    """Return the cost from which on a bound closes, for the driven plan; ``inf`` without one.

    No bound exceeds what any plan costs on the grid.
    """
    done = search.road.execution
    if done is None:
        return inf
    assert done.replay is not None  # plans that do not hold are refused
    return closing_cost(done.replay.cost, gap, min(done.trajectory.cost, search.cost))


def _prove_by_stages(search: Search, gap: float) -> None:
    """Bound all plans at once, stage by stage; plan what the cheapest paths use."""
    family = search.setting.instance((), tuple(range(search.n_chargers)))
    graph = StageGraph(family, _cutoff(search, gap))
    stages = StageSearch(graph, search.deadline)
    tried: set[Subset] = set()
    paths = 0
    try:
        for share in stages.run():
            search.account.stage_bound = graph.lower_bound
            search.tell("stages, % of the gap", int(100.0 * share), 100)
            subset = tuple(sorted(family.stops[i].charger for i in stages.path))
            paths += graph.closing - graph.bound < STAGE_NEAR * abs(graph.closing)
            if paths % PATHS_EVERY == 1 and subset not in tried and len(tried) < MOST_PATHS:
                tried.add(subset)
                search.plan_new([subset])
                if search.best is not None and search.road.is_new(search.best):
                    search.drive()
                if _cutoff(search, gap) < graph.closing:
                    graph.apply(StageStep("closing", value=_cutoff(search, gap)))
    finally:
        search.account.enter_stages(graph, stages.programs)
    search.look_at_clock()


def _plan_leaf(search: Search, done: Examined) -> None:
    """Plan a subset that a proof met and could not close, and start again from what it knows.

    A tightened relaxation's optimum is often nearer to the best plan than any other start.
    """
    search.plan_new([done.leaf.subset])
    node = search.nodes.get(done.leaf.subset)  # none if time is up
    most = FIRST_STARTS if search.road.execution is None else LEAF_STARTS
    if node is None or done.point is None or node.starts >= most:
        return
    # a subset without a plan may have one that other starts missed
    if node.row.outcome is Outcome.UNPROVED or is_close(node.row.cost, search.cost):
        node = replace(node, point=done.point, starts=node.starts + 1)
        search.nodes[done.leaf.subset] = node
        search.run(refine_point, [node], "further starts")
