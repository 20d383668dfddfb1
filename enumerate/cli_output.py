"""Owns what commands write: text, files, and whether a place can be written to.

Knows nothing of how a plan is found. Imports nothing heavy.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import click

from enumerate.cli_exit import NOT_WRITTEN, bad_option, fail, reason, silence

__all__ = [
    "STDOUT",
    "check_files",
    "check_folder",
    "say",
    "write_all",
    "write_text",
]

STDOUT = "-"
REGULAR = {"--ledger", "--file"}
"""Options whose file is replaced or read as well: a pipe or a device cannot be either."""


# ---------------------------------------------------------------------------- places


def check_files(files: Mapping[str, str | None], trip: str) -> None:
    """Refuse files that cannot be written, or would replace one another, before all else.

    Parameters
    ----------
    files : mapping of str to str or None
        Option and file. A symbolic link stands for what it names. ``-`` is no file for
        ``--json``.
    trip : str
        Shipped trip, or a file that no output may replace.

    Raises
    ------
    InputError
        Names option, file and what is allowed.

    Examples
    --------
    >>> check_files({"--ledger": "/"}, "paper-400km")
    Traceback (most recent call last):
        ...
    relax.errors.InputError: command line: --ledger: '/'; allowed: a regular file, or a free name
    """
    taken = {Path(os.path.realpath(trip)): "the trip"} if os.path.isfile(trip) else {}
    for option, file in files.items():
        if file is None or (option == "--json" and file == STDOUT):
            continue
        path = Path(os.path.realpath(file))
        there = os.path.exists(path)
        if path in taken and (os.path.isfile(path) or not there):
            raise bad_option(option, file, f"another file than that of {taken[path]}")
        taken[path] = option
        if option in REGULAR and there and not path.is_file():
            raise bad_option(option, file, "a regular file, or a free name")
        try:
            # opening a pipe would wait
            if os.path.isfile(path) or os.path.isdir(path) or not there:
                with path.open("ab"):
                    pass
                if not there:
                    path.unlink()
        except OSError as error:
            allowed = f"a file that can be written ({reason(error)})"
            raise bad_option(option, file, allowed) from error


def check_folder(option: str, folder: Path | None) -> None:
    """Make a folder; refuse one that cannot be written to.

    Raises
    ------
    InputError
        Names option, folder and what is allowed.

    Examples
    --------
    >>> check_folder("--plot", None)
    """
    import tempfile

    if folder is None:
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        allowed = f"a folder that can be written to ({reason(error)})"
        raise bad_option(option, str(folder), allowed) from error


# ---------------------------------------------------------------------------- text


def say(text: str, err: bool = False) -> None:
    """Print text, in ASCII where the stream cannot do better.

    Raises
    ------
    OSError
        The stream is closed, or what is behind it is full.

    Examples
    --------
    >>> say("315.45 SEK")
    315.45 SEK
    """
    from enumerate.table import printable

    stream = sys.stderr if err else sys.stdout
    if stream is None:
        raise OSError("it is closed")
    click.echo(printable(text, stream.encoding), err=err)


def write_text(file: str, text: str) -> None:
    """Write a line into a file; ``-``: to standard output.

    Examples
    --------
    >>> write_text("-", "{}")
    {}
    """
    if file == STDOUT:
        say(text)
    else:
        Path(file).write_text(text + "\n", encoding="utf-8")


def write_all(outputs: Sequence[tuple[str, Callable[[], None]]]) -> None:
    """Write one output after the other; what fails does not keep the others from being written.

    Parameters
    ----------
    outputs : sequence of (str, callable)
        What it is, and what writes it.

    Examples
    --------
    >>> write_all([("standard output", lambda: say("done"))])
    done
    """
    failed, left = [], False
    for name, write in outputs:
        try:
            write()
        except BrokenPipeError:  # the reader has seen enough, as 'head' has
            silence(sys.stdout)
            left = True
        except OSError as error:
            if sys.stdout is not None:
                silence(sys.stdout)
            failed.append(f"{name}: {reason(error)}")
    if failed:
        fail(f"the result could not be written: {'; '.join(failed)}", NOT_WRITTEN)
    if left:
        sys.exit(NOT_WRITTEN)
