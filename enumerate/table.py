"""Owns the layout of text: numbers, aligned tables, labelled paragraphs, what a stream can print.

Knows nothing of plans. What is not known is shown as ``-``, never as 0.
"""

from __future__ import annotations

import textwrap
import unicodedata
from collections.abc import Iterable, Sequence
from math import isfinite

__all__ = [
    "MISSING",
    "WIDTH",
    "clock",
    "counted",
    "minutes",
    "number",
    "paragraph",
    "percent",
    "printable",
    "table",
    "unbroken",
]

WIDTH = 80
"""Longest line [characters]: what a terminal shows unless it was widened."""
LABEL = 8
"""Width of a paragraph's label [characters]."""
NO_BREAK = "\N{NO-BREAK SPACE}"
"""Stands for a blank within a name until lines are broken."""
MISSING = "-"
"""Stands for what is not known."""
LONGEST_NAME = 26
"""A first column beside wrapped text is not wider [characters]."""
ASCII = str.maketrans({"°": "", "–": "-", "—": "-", "…": "...", "’": "'"})


def printable(text: str, encoding: str | None) -> str:
    """Return text that a stream of this encoding can print.

    Parameters
    ----------
    text : str
        Any text.
    encoding : str or None
        Of the stream; None counts as ASCII.

    Examples
    --------
    >>> printable("Göteborg, -10 °C", "ascii"), printable("Göteborg", "utf-8")
    ('Goteborg, -10 C', 'Göteborg')
    """
    try:
        text.encode(encoding or "ascii")
    except (UnicodeEncodeError, LookupError):
        plain = unicodedata.normalize("NFKD", text.translate(ASCII))
        kept = "".join(c for c in plain if not unicodedata.combining(c))
        return kept.encode("ascii", "replace").decode("ascii")
    return text


def number(value: float | None, digits: int = 1) -> str:
    """Return a number with fixed digits; ``-`` if it is missing or not finite.

    Examples
    --------
    >>> number(2.345), number(-0.01), number(None), number(float("inf"))
    ('2.3', '0.0', '-', '-')
    """
    if value is None or not isfinite(value):
        return MISSING
    return f"{value if round(value, digits) else 0.0:.{digits}f}"  # never "-0.0"


def percent(share: float | None, digits: int = 1) -> str:
    """Return a share in per cent, without the sign.

    Examples
    --------
    >>> percent(0.283), percent(None)
    ('28.3', '-')
    """
    return number(None if share is None else 100.0 * share, digits)


def clock(hours: float) -> str:
    """Return hours as h:mm.

    Examples
    --------
    >>> clock(2.9999), clock(0.25)
    ('3:00', '0:15')
    """
    whole = round(hours * 60.0)
    return f"{whole // 60}:{whole % 60:02d}"


def minutes(hours: float) -> str:
    """Return hours in minutes.

    Examples
    --------
    >>> minutes(0.25)
    '15.0'
    """
    return number(60.0 * hours)


def counted(count: int, one: str, many: str = "") -> str:
    """Return a count with its noun, in the singular for one.

    Parameters
    ----------
    count : int
        How many.
    one, many : str
        The noun; ``many`` is ``one`` with an s unless given.

    Examples
    --------
    >>> counted(1, "row"), counted(2, "row"), counted(0, "box", "boxes")
    ('1 row', '2 rows', '0 boxes')
    """
    return f"{count} {one if count == 1 else many or one + 's'}"


def paragraph(label: str, text: str, width: int = LABEL) -> str:
    """Return text wrapped beside its label.

    Parameters
    ----------
    label : str
        Stands before the first line.
    text : str
        Any; empty: the label alone.
    width : int
        Of the label: further lines begin there [characters].

    Examples
    --------
    >>> paragraph("gap", "1.2 %")
    'gap     1.2 %'
    >>> paragraph("  small", "a car", width=10)
    '  small   a car'
    """
    head, *rest = _wrap(text, WIDTH - max(width, len(label)))
    lines = [f"{label:<{width}}{head}", *(" " * width + line for line in rest)]
    return "\n".join(line.rstrip() for line in lines)


def unbroken(name: str) -> str:
    """Return a name that no line breaks within, unless it is longer than a line.

    Examples
    --------
    >>> print(paragraph("", "at the charger " * 4 + unbroken("Norra Vagen 12 in town"), 0))
    at the charger at the charger at the charger at the charger
    Norra Vagen 12 in town
    """
    return name.replace(" ", NO_BREAK)


def table(head: Sequence[str], rows: Iterable[Sequence[str]], words_last: bool = False) -> str:
    r"""Align cells in columns, the first to the left, the others to the right.

    Parameters
    ----------
    head : sequence of str
        Headings; a newline begins a new line.
    rows : iterable of sequence of str
        As many cells as headings.
    words_last : bool
        The last column holds words: to the left, and wrapped as the first one.

    Returns
    -------
    str
        Lines of at most ``WIDTH`` characters, as long as the columns between fit.

    Examples
    --------
    >>> print(table(["stop", "grid\nkWh"], [["A", "5.0"], ["B", "12.0"]]))
          grid
    stop   kWh
    A      5.0
    B     12.0
    """
    texts = [list(head), *(list(row) for row in rows)]
    widths = [
        max(len(line) for c in column for line in c.split("\n"))
        for column in zip(*texts, strict=True)
    ]
    last = len(widths) - 1
    inner = sum(widths[1 : last if words_last else None]) + 2 * last
    if words_last:
        widths[0] = min(widths[0], LONGEST_NAME)
        widths[last] = min(widths[last], WIDTH - inner - widths[0])
    else:
        widths[0] = min(widths[0], WIDTH - inner)
    words = {0, last} if words_last else {0}
    lines = []
    for row, cells in enumerate(texts):
        pieces = [
            _wrap(cell, widths[i]) if i in words else cell.split("\n")
            for i, cell in enumerate(cells)
        ]
        height = max(len(p) for p in pieces)
        for k in range(height):
            line = []
            for i, piece in enumerate(pieces):
                j = k - height + len(piece) if row == 0 else k  # headings stand on the table
                text = piece[j] if 0 <= j < len(piece) else ""
                line.append(text.ljust(widths[i]) if i in words else text.rjust(widths[i]))
            lines.append("  ".join(line).rstrip())
    return "\n".join(lines)


def _wrap(text: str, width: int) -> list[str]:
    """Return lines of at most ``width`` (at least 8) characters, never none."""
    width = max(width, 8)
    pieces: list[str] = []
    for line in text.split("\n"):
        words = (w if len(w) <= width else w.replace(NO_BREAK, " ") for w in line.split(" "))
        pieces += textwrap.wrap(" ".join(words), width, break_on_hyphens=False) or [""]
    return [piece.replace(NO_BREAK, " ") for piece in pieces]
