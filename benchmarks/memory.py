"""How much does one cold command take? Peak memory and wall-clock time.

    python -m benchmarks.memory [--repeats 3] [--trip paper-400km]

Runs ``evrelax plan`` anew and prints the peak resident memory of the largest of its processes
(workers share most of theirs with it) and the wall-clock time from the start of the process to
its end, imports included.
Needs a Unix system (``resource``). Exit code 1 if a limit is missed.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

from benchmarks.machine import processor, versions

__all__ = ["main", "run_cold"]

RESULTS = Path(__file__).parent / "results"
"""Where result files go."""
MEMORY_LIMIT_MB = 300.0
TIME_LIMIT_S = 2.0
WATCH = """
import resource, subprocess, sys
code = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL).returncode
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
sys.exit(code)
"""
"""Runs a command as its only child, so that the children's peak is that command's."""


def run_cold(command: list[str]) -> tuple[float, float]:
    """Return peak resident memory [MB] of a command's largest process, and its time [s].

    Raises
    ------
    subprocess.CalledProcessError
        The command failed.

    Examples
    --------
    >>> memory_mb, seconds = run_cold([sys.executable, "-c", "x = bytearray(50_000_000)"])
    >>> memory_mb > 50.0, 0.0 < seconds < 60.0
    (True, True)
    """
    begin = perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", WATCH, *command], check=True, capture_output=True, text=True
    )
    seconds = perf_counter() - begin  # counts the watcher's own start, about 20 ms
    unit = 1.0 if sys.platform == "darwin" else 1024.0  # bytes there, KiB elsewhere
    return float(done.stdout.split()[-1]) * unit / 1e6, seconds


def main(arguments: list[str] | None = None) -> int:
    """Measure, write the file, print both figures; returns the exit code."""
    parser = argparse.ArgumentParser(prog="benchmarks.memory", description=__doc__)
    parser.add_argument("--repeats", type=int, default=3, help="fresh processes")
    parser.add_argument("--trip", default="paper-400km")
    options = parser.parse_args(arguments)
    if options.repeats < 1:
        parser.error("--repeats must be at least 1")
    command = [sys.executable, "-m", "enumerate.cli", "plan", options.trip, "--quiet"]
    runs = [run_cold(command) for _ in range(options.repeats)]
    memory_mb, seconds = max(m for m, _ in runs), median(s for _, s in runs)
    result: dict[str, Any] = {
        "trip": options.trip,
        "peak_memory_mb": memory_mb,
        "wall_s": seconds,
        "runs": [{"peak_memory_mb": m, "wall_s": s} for m, s in runs],
        "processor": processor(),
        "versions": versions(),
    }
    RESULTS.mkdir(parents=True, exist_ok=True)
    text = json.dumps(result, indent=1) + "\n"
    (RESULTS / "memory.json").write_text(text, encoding="utf-8")
    held = memory_mb < MEMORY_LIMIT_MB and seconds < TIME_LIMIT_S
    print(f"evrelax plan {options.trip}, {options.repeats} cold runs on {processor()}")
    print(f"peak memory  {memory_mb:6.0f} MB  (limit {MEMORY_LIMIT_MB:.0f} MB)")
    print(f"wall clock   {seconds:6.2f} s   (median; limit {TIME_LIMIT_S:.0f} s)")
    print(" ".join(f"{m:.0f} MB {s:.2f} s;" for m, s in runs))
    return 0 if held else 1


if __name__ == "__main__":
    sys.exit(main())
