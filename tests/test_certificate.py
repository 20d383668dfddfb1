"""Certificates: structure attacked, bounds as the certifier states them, and a text that names
every map, every term and every verdict within 80 columns."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from trips import small_trip

import relax.envelopes
import relax.envelopes_charge
import relax.envelopes_stay
from relax.bound import relax_subset
from relax.certificate import Certificate, check_structure, make_certificate
from relax.certify import Infeasible, LowerBound, Unproved, certify_lower_bound
from relax.instance import make_instance
from relax.intervals import Interval
from relax.load import load_trip
from relax.program import ConeProgram, make_cone_program
from relax.reach import make_box
from relax.relaxation import build_relaxation
from relax.simulate import idle_controls, simulate
from relax.solve import SolveSettings, solve_cone

INSTANCE = make_instance(small_trip(), (0,))
PROGRAM = build_relaxation(INSTANCE, make_box(INSTANCE))


@pytest.fixture(scope="module")
def certificate() -> Certificate:
    return make_certificate(INSTANCE, with_twin=True)


def test_the_certificate_states_what_bound_and_simulation_state(certificate: Certificate) -> None:
    assert isinstance(certificate.bound, LowerBound)
    settings = SolveSettings(tolerance=1e-6)
    other = certify_lower_bound(PROGRAM, solve_cone(PROGRAM, settings).z)
    assert isinstance(other, LowerBound)
    assert certificate.bound.value == pytest.approx(other.value, rel=1e-4)
    lean = relax_subset(INSTANCE, settings=settings).lower_bound
    assert lean is not None
    assert (1.0 - 1e-3) * other.value <= lean <= (1.0 + 1e-6) * other.value
    assert certificate.bound.value <= certificate.objective + 1e-9
    trajectory = simulate(INSTANCE, idle_controls(INSTANCE, (12.0,)))
    assert trajectory.violation.max() == 0.0
    assert certificate.bound.value <= trajectory.cost
    assert certificate.violation < 1e-6
    assert certificate.subset == (0,) and len(certificate.stops) == 1
    place = small_trip().chargers[0].position_km
    assert f"stops: charger at {place:.0f} km" in str(certificate)  # its name is not known
    assert certificate.vehicle == "small car"


def test_structure_of_the_assembled_program(certificate: Certificate) -> None:
    structure = certificate.structure
    assert structure is not None and structure.convex
    cells, steps = INSTANCE.cells, INSTANCE.drive.n_steps
    assert sum(number for _, number in structure.cones) == steps + 2 * cells
    assert {size for size, _ in structure.cones} <= {3, 4}
    rows = structure.equalities + structure.inequalities
    assert rows + sum(size * number for size, number in structure.cones) == PROGRAM.b.size


def test_the_twin_is_dcp_and_dpp_and_only_judged_on_request(certificate: Certificate) -> None:
    assert certificate.twin is not None
    assert certificate.twin.dcp and certificate.twin.dpp and certificate.twin.constraints > 20
    assert "(DCP): yes" in str(certificate) and "(DPP): yes" in str(certificate)
    assert make_certificate(INSTANCE).twin is None


def test_cvxpy_is_not_imported_unless_asked_for() -> None:
    code = (
        "import sys; from relax import load_trip, make_instance;"
        "from relax.certificate import make_certificate;"
        "str(make_certificate(make_instance(load_trip('paper-400km'), (1,))));"
        "sys.exit('cvxpy' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_the_text_names_every_map_term_and_verdict(certificate: Certificate) -> None:
    text = str(certificate)
    assert max(len(line) for line in text.splitlines()) <= 80
    for t in certificate.tightness:
        assert f"{t.label} {t.term}" in text
    for v in certificate.curvature:
        assert str(v)[:60] in text
    for part in (
        "Curvature",
        "Program",
        "Bound",
        "Tightness",
        "Twin",
        "(C1)",
        "convex by structure",
    ):
        assert part in text
    assert isinstance(certificate.bound, LowerBound)
    assert f"{certificate.bound.value:.4f}" in text
    assert "FLAW" not in text
    assert len(certificate.tightness) == 12


@pytest.mark.parametrize("trip", ["goteborg-stockholm-winter", "goteborg-stockholm-summer"])
def test_shipped_trips(trip: str) -> None:
    chargers = [c.name for c in load_trip(trip).chargers]
    found = make_certificate(make_instance(load_trip(trip), (2, 5)), names=chargers)
    vehicle = load_trip(trip).vehicle.name
    assert str(found).splitlines()[0] == f"Certificate: {vehicle}; stops: Granna, Linkoping"
    assert isinstance(found.bound, LowerBound)
    assert found.structure is not None and found.structure.convex
    assert max(len(line) for line in str(found).splitlines()) <= 80


def test_the_worth_of_heat_is_counted() -> None:
    cold = make_certificate(make_instance(load_trip("paper-400km"), (1,)))
    assert cold.worth is not None
    steps = int((cold.worth.drive_heat > cold.worth.drive_electricity).sum())
    assert 0 < steps < 100
    assert f"{steps} of 100 driving steps" in " ".join(str(cold).split())
    warm = make_certificate(make_instance(small_trip(ambient_c=27.0, start_soc=0.4), (0,)))
    assert "in 0 of " in str(warm)


def test_infeasible_by_box_and_by_ray() -> None:
    empty = make_certificate(make_instance(load_trip("paper-400km"), ()))
    assert isinstance(empty.bound, Infeasible) and empty.bound.margin > 0.0
    assert empty.structure is None and empty.tightness == ()
    assert "no plan on this box is feasible" in str(empty) and "reachability" in str(empty)
    box = make_box(INSTANCE)
    arrive = Interval(box.arrive.hi + 1.0, box.arrive.hi + 2.0)  # more than the car can have left
    none = make_certificate(INSTANCE, replace(box, arrive=arrive))
    assert isinstance(none.bound, Infeasible)
    assert "(C2)" in str(none) and none.tightness == () and none.structure is not None
    assert "the solver left no point" in str(none)


def test_a_solver_that_stops_early_costs_tightness_never_truth() -> None:
    good = make_certificate(INSTANCE)
    early = make_certificate(INSTANCE, settings=SolveSettings(max_iterations=2))
    assert isinstance(good.bound, LowerBound)
    assert isinstance(early.bound, LowerBound | Unproved)
    if isinstance(early.bound, LowerBound):
        assert early.bound.value <= good.bound.value + 1e-6
    assert early.tightness == () and "left no point" in str(early)


def test_a_smaller_box_has_a_higher_bound_and_tighter_terms() -> None:
    box = make_box(INSTANCE)
    charge = Interval(box.charge.lo, np.minimum(box.charge.hi, box.charge.lo + 2.0))
    whole, part = (
        make_certificate(INSTANCE),
        make_certificate(INSTANCE, replace(box, charge=charge)),
    )
    assert isinstance(whole.bound, LowerBound) and isinstance(part.bound, LowerBound)
    assert part.bound.value >= whole.bound.value - 1e-6

    def total(c: Certificate) -> float:
        return sum(t.above_kwh + t.below_kwh for t in c.tightness if t.label == "(R9)")

    assert total(part) < total(whole)


def broken(**changes: Any) -> ConeProgram:
    return replace(PROGRAM, **changes)


def changed(part: str, index: int, value: float) -> ConeProgram:
    array = getattr(PROGRAM, part).copy()
    array[index] = value
    return replace(PROGRAM, **{part: array})


def infinite_coefficient() -> ConeProgram:
    A = sp.csc_array(PROGRAM.A, copy=True)
    A.data[0] = np.inf
    return replace(PROGRAM, A=A)


FIRST_ROWS = next(iter(PROGRAM.rows))


@pytest.mark.parametrize(
    ("program", "flaw"),
    [
        (broken(n_nonneg=PROGRAM.n_nonneg - 1), "do not cover"),
        (broken(soc_sizes=(1, 2, *PROGRAM.soc_sizes[1:])), "fewer than 2"),
        (broken(n_zero=-1, n_nonneg=PROGRAM.n_nonneg + PROGRAM.n_zero + 1), "no valid size"),
        (changed("u", 3, np.inf), "no finite box"),
        (changed("l", 3, 1e9), "box of a variable is empty"),
        (changed("b", 3, np.nan), "not finite"),
        (changed("q", 0, np.inf), "not finite"),
        (infinite_coefficient(), "not finite"),
        (broken(rows={k: v for k, v in PROGRAM.rows.items() if k != FIRST_ROWS}), "no name"),
        (broken(rows={**PROGRAM.rows, "again": PROGRAM.rows[FIRST_ROWS]}), "or several"),
        (broken(rows={"all": np.arange(PROGRAM.b.size)}), "several blocks"),
        (broken(l=PROGRAM.l[:-1]), "one entry per variable"),
    ],
)
def test_structure_attacked(program: ConeProgram, flaw: str) -> None:
    found = check_structure(program)
    assert not found.convex
    assert any(flaw in text for text in found.flaws), found.flaws


def test_structure_of_a_program_without_names_says_so() -> None:
    program = make_cone_program([1.0], [[-1.0]], [-2.0], n_nonneg=1, l=[0.0], u=[9.0])
    assert check_structure(program).flaws == ("1 row has no name or several",)
    named = replace(program, rows={"least": np.array([0])})
    assert check_structure(named).convex and check_structure(named).cones == ()


def test_the_page_names_every_label_and_every_envelope_and_no_other() -> None:
    root = Path(__file__).parents[1]
    page = (root / "docs" / "relaxation.md").read_text(encoding="utf-8")
    code = "\n".join(f.read_text(encoding="utf-8") for f in (root / "relax").glob("*.py"))
    label = r"\(([RC]\d+)\)"
    assert set(re.findall(label, code)) == set(re.findall(label, page))
    assert set(re.findall(label, page)) == {f"R{i}" for i in range(1, 11)} | {"C1", "C2"}
    modules = relax.envelopes, relax.envelopes_charge, relax.envelopes_stay
    envelopes = {name for module in modules for name in module.__all__}
    named = set(re.findall(r"envelope_\w+", page))
    assert named == {e for e in envelopes if e.startswith("envelope_")}
    functions = re.findall(r"`(_?(?:(?:add|make|measure|certify)_\w+|propagate))`", page)
    assert functions and all(f"def {name}(" in code for name in functions)


def test_a_flaw_shows_in_the_text(certificate: Certificate) -> None:
    wrong = replace(certificate, structure=check_structure(changed("u", 3, np.inf)))
    assert "FLAW: a variable has no finite box" in str(wrong)
    assert "convex by structure" not in str(wrong)
