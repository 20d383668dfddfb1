"""Owns how a command ends: exit codes, and one line for everything that goes wrong.

Click would print usage, hint and error on three lines, and a traceback where standard output
cannot be written. Knows nothing of trips and plans.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any, NoReturn, TextIO

import click

__all__ = [
    "BAD_INPUT",
    "INFEASIBLE",
    "INTERRUPTED",
    "NOT_WRITTEN",
    "PLANNED",
    "STOPPED",
    "Command",
    "Group",
    "abandon",
    "bad_option",
    "before_planning",
    "fail",
    "reason",
    "silence",
]

PLANNED, NOT_WRITTEN, BAD_INPUT, INFEASIBLE, STOPPED = 0, 1, 2, 3, 4
"""Exit codes."""
INTERRUPTED = 130
"""Ctrl-C where nothing catches it: a second one, or one outside of a search."""


def fail(message: str, code: int) -> NoReturn:
    """Print one line on standard error and end.

    Examples
    --------
    >>> fail("start.soc: 3", BAD_INPUT)
    Traceback (most recent call last):
        ...
    SystemExit: 2
    """
    from enumerate.table import printable

    if sys.stderr is not None:
        line = "evrelax: " + " ".join(message.split("\n"))
        with suppress(OSError):  # nobody is left to tell
            click.echo(printable(line, sys.stderr.encoding), err=True)
        silence(sys.stderr)
    sys.exit(code)


def abandon(message: str, code: int) -> NoReturn:
    """Print one line and end at once, also if threads of a search are still at work.

    Python would wait for them, and a solver's thread that is stopped at exit aborts the process.

    Examples
    --------
    >>> abandon("interrupted", INTERRUPTED)
    Traceback (most recent call last):
        ...
    SystemExit: 130
    """
    try:
        fail(message, code)
    finally:
        main = threading.main_thread()
        if any(t is not main and not t.daemon for t in threading.enumerate()):
            silence(sys.stdout)
            os._exit(code)


def bad_option(option: str, value: object, allowed: str) -> Exception:
    """Return the error of an option, in the form of those of files.

    Examples
    --------
    >>> str(bad_option("--gap", -1, "a number above 0"))
    'command line: --gap: -1; allowed: a number above 0'
    """
    from relax.errors import InputError

    return InputError("command line", option, value, allowed)


def reason(error: OSError) -> str:
    """Return why the system refused, in words.

    Examples
    --------
    >>> reason(OSError(28, "No space left on device"))
    'no space left on device'
    """
    return (error.strerror or str(error) or type(error).__name__).lower()


def silence(stream: TextIO) -> None:
    """Drop what a stream could not write; at exit Python would try again and complain.

    Examples
    --------
    >>> silence(sys.stdout)
    """
    try:
        stream.flush()
    except (OSError, ValueError):
        with suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


@contextmanager
def before_planning() -> Iterator[None]:
    """Tell an interruption while files are checked and read from one of a search.

    Examples
    --------
    >>> with before_planning():
    ...     raise KeyboardInterrupt
    Traceback (most recent call last):
        ...
    SystemExit: 4
    """
    try:
        yield
    except KeyboardInterrupt:
        fail("interrupted before planning", STOPPED)


class _OneLine(click.Command):
    """A command that ends with one line and an exit code, whatever happens."""

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        **extra: Any,
    ) -> Any:
        """Run it; see ``click.Command.main``."""
        from relax.errors import EvrelaxError

        settings: dict[str, Any] = {"complete_var": complete_var, **extra}
        if not standalone_mode:
            return super().main(args, prog_name, standalone_mode=False, **settings)
        try:
            code = super().main(args, prog_name, standalone_mode=False, **settings)
        except EvrelaxError as error:  # of numbers that are allowed but make no sense together too
            fail(str(error), BAD_INPUT)
        except click.UsageError as error:
            _fail_usage(error)
        except click.Abort:
            abandon("interrupted", INTERRUPTED)
        except BrokenPipeError:  # the reader has seen enough, as 'head' has
            silence(sys.stdout)
            sys.exit(NOT_WRITTEN)
        except OSError as error:
            silence(sys.stdout)
            named = "the output" if error.filename is None else str(error.filename)
            fail(f"{named} could not be written: {reason(error)}", NOT_WRITTEN)
        sys.exit(code if isinstance(code, int) else PLANNED)


class Command(_OneLine):
    """A single command.

    Examples
    --------
    >>> Command("twice", params=[click.Argument(["number"])]).main([])
    Traceback (most recent call last):
        ...
    SystemExit: 2
    """


class Group(_OneLine, click.Group):
    """A command with commands below it.

    Examples
    --------
    >>> Group("all", commands=[Command("one")]).main(["two"])
    Traceback (most recent call last):
        ...
    SystemExit: 2
    """

    command_class = Command


def _fail_usage(error: click.UsageError) -> NoReturn:
    """Tell what click refuses: options and commands that do not exist or are missing."""
    if type(error).__name__ == "NoArgsIsHelpError":  # not in every version of click
        error.show()
        sys.exit(error.exit_code)
    said = " ".join(error.format_message().split())
    said += "" if said.endswith((".", "?", "?)")) else "."
    see = f" See '{error.ctx.command_path} --help'." if error.ctx is not None else ""
    fail(f"command line: {said[:1].lower()}{said[1:]}{see}", BAD_INPUT)
