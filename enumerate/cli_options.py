"""Owns what the options of the command line accept, and what is said of anything else.

Options come as text; a check turns it into a value or refuses it in one line that names option,
value and what is allowed. Imports nothing heavy.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import click

from enumerate.cli_exit import bad_option

__all__ = [
    "GAP",
    "MINUTES",
    "QUIET",
    "SECONDS",
    "WORKERS",
    "one_word",
    "read_values",
    "settings",
    "whole",
    "workers",
]

T = TypeVar("T")
Check = Callable[[click.Context, click.Parameter, Any], Any]

MOST_VALUES = 100_000
"""Values of one range beyond which its step is a slip."""
MOST_WORKERS = 4
"""Workers used unless asked for more: as many as a batch of a search has tasks."""


def _name(parameter: click.Parameter) -> str:
    return max(parameter.opts, key=len)


def _shown(text: str) -> object:
    """Return a text as the number it is, so that messages show it without quotes."""
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def _number(kind: Callable[[str], T], fits: Callable[[T], bool], allowed: str) -> Check:
    """Return a check that a text is a number that fits."""

    def check(_: click.Context, parameter: click.Parameter, text: str | None) -> T | None:
        if text is None:
            return None
        try:
            value = kind(text)
        except ValueError:
            value = None
        if value is None or not fits(value):
            raise bad_option(_name(parameter), _shown(text), allowed)
        return value

    return check


GAP = _number(float, lambda gap: 0.0 < gap < 1.0, "a number above 0 and below 1, e.g. 0.01 for 1 %")
"""Check of a relative gap: from 1 on, a bound of 0 would do."""
SECONDS = _number(float, lambda s: s >= 0.0, "a number of seconds of at least 0, or 'inf'")
MINUTES = _number(float, lambda minutes: minutes > 0.0, "a number of minutes above 0")


def whole(least: int) -> Check:
    """Return a check that a text is a whole number of at least this.

    Examples
    --------
    >>> option = click.Option(["--points"])
    >>> whole(2)(click.Context(click.Command("any")), option, "12")
    12
    """
    return _number(int, lambda number: number >= least, f"a whole number of at least {least}")


def workers() -> str:
    """Return the number of cores this process may use, at most ``MOST_WORKERS``, as text."""
    allowed = getattr(os, "sched_getaffinity", None)  # not on every system
    cores = len(allowed(0)) if allowed is not None else os.cpu_count() or 1
    return str(min(cores, MOST_WORKERS))


WORKERS = click.option(
    "--workers",
    metavar="NUMBER",
    default=workers,
    show_default="one per core, at most 4",
    callback=whole(1),
    help="Processes at work (threads where they cannot be forked). The result is the same for any "
    "number.",
)


def one_word(words: Sequence[str]) -> Check:
    """Return a check that a text is one of some words.

    Examples
    --------
    >>> option = click.Option(["--solver"])
    >>> one_word(["clarabel", "osqp"])(click.Context(click.Command("any")), option, "osqp")
    'osqp'
    """

    def check(_: click.Context, parameter: click.Parameter, text: str) -> str:
        if text not in words:
            raise bad_option(_name(parameter), text, "one of " + ", ".join(words))
        return text

    return check


def settings(
    _: click.Context | None, parameter: click.Parameter | None, values: tuple[str, ...]
) -> dict[str, object]:
    """Return the overrides of ``--set``: TOML values, or strings where they are none.

    Raises
    ------
    InputError
        A text is no ``key=value``.

    Examples
    --------
    >>> settings(None, None, ("start.soc=0.8", "name=a trip"))
    {'start.soc': 0.8, 'name': 'a trip'}
    """
    import tomllib

    found: dict[str, object] = {}
    for text in values:
        key, equals, value = text.partition("=")
        if not (equals and key.strip()):
            raise bad_option("--set", text, "key=value")
        try:
            document = tomllib.loads(f"value = {value}")
        except (ValueError, RecursionError):  # no TOML, or none that can be read
            document = {}
        found[key.strip()] = document["value"] if set(document) == {"value"} else value
    return found


def read_values(texts: Sequence[str]) -> dict[str, list[Any]]:
    """Return keys and values of ``--over``: ``key=1,2,3`` or ``key=first:last:step``.

    Raises
    ------
    InputError
        A text is neither, or a key comes twice.

    Examples
    --------
    >>> read_values(["start.soc=0.8,0.9", "route.ambient_c=-10:10:10"])
    {'start.soc': [0.8, 0.9], 'route.ambient_c': [-10, 0, 10]}
    """
    found: dict[str, list[Any]] = {}
    for text in texts:
        key, equals, listed = text.partition("=")
        key = key.strip()
        try:
            if not (equals and key and listed.strip()):
                raise ValueError
            values = _range(listed) if listed.count(":") == 2 else _list(listed)
        except (ValueError, ZeroDivisionError, OverflowError):
            raise bad_option("--over", text, "key=a,b,c or key=first:last:step") from None
        if key in found:
            raise bad_option("--over", text, f"all values of {key} in one --over")
        found[key] = values
    return found


def _list(text: str) -> list[Any]:
    import tomllib

    found: list[Any] = []
    for entry in text.split(","):
        try:
            found.append(tomllib.loads(f"value = {entry}")["value"])
        except (ValueError, RecursionError):
            found.append(entry.strip())
    return found


def _range(text: str) -> list[Any]:
    """Return first, first + step ... up to last, as whole numbers where they all are."""
    first, last, step = (float(part) for part in text.split(":"))
    if not 0.0 <= (last - first) / step < MOST_VALUES:
        raise ValueError
    count = int((last - first) / step + 1e-9) + 1
    values = [first + step * k for k in range(count)]
    return [int(v) for v in values] if first.is_integer() and step.is_integer() else values


QUIET = click.option(
    "--quiet",
    "-q",
    is_flag=True,
    callback=lambda _, __, quiet: quiet or sys.stderr is None,  # it may be closed
    help="No progress on standard error.",
)
