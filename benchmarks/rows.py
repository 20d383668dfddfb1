"""Owns result files: rows appended as they come, read back to resume.

A row is on disk before the next measurement begins. A last line that was cut off (a killed
process) is dropped when the file is opened again. Knows nothing of what the rows say.
"""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Iterable
from math import nan
from pathlib import Path
from typing import Any

__all__ = ["RESULTS", "Row", "RowFile", "is_true", "number", "read_rows"]

RESULTS = Path(__file__).parent / "results"
"""Where result files go."""
Row = dict[str, Any]


def read_rows(file: Path) -> list[Row]:
    """Return the complete rows of a file as strings; none if it is not there."""
    if not file.is_file():
        return []
    text = file.read_text(encoding="utf-8")
    whole = text[: text.rfind("\n") + 1]
    reader = csv.DictReader(io.StringIO(whole, newline=""))
    return [dict(row) for row in reader if None not in row and None not in row.values()]


def number(row: Row, name: str) -> float:
    """Return an entry as a number; NaN if it is missing or empty.

    Examples
    --------
    >>> number({"cost": "1.5"}, "cost"), number({"cost": ""}, "cost")
    (1.5, nan)
    """
    value = row.get(name, "")
    return nan if value in ("", None) else float(value)


def is_true(row: Row, name: str) -> bool:
    """Return a yes-or-no entry.

    Examples
    --------
    >>> is_true({"a": "True"}, "a"), is_true({"a": False}, "a")
    (True, False)
    """
    return str(row.get(name)) == "True"


class RowFile:
    """A CSV file that grows by one row at a time.

    Parameters
    ----------
    file : Path
        Made when the first row comes.
    columns : iterable of str
        Its columns.
    key : iterable of str
        Columns that together name a measurement.
    fresh : bool
        Forget what the file holds.

    Raises
    ------
    ValueError
        The file there has other columns.
    """

    def __init__(
        self, file: Path, columns: Iterable[str], key: Iterable[str], fresh: bool = False
    ) -> None:
        self.file, self.columns, self.key = file, tuple(columns), tuple(key)
        if fresh:
            file.unlink(missing_ok=True)
        self.rows = read_rows(file)
        if file.is_file():
            head = file.read_text(encoding="utf-8").split("\n", 1)[0].strip()
            if head and head != ",".join(self.columns):
                raise ValueError(f"{file} has other columns; move it away to begin again")
            self._rewrite()
        self._done = {self._name(row) for row in self.rows}

    def _name(self, row: Row) -> tuple[str, ...]:
        return tuple(str(row[name]) for name in self.key)

    def _rewrite(self) -> None:
        """Write the complete rows anew, so that nothing is appended to half a line."""
        draft = self.file.with_suffix(".partial")
        with draft.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, self.columns, lineterminator="\n")
            writer.writeheader()
            writer.writerows(self.rows)
        os.replace(draft, self.file)

    def has(self, row: Row) -> bool:
        """Return whether a measurement with the key of ``row`` is there."""
        return self._name(row) in self._done

    def find(self, **entries: str) -> Row | None:
        """Return the last row with these entries."""
        for row in reversed(self.rows):
            if all(str(row[name]) == value for name, value in entries.items()):
                return row
        return None

    def append(self, row: Row) -> None:
        """Write a row and make sure that it is on disk."""
        self.file.parent.mkdir(parents=True, exist_ok=True)
        new = not self.file.is_file() or self.file.stat().st_size == 0
        with self.file.open("a", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, self.columns, lineterminator="\n")
            if new:
                writer.writeheader()
            writer.writerow({name: _cell(row.get(name, "")) for name in self.columns})
            stream.flush()
            os.fsync(stream.fileno())
        self.rows.append({name: str(_cell(row.get(name, ""))) for name in self.columns})
        self._done.add(self._name(row))


def _cell(value: Any) -> Any:
    return json.dumps(value) if isinstance(value, list | tuple | dict) else value
