"""What one bound costs: a row per number of stops, each choice measured in every round."""

from __future__ import annotations

from math import comb

import pytest

from benchmarks.bounds import main, measure
from relax import load_trip, make_instance

PAPER = load_trip("paper-400km")


def test_a_row_per_number_of_stops_counts_every_choice(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["paper-400km", "--rounds", "1"]) == 0
    head, _, *rows = [line.strip("|").split("|") for line in capsys.readouterr().out.splitlines()]
    for k, row in enumerate(rows, 1):
        said = dict(zip((cell.strip() for cell in head), (c.strip() for c in row), strict=True))
        assert int(said["stops"]) == k
        assert int(said["bounded"]) + int(said["infeasible"]) == comb(3, k)
        first = {name: float(said[name].split()[0]) for name in ("bound ms", "plan ms")}
        assert first["plan ms"] > first["bound ms"]
        assert float(said["times the solver's call"].split()[0]) > 1.0
    assert len(rows) == 3


def test_the_first_round_does_not_count() -> None:
    (found,) = measure([make_instance(PAPER, (1,))], rounds=2)
    assert [len(t) for t in (found.bound_s, found.solve_s, found.plan_s)] == [2, 2, 2]
    times = zip(found.solve_s, found.bound_s, found.plan_s, strict=True)
    assert all(0.0 < solve < bound < planned for solve, bound, planned in times)


def test_what_is_out_of_reach_is_proved_without_the_solver_and_not_planned() -> None:
    (found,) = measure([make_instance(PAPER, ())], rounds=1)
    assert found.infeasible and found.solve_s == [0.0] and found.plan_s == []


@pytest.mark.parametrize(
    ("arguments", "said"), [(["--rounds", "0"], "allowed: 1 or more"), (["nowhere"], "nowhere")]
)
def test_bad_input_is_one_error(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    assert stopped.value.code == 2 and said in capsys.readouterr().err
