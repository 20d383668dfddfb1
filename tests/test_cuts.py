"""A box is cut at the widest quantity, but first where the relaxed optimum breaks a limit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from benchmarks.random_trips import random_trip
from enumerate import plan
from relax import load_trip, make_instance
from relax.branch import Target, branch
from relax.cuts import next_cut, widest
from relax.instance import Instance
from relax.intervals import Interval
from relax.program import ConeProgram
from relax.reach import make_box
from relax.relaxation import build_relaxation
from relax.solve import solve_cone

Array = npt.NDArray[np.float64]


def optimum(instance: Instance, **changes: Any) -> tuple[Any, ConeProgram, Array]:
    """Return box, relaxation and relaxed optimum."""
    box = replace(make_box(instance), **changes)
    program = build_relaxation(instance, box)
    return box, program, solve_cone(program).x


def moved(program: ConeProgram, x: Array, name: str, index: Any, value: float) -> Array:
    """Return a point with one physical value of a variable replaced."""
    column = program.variables[name][index]
    out = x.copy()
    out[column] = value / program.scale[column]
    return out


def test_without_a_broken_limit_the_widest_quantity_is_cut() -> None:
    instance = make_instance(load_trip("paper-400km"), (1, 2))
    box, program, x = optimum(instance)
    how = next_cut(instance, box, program, x)
    assert how is not None and how == widest(instance, box)
    assert next_cut(instance, box, program, np.full(x.shape, np.nan)) == how


def test_refused_recuperation_cuts_the_temperature_at_its_step() -> None:
    instance = make_instance(random_trip(2012), (0,))  # downhill with a cold battery
    box, program, x = optimum(instance)
    k = int(np.flatnonzero(box.power.lo < 0.0)[-1])
    too_much = -400.0 - 0.4 / instance.drive.duration_h[k]
    how = next_cut(instance, box, program, moved(program, x, "power", k, too_much))
    assert how is not None and how.target is not None and how.target.name == "temperature"
    assert how.target.index in (k, k + 1)
    at = int(how.target.index)
    assert how.at == box.temperature.mid[at]
    assert box.temperature.width[at] == box.temperature.width[k : k + 2].max()
    low, high = branch(box, how)
    assert low.temperature.hi[at] == high.temperature.lo[at] == how.at


@pytest.mark.parametrize("amid_k", [30.0, 2.0])
def test_a_cell_charged_too_fast_is_cut_if_least_is_known_there(amid_k: float) -> None:
    instance = make_instance(load_trip("paper-400km"), (1,))
    whole = make_box(instance).stop_temperature
    half = np.full(whole.lo.shape, 0.5 * amid_k)
    half[:, [0, -1]] = 5.0
    box, program, x = optimum(instance)
    box = replace(box, stop_temperature=Interval(15.0 - half, 15.0 + half))
    broken = moved(program, x, "dwell", (0, 7), 1e-5)
    how = next_cut(instance, box, program, broken)
    if amid_k > 20.0:
        assert how is not None and how.at == 15.0
        assert how.target in [Target("stop_temperature", (0, j), "border") for j in (7, 8)]
    else:
        assert how == widest(instance, box)


def test_a_proof_ends_that_cuts_at_stops_alone_left_open() -> None:
    """Four cells, and a pack so small that it warms by ten kelvin in each."""
    result = plan(random_trip(2019), gap=0.01, time_limit_s=120.0)
    assert not result.interrupted and result.programs < 700
