"""The combinatorial side of evrelax: the search over charger subsets.

Import *from* this package (``from enumerate import plan``): ``import enumerate``
would hide the builtin of that name. Every name is imported on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from relax.lazy import export

if TYPE_CHECKING:
    from enumerate.audit import Audit, audit
    from enumerate.cli import show_versions
    from enumerate.diagnose import Diagnosis
    from enumerate.evidence import ProofNode
    from enumerate.evidence_file import load_proofs, save_proofs
    from enumerate.explore import Progress
    from enumerate.front import Front, FrontPoint
    from enumerate.ledger import Ledger, Outcome, Row
    from enumerate.pareto import pareto
    from enumerate.result import Result, Status
    from enumerate.search import plan
    from enumerate.show import format_result
    from enumerate.sweep import Sweep, SweepRow, sweep

__all__ = [
    "Audit",
    "Diagnosis",
    "Front",
    "FrontPoint",
    "Ledger",
    "Outcome",
    "Progress",
    "ProofNode",
    "Result",
    "Row",
    "Status",
    "Sweep",
    "SweepRow",
    "audit",
    "format_result",
    "load_proofs",
    "pareto",
    "plan",
    "save_proofs",
    "show_versions",
    "sweep",
]

export(
    __name__,
    {
        "Audit": "audit",
        "Diagnosis": "diagnose",
        "Front": "front",
        "FrontPoint": "front",
        "Ledger": "ledger",
        "Outcome": "ledger",
        "Progress": "explore",
        "ProofNode": "evidence",
        "Result": "result",
        "Row": "ledger",
        "Status": "result",
        "Sweep": "sweep",
        "SweepRow": "sweep",
        "audit": "audit",
        "format_result": "show",
        "load_proofs": "evidence_file",
        "pareto": "pareto",
        "plan": "search",
        "save_proofs": "evidence_file",
        "show_versions": "cli",
        "sweep": "sweep",
    },
)
