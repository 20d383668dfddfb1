"""Stages: every feasible trajectory is a chain of them, each in its box and in its relaxation."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import get_args, get_type_hints

import numpy as np
import pytest
from staged import KINDS, Piece, Planned, cut, family_of, make_plans, outside, plans_of, trip_of
from test_relaxation import nasty_trip

from benchmarks.random_trips import random_trip
from enumerate.stage_parts import StageStep
from relax.box import Cell
from relax.instance import Instance
from relax.load import load_trip
from relax.reach import make_box
from relax.relaxation import build_relaxation
from relax.relaxed_point import lift
from relax.stage import START, make_stage, stop_cells


def cells_of(family: Instance, piece: Piece) -> tuple[Cell, Cell | None]:
    """All states between which a stage may run."""
    cells = stop_cells(family)
    energy, temperature = family.start_energy_kwh, family.start_temperature_c
    start: Cell | None = Cell((energy, energy), (temperature, temperature))
    if piece.first != START:
        start = cells[piece.first]
    assert start is not None, "a stop that a plan uses has states after it"
    return start, None if piece.last == len(family.stops) else cells[piece.last]


def holds(cell: Cell, state: tuple[float, float]) -> bool:
    ends = (*cell.energy, *cell.temperature)
    e, t = state
    return ends[0] - 1e-6 <= e <= ends[1] + 1e-6 and ends[2] - 1e-6 <= t <= ends[3] + 1e-6


def check_stages(family: Instance, plans: Sequence[Planned]) -> int:
    """Cells, boxes and relaxations hold every stage, at costs that add up; how many there are."""
    seen = 0
    for planned in plans:
        pieces = cut(family, planned)
        assert sum(p.cost for p in pieces) == pytest.approx(planned.cost, rel=1e-9, abs=1e-9)
        for piece in pieces:
            start, end = cells_of(family, piece)
            assert holds(start, piece.start) and (end is None or holds(end, piece.end))
            box = make_box(piece.instance, start, end)
            assert box.empty is None, (planned.subset, piece.first, piece.last)
            assert outside(box, piece) == [], (planned.subset, piece.first, piece.last)
            program = build_relaxation(piece.instance, box)
            x = lift(piece.instance, program, piece.trajectory)
            assert program.slack(x).min() > -1e-7
            assert np.all(x > program.l - 1e-7) and np.all(x < program.u + 1e-7)
            cost = float(program.q @ x) + program.constant
            assert cost == pytest.approx(piece.cost, rel=1e-9, abs=1e-9)
            seen += 1
    return seen


@pytest.mark.parametrize("kind", KINDS)
def test_every_trajectory_is_a_chain_of_stages_at_its_cost(kind: str) -> None:
    assert check_stages(family_of(trip_of(kind)), plans_of(kind)[::3]) > 8


def test_also_with_kinked_maps_and_other_cars() -> None:
    trips = [nasty_trip(1), *map(random_trip, (16, 20))]
    assert sum(check_stages(family_of(t), make_plans(t, 0, 1, sizes=(1, 2))) for t in trips) > 15


@pytest.mark.long
def test_also_with_cars_and_roads_of_all_kinds() -> None:
    trips = [nasty_trip(seed) for seed in range(12)]
    trips += [t for t in map(random_trip, range(100, 250)) if len(t.chargers) < 5]
    assert sum(check_stages(family_of(t), make_plans(t, 0, 4)) for t in trips) > 1000


def test_also_on_a_shipped_trip() -> None:
    trip = load_trip("paper-400km", {"route.ambient_c": -10.0})
    assert check_stages(family_of(trip), make_plans(trip, 3, each=4, sizes=(1,))) >= 6


def test_a_stage_lies_within_a_small_cell_around_its_ends() -> None:
    """Made with the cells, or met with them later."""
    for kind in KINDS:
        family = family_of(trip_of(kind))
        for planned in plans_of(kind)[::8]:
            for piece in cut(family, planned):
                (e, t), (e1, t1) = piece.start, piece.end
                start = Cell((e - 0.1, e + 0.1), (t - 0.2, t + 0.2))
                end = Cell((e1 - 0.1, e1 + 0.1), (t1 - 0.2, t1 + 0.2))
                box = make_box(piece.instance, start, end)
                assert box.empty is None and outside(box, piece) == []
                wide = make_box(piece.instance, *cells_of(family, piece))
                met = wide.with_start(start).with_end(end)
                assert met.empty is None and outside(met, piece) == []


def test_a_stage_that_ends_elsewhere_has_no_box() -> None:
    family = family_of(trip_of("winter"))
    stage = make_stage(family, 0, 1)
    energy, temperature = family.start_energy_kwh, family.start_temperature_c
    start = Cell((energy, energy), (temperature, temperature))
    more = family.energy_max_kwh
    assert make_box(stage, start).empty is None
    assert make_box(stage, start, Cell((0.0, 5.0), (-30.0, 60.0))).empty
    assert make_box(stage, start, Cell((more + 1.0, more + 9.0), (-30.0, 60.0))).empty
    assert make_box(stage, start, Cell((0.0, more), (50.0, 60.0))).empty


@pytest.mark.parametrize("kind", ["ends", "two at the end", "one step"])
def test_the_last_stage_keeps_the_least_energy_of_the_destination(kind: str) -> None:
    """A charger there lets the family arrive with less; a car that drives no further may not."""
    family = family_of(trip_of(kind))
    least = family.end_energy_min_kwh
    assert family.energy_min_kwh[-1] < least
    last = len(family.stops)
    assert make_stage(family, START, last).energy_min_kwh[-1] == least
    assert make_stage(family, 0, last).energy_min_kwh[-1] == least
    # at a stop there it may still arrive with less
    assert make_stage(family, 0, last - 1).energy_min_kwh[-1] < least


def test_stages_share_no_array_with_the_family() -> None:
    family = family_of(trip_of("ends"))
    before = family.energy_min_kwh.copy()
    for first in range(-1, 3):
        for last in range(first + 1, 4):
            stage = make_stage(family, first, last)
            assert stage.free_start and stage.drive.n_steps == len(stage.drive.duration_h)
            assert stage.energy_min_kwh.size == stage.drive.n_steps + 1
            stage.energy_min_kwh[:] = -1.0
    assert np.array_equal(family.energy_min_kwh, before)


def test_the_page_names_what_there_is() -> None:
    """Equations (S1) to (S8) of docs/relaxation.md, and the functions that its section names."""
    root = Path(__file__).parents[1]
    page = (root / "docs" / "relaxation.md").read_text(encoding="utf-8")
    section = page[page.index("## 7. Stages") :]
    assert set(re.findall(r"\| \((S\d+)\) \|", section)) == {f"S{i}" for i in range(1, 9)}
    files = [root / "relax" / "stage.py", root / "relax" / "stage_program.py"]
    files += [root / "enumerate" / f"stage_{name}.py" for name in ("graph", "parts", "search")]
    code = "\n".join(f.read_text(encoding="utf-8") for f in files)
    named = re.findall(r"`(?:[\w.]*\.)?(?:StageGraph|StageProgram|Arc|stage)\.(\w+)`", section)
    assert len(named) >= 9
    assert all(f"def {name}(" in code for name in named), named
    for kind in get_args(get_type_hints(StageStep)["kind"]):
        assert kind in ("cost", "plane", "grow") or f"`{kind}`" in section, kind
    for file in re.findall(r"`(test_stage\w*\.py)`", section):
        assert (root / "tests" / file).is_file()
