"""Writes the shipped vehicle presets: ``python -m benchmarks.data.vehicles [--check]``.

Owns the command only; the figures live in ``paper`` and ``cars``.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from benchmarks.data.cars import CARS, car_preset
from benchmarks.data.emit import DATA, deliver, render
from benchmarks.data.paper import paper_2022

__all__ = ["main", "texts"]


def texts() -> dict[str, str]:
    """Return the text of every vehicle preset by name.

    Examples
    --------
    >>> "paper-2022" in texts()
    True
    """
    made = [paper_2022(), *(car_preset(car) for car in CARS)]
    return {str(fields[0].value): render(header, fields) for header, fields in made}


def main(argv: Sequence[str] | None = None) -> int:
    """Write or compare all vehicle presets; return 1 when a compared file differs."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.data.vehicles", description=__doc__)
    parser.add_argument("--check", action="store_true", help="compare, write nothing")
    check = parser.parse_args(argv).check
    same = [deliver(DATA / "vehicles" / f"{n}.toml", t, check) for n, t in texts().items()]
    return 0 if all(same) else 1


if __name__ == "__main__":
    sys.exit(main())
