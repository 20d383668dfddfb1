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
    from enumerate.ledger import Ledger, Outcome, Row
    from enumerate.result import Result, Status
    from enumerate.search import Progress, plan
    from enumerate.show import format_result

__all__ = [
    "Diagnosis",
    "Ledger",
    "Outcome",
    "Progress",
    "Result",
    "Row",
    "Status",
    "format_result",
    "plan",
    "show_versions",
]

export(
    __name__,
    {
        "Diagnosis": "diagnose",
        "Ledger": "ledger",
        "Outcome": "ledger",
        "Progress": "search",
        "Result": "result",
        "Row": "ledger",
        "Status": "result",
        "format_result": "show",
        "plan": "search",
        "show_versions": "cli",
    },
)
