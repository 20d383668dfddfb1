"""Programs of stages: whatever the dual vector, no claim contradicts a feasible trajectory."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import numpy as np
import numpy.typing as npt
import pytest
from staged import Piece, cut, family_of, plans_of, trip_of

from relax.box import Cell
from relax.branch import Target
from relax.instance import Instance
from relax.reach import make_box
from relax.solve import ConeSolver, SolveSettings, SolveStatus, solve_objective
from relax.stage import START, make_stage, stop_cells
from relax.stage_program import SLOTS, Penalty, Plane, StageProgram

Array = npt.NDArray[np.float64]

PENALTY = Penalty(30.0, 8.0)
LATER = [Plane(9.0, -0.5, -0.02), Plane(20.0, -1.1, 0.05), Plane(-3.0, 0.0, 0.0)]
"""What later stages cost at least, made up: any cost above it will do."""
KIND_OF = ("winter", "ends", "one step", "limits", "summer")


@cache
def pieces_of(kind: str) -> dict[tuple[int, int], list[Piece]]:
    """Stages of all trajectories, by their ends."""
    family = family_of(trip_of(kind))
    out: dict[tuple[int, int], list[Piece]] = {}
    for planned in plans_of(kind):
        for piece in cut(family, planned):
            out.setdefault((piece.first, piece.last), []).append(piece)
    return out


def make_program(kind: str, first: int, last: int) -> StageProgram:
    family = family_of(trip_of(kind))
    cells = stop_cells(family)
    energy, temperature = family.start_energy_kwh, family.start_temperature_c
    start = Cell((energy, energy), (temperature, temperature))
    if first != START:
        inner = cells[first]
        assert inner is not None
        start = inner
    stage = make_stage(family, first, last)
    end = None if last == len(family.stops) else cells[last]
    program = StageProgram(stage, make_box(stage, start, end))
    program.set_planes(LATER)
    return program


def cases() -> Iterator[tuple[str, tuple[int, int], list[Piece]]]:
    for kind in KIND_OF:
        for ends, pieces in list(pieces_of(kind).items())[::2]:
            yield kind, ends, pieces


def total(piece: Piece, last_stage: bool) -> float:
    """Cost of a stage and what at least follows it."""
    return piece.cost + (0.0 if last_stage else max(p.at(piece.end) for p in LATER))


def mangled(rng: np.random.Generator, z: Array) -> Iterator[Array]:
    """Wrong dual vectors: each is to be harmless."""
    yield z
    yield 1e-3 * z
    yield 1e3 * z
    yield 1e30 * z
    yield -z
    yield rng.permutation(z)
    yield z[::-1].copy()
    yield np.where(rng.random(z.size) < 0.5, z, 0.0)
    yield z + np.abs(z).max() * rng.normal(size=z.size)
    yield z * np.exp(rng.normal(0.0, 0.3, z.size))
    yield rng.normal(size=z.size)
    yield np.zeros_like(z)
    yield z[:-1]
    yield np.append(z, 1.0)
    yield np.full_like(z, np.nan)
    yield np.where(np.arange(z.size) == z.size // 2, np.inf, z)


def solved(program: StageProgram, q: Array, solver: ConeSolver) -> tuple[Array, Array, SolveStatus]:
    found = solve_objective(solver, q, changed=True)
    return found.x, found.z, found.status


def test_no_dual_vector_puts_a_plane_above_a_trajectory() -> None:
    rng = np.random.default_rng(5)
    claims = near = 0
    for kind, (first, last), pieces in cases():
        program = make_program(kind, first, last)
        solver = ConeSolver(program.cone, SolveSettings(tolerance=1e-6))
        for piece in pieces[:2]:
            _, z, status = solved(program, program.ask_start(piece.start, PENALTY), solver)
            assert status is SolveStatus.SOLVED, (kind, first, last)
            touching = program.slope_at(z)
            for slope in (touching, (0.0, 0.0), (-1.0, 0.3), (50.0, -20.0)):
                for wrong in mangled(rng, z):
                    constant = program.claim_cost(slope, wrong)
                    plane = Plane(constant, *slope)
                    for other in pieces:
                        cost = total(other, not program.ends)
                        assert plane.at(other.start) <= cost + 1e-7 * (1.0 + abs(cost))
                    claims += constant > -np.inf
            own = Plane(program.claim_cost(touching, z), *touching)
            near += own.at(piece.start) > total(piece, not program.ends) - 8.0
    assert claims > 500 and near > 20  # true dual vectors claim something, too


def test_the_plane_of_a_slope_is_the_highest_that_the_relaxation_allows() -> None:
    for kind, (first, last), pieces in list(cases())[::3]:
        program = make_program(kind, first, last)
        solver = ConeSolver(program.cone, SolveSettings(tolerance=1e-8))
        for slope in ((0.0, 0.0), (-0.4, 0.01)):
            q = program.ask_slope(slope)
            x, z, status = solved(program, q, solver)
            assert status is SolveStatus.SOLVED
            asked = float(q[: program.bare.q.size] @ x[: program.bare.q.size])
            asked += float(q[-1] * x[-1]) if program.ends else 0.0
            asked += program.cone.constant
            claimed = program.claim_cost(slope, z)
            assert claimed <= asked + 1e-5 * (1.0 + abs(asked))
            assert claimed >= asked - 1e-3 * (1.0 + abs(asked))
            assert min(total(p, not program.ends) for p in pieces) >= claimed or slope != (0.0, 0.0)


def test_a_stage_with_a_trajectory_is_never_claimed_to_be_empty() -> None:
    rng = np.random.default_rng(6)
    refused = 0
    for kind, (first, last), pieces in cases():
        program = make_program(kind, first, last)
        solver = ConeSolver(program.cone, SolveSettings(tolerance=1e-6))
        wide = Plane(max(total(p, not program.ends) for p in pieces) + 0.01, 0.0, 0.0)
        rays = [solved(program, program.ask_start(pieces[0].start, PENALTY), solver)[1]]
        # of a program that has no point: the start is asked far away, and at no penalty
        q = program.ask_start((1e3, 1e3), Penalty(1e6, 1e6))
        rays.append(solved(program, q, solver)[1])
        none = Plane(min(total(p, not program.ends) for p in pieces) - 1e3, 0.0, 0.0)
        q = program.ask_quantity(Target("temperature", 0, "temperature"), 1, none)
        rays.append(solved(program, q, solver)[1])
        for ray in rays:
            for wrong in mangled(rng, ray):
                assert not program.claim_empty(wrong), (kind, first, last)
                assert not program.claim_empty(wrong, wide), (kind, first, last)
        refused += program.claim_empty(rays[-1], none)
    assert refused > 10  # what has no point below a budget is claimed to have none


def test_a_quantity_is_bounded_for_all_within_the_budget_and_for_none_beyond() -> None:
    rng = np.random.default_rng(7)
    tight = 0
    for kind, (first, last), pieces in cases():
        program = make_program(kind, first, last)
        if not program.ends or len(pieces) < 2:
            continue
        solver = ConeSolver(program.cone, SolveSettings(tolerance=1e-6))
        cells, steps = program.box.dwell.lo.shape[1], program.box.power.lo.size
        for target in (
            Target("charge", 0, "charge"),
            Target("temperature", steps, "temperature"),
            Target("stop_temperature", (0, cells), "border"),
            Target("stay", 0, "dwell"),
        ):
            slope = float(rng.normal(-0.4, 0.3)), float(rng.normal(0.0, 0.05))
            over = [total(p, False) - Plane(0.0, *slope).at(p.start) for p in pieces]
            budget = Plane(float(np.median(over)) + 1e-6, *slope)
            within = [p for p, o in zip(pieces, over, strict=True) if o <= budget.constant]
            for sign in (1, -1):
                _, z, status = solved(program, program.ask_quantity(target, sign, budget), solver)
                assert status is SolveStatus.SOLVED
                for wrong in mangled(rng, z):
                    least = program.claim_quantity(target, sign, budget, wrong)
                    for piece in within:
                        ran = piece.trajectory.stops[0]
                        value = {
                            "charge": ran.energy_kwh[-1] - ran.energy_kwh[0],
                            "temperature": piece.trajectory.temperature_c[-1],
                            "stop_temperature": ran.temperature_c[-1],
                            "stay": ran.dwell_h.sum(),
                        }[target.name]
                        assert least <= sign * value + 1e-6, (kind, target, sign)
                interval = getattr(program.box, target.name)
                end = interval.lo if sign > 0 else -interval.hi
                claimed = program.claim_quantity(target, sign, budget, z)
                tight += claimed > end[target.index] + 0.01
    assert tight > 10  # and the budget says more than the box


def test_planes_and_budgets_of_any_numbers_are_heeded() -> None:
    """The oldest planes go, missing ones repeat; coefficients of 0 keep the matrix's pattern."""
    pieces = pieces_of("winter")[(0, 1)]
    program = make_program("winter", 0, 1)
    pattern = program.cone.A.indices.copy(), program.cone.A.indptr.copy()
    rng = np.random.default_rng(8)
    for count in (1, 2, SLOTS, SLOTS + 3):
        planes = [Plane(*rng.normal(0.0, (30.0, 1.0, 0.1))) for _ in range(count)]
        planes[0] = planes[0]._replace(energy=0.0, temperature=0.0)
        program.set_planes(planes)
        solver = ConeSolver(program.cone, SolveSettings(tolerance=1e-7))
        _, z, _ = solved(program, program.ask_slope((0.0, 0.0)), solver)
        least = program.claim_cost((0.0, 0.0), z)
        for piece in pieces:
            later = max(p.at(piece.end) for p in planes)
            assert least <= piece.cost + later + 1e-7
        assert np.array_equal(program.cone.A.indices, pattern[0])
        assert np.array_equal(program.cone.A.indptr, pattern[1])
    # planes that were taken for another set of planes say nothing of this one
    program.set_planes([Plane(-500.0, 0.0, 0.0)])
    for piece in pieces:
        assert program.claim_cost((0.0, 0.0), z) <= piece.cost - 500.0 + 1e-7


