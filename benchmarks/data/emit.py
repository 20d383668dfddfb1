"""Owns how a preset is written: commented TOML, fixed rounding, write or compare. No figures.

A preset is a list of fields in the order of the file; every field carries the
comment that says where its numbers come from, so that provenance cannot be
left behind when a file is rewritten.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

__all__ = ["DATA", "SOURCES", "Curve", "Field", "Value", "deliver", "points", "render", "rounded"]

Pair = tuple[float, float]
Curve = list[Pair]
Value = str | float | list[float] | Curve | list[list[float]] | dict[str, "Value"]

SOURCES = Path(__file__).parent / "sources"
"""Extracts that the scripts read."""

DATA = Path(__file__).parents[2] / "relax" / "data"
"""Where the shipped presets live."""

DIGITS = 6
"""Significant digits of table entries: well below any figure's own uncertainty."""

SCALAR_DIGITS = 9
"""Significant digits of single numbers, which often are conversions of exact figures."""

WIDTH = 96
"""Line width of comments and arrays."""


@dataclass(frozen=True)
class Field:
    """One key of a preset.

    Parameters
    ----------
    key : str
        Name in the schema.
    value : Value
        Number, text, list, pairs, or a table of those.
    origin : str
        Where the value comes from; may be empty when the group's first field says it.

    Examples
    --------
    >>> Field("auxiliary_kw", 0.5, "published").key
    'auxiliary_kw'
    """

    key: str
    value: Value
    origin: str = ""


def rounded(value: float) -> float:
    """Return the number as a table entry is written: ``DIGITS`` significant digits.

    Examples
    --------
    >>> rounded(0.123456789)
    0.123457
    """
    return float(f"{value:.{DIGITS}g}") + 0.0


def points(x: Iterable[float], y: Iterable[float]) -> Curve:
    """Return rounded pairs.

    Examples
    --------
    >>> points([0, 1], [2, 1 / 3])
    [(0.0, 2.0), (1.0, 0.333333)]
    """
    return [(rounded(float(a)), rounded(float(b))) for a, b in zip(x, y, strict=True)]


def _number(value: float) -> str:
    return repr(float(f"{float(value):.{SCALAR_DIGITS}g}") + 0.0)


def _item(value: object) -> str:
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, (int, float)):
        return _number(value)
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_item(v) for v in value) + "]"
    raise TypeError(f"cannot write {value!r}")


def _array(value: Sequence[object]) -> str:
    """Fill lines of ``WIDTH`` with items; a matrix gets one row per line."""
    items = [_item(v) for v in value]
    one = "[" + ", ".join(items) + "]"
    if len(one) <= WIDTH - 24:
        return one
    lines: list[str] = []
    for item in items:
        if lines and len(lines[-1]) + len(item) + 2 <= WIDTH - 4:
            lines[-1] += f", {item}"
        else:
            lines.append(item)
    return "[\n" + "".join(f"    {line},\n" for line in lines) + "]"


def _comment(text: str) -> str:
    wrapped = [textwrap.wrap(part, WIDTH - 2) or [""] for part in text.split("\n")]
    return "".join(f"# {line}".rstrip() + "\n" for part in wrapped for line in part)


def _field(field: Field) -> str:
    head = _comment(field.origin) if field.origin else ""
    if isinstance(field.value, list):
        return f"{head}{field.key} = {_array(field.value)}\n"
    return f"{head}{field.key} = {_item(field.value)}\n"


def render(header: str, fields: Sequence[Field]) -> str:
    """Return the TOML text: header comment, plain keys, then tables.

    Parameters
    ----------
    header : str
        Comment at the top of the file.
    fields : sequence of Field
        In the order of the file; tables are moved to the end, as TOML asks.

    Returns
    -------
    str
        Ends with a line break.

    Examples
    --------
    >>> print(render("A car.", [Field("aux", 0.5, "assumed")]), end="")
    # A car.
    <BLANKLINE>
    # assumed
    aux = 0.5
    """
    text = _comment(header) + "\n"
    for field in fields:
        if not isinstance(field.value, dict):
            text += ("\n" if field.origin and not text.endswith("\n\n") else "") + _field(field)
    for field in fields:
        if isinstance(field.value, dict):
            text += "\n" + _comment(field.origin) + f"[{field.key}]\n"
            text += "".join(_field(Field(key, value)) for key, value in field.value.items())
    return text


def deliver(path: Path, text: str, check: bool) -> bool:
    """Write a file, or compare it with what the script would write.

    Parameters
    ----------
    path : Path
        The shipped file.
    text : str
        Its content according to the sources.
    check : bool
        Compare, write nothing.

    Returns
    -------
    bool
        Whether file and text agree bit for bit (always true after writing).
    """
    data = text.encode("utf-8")
    if not check:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    same = path.is_file() and path.read_bytes() == data
    verb = ("same" if same else "DIFFERS") if check else "written"
    print(f"{verb:8} {path.parent.name}/{path.name}")
    return same
