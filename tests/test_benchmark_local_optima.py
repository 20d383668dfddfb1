"""Plans against many starts: a row per start, a row per kind of start, nothing below the best."""

from __future__ import annotations

from math import inf

import pytest

from benchmarks.local_optima import AHEAD, FREE, best_of_starts, main
from enumerate import plan
from relax import load_trip


def test_a_plan_is_compared_with_the_best_of_many_starts(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["--trip", "paper-400km", "--soc", "0.9", "--stops", "2"]) == 0
    plans, kinds = capsys.readouterr().out.split("\n\n")
    (row,) = plans.splitlines()[2:]
    assert abs(float(row.strip("| ").split("|")[-1].strip(" %"))) < 0.05
    rows = [line.strip("|").split("|") for line in kinds.splitlines()[2:]]
    names = [cells[0].strip() for cells in rows]
    assert names[:2] == ["relaxed", AHEAD] and names[4:] == list(FREE)
    assert all(0.0 <= float(c[2].strip(" %")) <= float(c[3].strip(" %")) + 0.05 for c in rows)


def test_choices_that_cannot_be_the_best_are_left_out_and_no_start_beats_a_bound() -> None:
    trip = load_trip("paper-400km")
    result = plan(trip)
    found = best_of_starts(trip, 2)
    assert result.instance is not None and result.instance.subset in found
    assert len(found) < 6
    bounds = {row.subset: row.lower_bound for row in result.ledger.rows}
    for subset, costs in found.items():
        assert min(costs.values()) >= bounds.get(subset, -inf)
        assert {"relaxed", *FREE} <= set(costs)
        both = (costs["relaxed"], costs["warm 20 °C"])
        assert any(costs[AHEAD] == pytest.approx(cost, rel=1e-6) for cost in both)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--stops", "0"], "allowed: 1 or more"),
        (["--trip", "nowhere"], "nowhere"),
        (["--soc", "2"], "start.soc"),
    ],
)
def test_bad_input_is_one_error(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    assert stopped.value.code == 2 and said in capsys.readouterr().err


def test_a_trip_without_a_plan_is_said_to_have_none(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--trip", "paper-400km", "--soc", "0.06", "--stops", "1"]) == 0
    assert "| 6 % | no plan | no plan | - |" in capsys.readouterr().out
