"""Owns the search for a locally optimal plan of one subset, from one start or from several.

An approximation: it suggests plans and never proves anything. Method and what
failed: docs/refinement.md.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from relax.completion import merit
from relax.descent import Descent, Refined, RefineSettings
from relax.instance import Instance
from relax.plan import Controls, Trajectory
from relax.simulate import Simulation

__all__ = ["RefineSettings", "Refined", "best_of", "refine", "refine_best"]

DEARER = (10.0, 100.0)
"""Multiples of the penalties with which a search goes on that ended beyond a limit: where only
time keeps a battery cool, a kelvin may be worth more than any energy."""
HEAT = 4
"""Programs after which starts are compared: with two the better one is left more often, with six
hardly less often."""


def refine(
    instance: Instance,
    start: Controls,
    settings: RefineSettings | None = None,
    simulation: Simulation | None = None,
    known: Trajectory | None = None,
) -> Refined:
    """Improve controls to a locally optimal plan of the transcription.

    Parameters
    ----------
    instance : Instance
        Subset and grid.
    start : Controls
        Any controls.
    settings : RefineSettings, optional
        When to stop and how to solve.
    simulation : Simulation, optional
        Of the instance; one that has just run ``start`` need not do so again.
    known : Trajectory, optional
        A locally optimal one: a search that arrives there ends.

    Returns
    -------
    Refined
        The best iterate; ``feasible`` says whether it keeps every limit.
    """
    settings, simulation = settings or RefineSettings(), simulation or Simulation(instance)
    return _finish(Descent(simulation, start, settings, known=known))


def _finish(descent: Descent) -> Refined:
    """Run a descent to its end, and further ones with dearer limits if it ends beyond one."""
    settings, simulation = descent.settings, descent.simulation
    found = first = descent.run(settings.max_programs)
    for weight in DEARER:
        left = settings.max_programs - found.programs
        beaten = found.trajectory.cost >= settings.hopeless
        if found.feasible or left <= 0 or beaten or settings.late:
            break
        begin = descent.start if found is first else found.controls
        again = Descent(simulation, begin, settings, weight).run(left)
        found = replace(again, programs=found.programs + again.programs)
    if found.feasible:
        return found
    nearest = min(first, found, key=lambda r: float(r.trajectory.violation.max()))
    return replace(nearest, programs=found.programs)


def refine_best(
    instance: Instance, starts: Iterable[Controls], settings: RefineSettings | None = None
) -> Refined:
    """Improve the most promising of several controls to a locally optimal plan.

    Each is improved by a few programs; then the one of least merit to its end, and the
    others in turn as long as none keeps the limits. A start that ends within these few, above
    ``settings.hopeless``, settles it: those after it are not tried.

    Parameters
    ----------
    instance : Instance
        Subset and grid.
    starts : iterable of Controls
        At least one.
    settings : RefineSettings, optional
        When to stop and how to solve.

    Returns
    -------
    Refined
        The best iterate; its programs are those of all starts.
    """
    settings = settings or RefineSettings()
    descents: list[Descent] = []
    for start in starts:
        descents.append(Descent(Simulation(instance), start, settings))
        now = descents[-1].run(min(HEAT, settings.max_programs))
        if descents[-1].ended and now.feasible and now.trajectory.cost > settings.hopeless:
            break
    order = sorted(descents, key=lambda descent: descent.value)
    ends: list[Refined] = []
    while len(ends) < len(order) and not (ends and ends[-1].feasible):
        ends.append(_finish(order[len(ends)]))
    left = [descent.found for descent in order[len(ends) :]]
    programs = sum(run.programs for run in [*ends, *left])
    return replace(best_of(ends, instance), programs=programs)


def best_of(candidates: Iterable[Refined], instance: Instance) -> Refined:
    """Return the feasible candidate of least merit, or of all if none is; the first of equals."""
    return min(candidates, key=lambda c: (not c.feasible, merit(instance, c.trajectory)))