def test_the_asked_start_does_not_enter_what_is_claimed() -> None:
    program = make_program("winter", 0, 1)
    pieces = pieces_of("winter")[(0, 1)]
    solver = ConeSolver(program.cone, SolveSettings(tolerance=1e-6))
    _, z, _ = solved(program, program.ask_start(pieces[0].start, PENALTY), solver)
    slope = program.slope_at(z)
    first = program.claim_cost(slope, z)
    program.ask_start((3.0, -20.0), Penalty(0.1, 0.1))
    program.ask_quantity(Target("charge", 0, "charge"), 1, Plane(5.0, 0.0, 0.0))
    assert program.claim_cost(slope, z) == pytest.approx(first, rel=1e-12)


def test_within_no_budget_nothing_is_claimed() -> None:
    """No plan and no bound yet: silently no claim, whatever the dual vector."""
    program = make_program("winter", 0, 1)
    target = Target("charge", 0, "charge")
    solver = ConeSolver(program.cone, SolveSettings(tolerance=1e-6))
    _, z, _ = solved(program, program.ask_quantity(target, 1, Plane(500.0, 0.0, 0.0)), solver)
    assert program.claim_quantity(target, 1, Plane(500.0, 0.0, 0.0), z) > -np.inf
    with np.errstate(all="raise"):
        for constant in (np.inf, np.nan):
            assert program.claim_quantity(target, 1, Plane(constant, 0.0, 0.0), z) == -np.inf


@pytest.mark.parametrize(("first", "last"), [(START, 0), (1, 2), (2, 3)])
def test_a_stage_without_steps(first: int, last: int) -> None:
    """From the start to a charger there; between two, and past one at the destination."""
    kind = "two at the end" if first == 1 else "ends"
    family: Instance = family_of(trip_of(kind))
    stage = make_stage(family, first, last)
    assert stage.drive.n_steps == 0
    program = make_program(kind, first, last)
    solver = ConeSolver(program.cone, SolveSettings(tolerance=1e-6))
    state = family.start_energy_kwh, family.start_temperature_c
    _, z, status = solved(program, program.ask_start(state, PENALTY), solver)
    assert status is SolveStatus.SOLVED
    assert np.isfinite(program.claim_cost(program.slope_at(z), z))
