"""Owns what a measurement must say about where it was made: versions and processor."""

from __future__ import annotations

import os
import platform
import tomllib
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

__all__ = ["keep_to_cores", "make_single_threaded", "processor", "versions"]

PACKAGES = ("evrelax", "casadi", "clarabel", "numpy", "scipy", "osqp")
"""Packages whose version may change a figure."""
THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "BLIS_NUM_THREADS",
    "RAYON_NUM_THREADS",
)
"""Environment variables that libraries read, once, when they are imported."""
ALLOWED = getattr(os, "sched_getaffinity", lambda _: set[int]())(0)
"""Cores that this process may use when it begins; none where the system does not tell."""
PROJECT = Path(__file__).parent.parent / "pyproject.toml"


def make_single_threaded() -> None:
    """Keep this process to one thread per library and one core; call before other imports."""
    for name in THREAD_VARIABLES:
        os.environ[name] = "1"
    keep_to_cores(1)


def keep_to_cores(number: int) -> None:
    """Keep this process, and those it forks from now on, to so many of the cores it may use.

    Examples
    --------
    >>> keep_to_cores(64)  # all there are
    """
    if hasattr(os, "sched_setaffinity"):  # Linux only
        os.sched_setaffinity(0, sorted(ALLOWED)[-number:])


def _of_checkout(name: str) -> str:
    """Return the version that a checkout of a package states, marked as one."""
    if PROJECT.is_file():
        project = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]
        if project["name"] == name:
            return f"{project['version']}+checkout"
    return "not installed"


def versions() -> dict[str, str]:
    """Return versions of Python and of the packages that matter.

    Run from a checkout, our own version is that of its ``pyproject.toml``, ``+checkout`` added:
    which code that is say the digests of ``sources``.

    Examples
    --------
    >>> "python" in versions() and "numpy" in versions()
    True
    >>> versions()["evrelax"] != "not installed"
    True
    """
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = _of_checkout(name)
    return found


def processor() -> str:
    """Return the name of the processor and the number of cores.

    Examples
    --------
    >>> processor().endswith("cores")
    True
    """
    name = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.is_file():
        for line in info.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                name = line.split(":", 1)[1].strip()
                break
    return f"{name}, {os.cpu_count()} cores"
