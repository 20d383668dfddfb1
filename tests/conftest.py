"""Owns the fixtures of tests that write a plan's proofs to a file and read them back.

A file of tests that asks for them has a ``TRIP`` and a fixture ``result``, its plan with proofs.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from enumerate import Result, load_proofs, save_proofs
from enumerate.evidence import Evidence

pytest.register_assert_rewrite("audited", "input_errors", "staged")


@pytest.fixture(scope="module")
def file(
    request: pytest.FixtureRequest, result: Result, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """The proofs of the module's result."""
    path = tmp_path_factory.mktemp("proofs") / "trip.proofs"
    save_proofs(path, request.module.TRIP, result)
    return path


@pytest.fixture(scope="module")
def evidence(file: Path) -> Evidence:
    """What that file says."""
    return load_proofs(file)
