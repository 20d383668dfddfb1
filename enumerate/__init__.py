"""The combinatorial side of evrelax: the search over charger subsets.

Import *from* this package (``from enumerate import plan``): ``import enumerate``
would hide the builtin of that name. Every name is imported on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from relax.lazy import export

if TYPE_CHECKING:
    from enumerate.cli import show_versions
    from enumerate.diagnose import Diagnosis
    from enumerate.front import Front, FrontPoint
    from enumerate.ledger import Ledger, Outcome, Row
    from enumerate.pareto import pareto
    from enumerate.result import Result, Status
    from enumerate.search import Progress, plan
    from enumerate.show import format_result
    from enumerate.sweep import Sweep, SweepRow, sweep

__all__ = [
    "Diagnosis",
    "Front",
    "FrontPoint",
    "Ledger",
    "Outcome",
    "Progress",
    "Result",
    "Row",
    "Status",
    "Sweep",
    "SweepRow",
    "format_result",
    "pareto",
    "plan",
    "show_versions",
    "sweep",
]

export(
    __name__,
    {
        "Diagnosis": "diagnose",
        "Front": "front",
        "FrontPoint": "front",
        "Ledger": "ledger",
        "Outcome": "ledger",
        "Progress": "search",
        "Result": "result",
        "Row": "ledger",
        "Status": "result",
        "Sweep": "sweep",
        "SweepRow": "sweep",
        "format_result": "show",
        "pareto": "pareto",
        "plan": "search",
        "show_versions": "cli",
        "sweep": "sweep",
    },
)
