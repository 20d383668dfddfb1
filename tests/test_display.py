"""Progress: numbers that mean something, one line that fits, silence where nobody looks."""

from __future__ import annotations

import io
import re
from contextlib import redirect_stderr
from math import inf

import pytest

from enumerate import display
from enumerate.display import CLOCK, open_bar, progress_line, show_progress
from enumerate.explore import Progress
from enumerate.table import WIDTH


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    """A terminal to put in the place of standard error, which shows everything at once."""
    stream = Terminal()
    monkeypatch.setattr(display, "DELAY_S", 0.0)
    monkeypatch.setattr(display, "EVERY_S", 0.0)
    return stream


def shown(stream: Terminal) -> list[str]:
    return [text.strip() for text in re.split(r"[\r\n]", stream.getvalue()) if text.strip()]


def test_a_search_tells_bound_and_gap_and_no_share_of_a_growing_total(terminal: Terminal) -> None:
    with redirect_stderr(terminal), show_progress(quiet=False) as report:
        assert report is not None
        report(Progress("relax", 1, 8, inf, -inf))
        report(Progress("prove", 90, 150, 200.0, 190.0))
        report(Progress("refine", 1, 1, 200.0, 190.0))
        report(Progress("prove", 120, 400, 200.0, 196.0))
    lines = shown(terminal)
    assert not any("%|" in line or "left" in line or "<" in line for line in lines)
    assert any(line.startswith("relax: 1 done, 7 open, 00:0") for line in lines)
    said = [line for line in lines if line.startswith("prove: ")]
    assert "90 done, 60 open, best 200.00, bound 190.00, gap 5.00 %" in said[0]
    assert "120 done, 280 open, best 200.00, bound 196.00, gap 2.00 %" in said[-1], (
        "a phase that comes again is shown again"
    )
    assert max(map(len, lines)) < WIDTH


@pytest.mark.parametrize(
    "progress",
    [
        Progress("stages, % of the gap", 45, 100, 1452.46, 1400.01),
        Progress("further starts of a phase with a very long name", 45, 100, 1e9, 1e8),
        Progress("p" * 200, 1_000_000, 2_000_000, 1e12, -1e12),
    ],
)
def test_the_line_fits_with_the_time_behind_it(progress: Progress) -> None:
    line = progress_line(progress)
    assert len(line) + CLOCK < WIDTH
    assert "gap" in line or len(progress.phase) > WIDTH


def test_a_narrow_terminal_gets_a_narrow_line(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    with redirect_stderr(terminal), show_progress(quiet=False) as report:
        assert report is not None
        report(Progress("prove", 90, 150, 200.0, 190.0))
    with redirect_stderr(terminal), open_bar("audit", 100, "step") as bar:
        bar.update(50)
    assert shown(terminal) and max(map(len, shown(terminal))) < 40


def test_a_bar_has_the_share_done(terminal: Terminal) -> None:
    with redirect_stderr(terminal), open_bar("audit", None, "step") as bar:
        bar.total = 200
        bar.update(50)
    assert any(re.match(r"audit: +25%", line) for line in shown(terminal))
    assert max(map(len, shown(terminal))) < WIDTH


def test_away_from_a_terminal_nothing_is_said_at_once() -> None:
    with redirect_stderr(io.StringIO()) as stream:
        with show_progress(quiet=False) as report, open_bar("audit", 2, "step") as bar:
            assert report is not None
            report(Progress("relax", 1, 8, 3.0, 2.0))
            bar.update()
    assert stream.getvalue() == ""
    with show_progress(quiet=True) as report:
        assert report is None
