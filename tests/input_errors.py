"""Owns what the message of an ``InputError`` must say, and the names of cases in a table of them.

``check`` asserts one line: source, field, value and, behind them, what is allowed. It knows
nothing of what can be wrong; the tables of mistakes stand with their tests.
"""

from __future__ import annotations

from typing import Any

__all__ = ["check", "names"]


def names(cases: list[Any]) -> list[str]:
    """Return a name for every case: its number, and the field that is wrong."""
    return [f"{k}-{case[-3]}" for k, case in enumerate(cases)]


def check(message: str, source: str, field: str, value: str, allowed: str) -> None:
    """Assert that a message is one line that holds all of these, each in its place."""
    assert "\n" not in message
    head, separator, tail = message.partition("; allowed: ")
    assert separator
    assert head.startswith(f"{source}: {field}: ")
    assert value in head.removeprefix(f"{source}: {field}: ")
    assert allowed in tail
