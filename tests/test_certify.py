"""The certifier against programs with a planted optimum, and attacked: whatever the dual vector,
the bound never exceeds the optimum and infeasibility is never claimed of a feasible program."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
import numpy.typing as npt
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from relax.certify import (
    Infeasible,
    LowerBound,
    Unproved,
    _project,
    certify_infeasible,
    certify_lower_bound,
)
from relax.program import ConeProgram, make_cone_program
from relax.solve import SolveSettings, SolveStatus, solve_cone

Array = npt.NDArray[np.float64]
SEEDS = range(12)


@dataclass(frozen=True)
class Planted:
    """A program whose optimum is known by construction: x, s and z are chosen first."""

    program: ConeProgram
    x: Array
    z: Array
    optimum: float


def planted(seed: int, n: int = 12, scale: float = 1.0) -> Planted:
    rng = np.random.default_rng(seed)
    n_zero, n_nonneg, socs = 3, 14, (3, 4, 3)
    m = n_zero + n_nonneg + sum(socs)
    s, z = np.zeros(m), np.zeros(m)
    z[:n_zero] = rng.normal(size=n_zero)
    active = rng.random(n_nonneg) < 0.5
    s[n_zero : n_zero + n_nonneg] = np.where(active, 0.0, rng.uniform(0.1, 2.0, n_nonneg))
    z[n_zero : n_zero + n_nonneg] = np.where(active, rng.uniform(0.1, 2.0, n_nonneg), 0.0)
    at = n_zero + n_nonneg
    for k, size in enumerate(socs):
        direction = rng.normal(size=size - 1)
        direction /= np.linalg.norm(direction)
        if k % 3 == 0:  # both on the boundary, orthogonal
            s[at], s[at + 1 : at + size] = 1.0, direction
            z[at], z[at + 1 : at + size] = 0.7, -0.7 * direction
        elif k % 3 == 1:  # inactive cone
            s[at], s[at + 1 : at + size] = 2.0, direction
        else:  # at the apex
            z[at], z[at + 1 : at + size] = 1.5, direction
        at += size
    A = rng.normal(size=(m, n)) * np.exp(rng.normal(size=m) * math.log(scale))[:, None]
    x = rng.uniform(-1.0, 1.0, n)
    program = make_cone_program(
        -A.T @ z, A, A @ x + s, n_zero=n_zero, n_nonneg=n_nonneg, soc_sizes=socs,
        l=x - rng.uniform(0.5, 5.0, n), u=x + rng.uniform(0.5, 5.0, n), constant=3.0,
    )  # fmt: skip
    return Planted(program, x, z, float(program.q @ x) + 3.0)


def slack_of(case: Planted) -> float:
    """Rounding of the planted data themselves: q and b are products rounded once."""
    p = case.program
    return 1e-12 * (1.0 + float(np.abs(p.q) @ np.abs(case.x) + np.abs(p.b) @ np.abs(case.z)))


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("scale", [1.0, 30.0])
def test_the_planted_dual_proves_the_optimum(seed: int, scale: float) -> None:
    case = planted(seed, scale=scale)
    bound = certify_lower_bound(case.program, case.z)
    assert isinstance(bound, LowerBound)
    assert bound.value <= case.optimum + slack_of(case)
    assert bound.value >= case.optimum - 1e-9 * (1.0 + abs(case.optimum)) * scale


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("tolerance", [1e-8, 1e-4, 1e-2])
def test_a_solver_dual_gives_a_close_bound_at_any_tolerance(seed: int, tolerance: float) -> None:
    case = planted(seed)
    found = solve_cone(case.program, SolveSettings(tolerance=tolerance))
    bound = certify_lower_bound(case.program, found.z)
    assert isinstance(bound, LowerBound)
    loss = 100.0 * tolerance * (1.0 + abs(case.optimum))
    assert case.optimum - loss < bound.value <= case.optimum + slack_of(case)


ATTACKS = {
    "noise": lambda z, rng: z + rng.normal(size=z.size) * 10.0 ** rng.uniform(-8, 2),
    "scaled": lambda z, rng: z * 10.0 ** rng.uniform(-3, 3),
    "negated": lambda z, rng: -z,
    "cut": lambda z, rng: np.where(rng.random(z.size) < 0.3, 0.0, z),
    "shuffled": lambda z, rng: rng.permutation(z),
    "rounded": lambda z, rng: np.round(z, 1),
    "single precision": lambda z, rng: z.astype(np.float32).astype(np.float64),
    "one entry huge": lambda z, rng: np.where(np.arange(z.size) == z.size // 2, 1e12, z),
    "tiny": lambda z, rng: z * 1e-200,
    "huge": lambda z, rng: z * 1e90,
}


@pytest.mark.parametrize("attack", ATTACKS)
@pytest.mark.parametrize("seed", SEEDS)
def test_no_dual_vector_gives_a_bound_above_the_optimum(seed: int, attack: str) -> None:
    case, rng = planted(seed), np.random.default_rng(seed)
    for _ in range(20):
        bound = certify_lower_bound(case.program, ATTACKS[attack](case.z, rng))
        assert isinstance(bound, LowerBound)
        assert bound.value <= case.optimum + slack_of(case)
        assert isinstance(certify_infeasible(case.program, ATTACKS[attack](case.z, rng)), Unproved)


@settings(max_examples=200, deadline=None, derandomize=True)
@given(
    st.integers(0, 5),
    st.lists(st.floats(-1e6, 1e6, allow_nan=False), min_size=27, max_size=27),
)
def test_any_vector_is_safe(seed: int, values: list[float]) -> None:
    case = planted(seed)
    z = np.array(values)
    bound = certify_lower_bound(case.program, z)
    assert isinstance(bound, LowerBound) and bound.value <= case.optimum + slack_of(case)
    assert isinstance(certify_infeasible(case.program, z), Unproved)


@pytest.mark.parametrize(
    "z", [np.full(27, np.nan), np.full(27, np.inf), np.zeros(26), np.full(27, 1e200)]
)
def test_unusable_vectors_are_unproved(z: Array) -> None:
    case = planted(0)
    assert isinstance(certify_lower_bound(case.program, z), Unproved)
    assert isinstance(certify_infeasible(case.program, z), Unproved)


def test_a_box_without_end_is_unproved() -> None:
    case = planted(0)
    open_ended = replace(case.program, u=np.full(case.program.u.size, np.inf))
    assert isinstance(certify_lower_bound(open_ended, case.z), Unproved)


def test_the_sign_of_an_inequality_is_enforced() -> None:
    # min x subject to x <= 5 on [0, 9] is 0; z = -1 would "prove" 5
    program = make_cone_program([1.0], [[1.0]], [5.0], n_nonneg=1, l=[0.0], u=[9.0])
    bound = certify_lower_bound(program, np.array([-1.0]))
    assert isinstance(bound, LowerBound) and bound.value <= 0.0
    ray = make_cone_program([0.0], [[1.0]], [5.0], n_nonneg=1, l=[0.0], u=[4.0])
    assert isinstance(certify_infeasible(ray, np.array([-1.0])), Unproved)


@pytest.mark.parametrize("seed", SEEDS)
def test_never_above_the_value_in_rational_arithmetic(seed: int) -> None:
    case, rng = planted(seed), np.random.default_rng(seed)
    p = case.program
    A = [[Fraction(float(v)) for v in row] for row in p.A.toarray()]
    b, q, lo, hi = ([Fraction(float(v)) for v in x] for x in (p.b, p.q, p.l, p.u))
    for _ in range(8):
        vector = case.z + rng.normal(size=case.z.size) * 10.0 ** rng.uniform(-12, 3)
        z = [Fraction(float(v)) for v in _project(p, vector)]
        r = [q[i] + sum(A[k][i] * z[k] for k in range(len(z))) for i in range(len(q))]
        exact = 3 - sum(x * y for x, y in zip(b, z, strict=True))
        exact += sum(min(r[i] * lo[i], r[i] * hi[i]) for i in range(len(q)))
        bound = certify_lower_bound(p, vector)
        assert isinstance(bound, LowerBound)
        assert Fraction(bound.value) <= exact
        assert float(exact) - bound.value <= 1e-9 * (1.0 + np.abs(vector).max()) * 10.0


def infeasible(seed: int, gap: float) -> ConeProgram:
    """a'x >= 1 + gap and a'x <= 1 hidden among random rows satisfied by x."""
    case = planted(seed)
    p = case.program
    A = p.A.toarray()
    a = A[p.n_zero]
    row = float(a @ case.x)
    dense = np.vstack([A[: p.n_zero], a, -a, A[p.n_zero :]])
    b = np.concatenate([p.b[: p.n_zero], [row], [-row - gap], p.b[p.n_zero :]])
    return replace(p, A=sp.csc_array(dense), b=b, n_nonneg=p.n_nonneg + 2)


@pytest.mark.parametrize("seed", SEEDS)
def test_infeasible_is_proved_by_the_solver_ray(seed: int) -> None:
    program = infeasible(seed, 0.1)
    found = solve_cone(program)
    assert found.status is SolveStatus.INFEASIBLE
    assert isinstance(certify_infeasible(program, found.z), Infeasible)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("gap", [-0.1, -1e-9, 0.0])
def test_feasible_is_never_called_infeasible(seed: int, gap: float) -> None:
    program = infeasible(seed, gap)
    rng = np.random.default_rng(seed)
    ray = np.zeros(program.b.size)
    ray[program.n_zero : program.n_zero + 2] = 1.0
    for z in (ray, ray + 1e-9 * rng.normal(size=ray.size), solve_cone(program).z):
        assert isinstance(certify_infeasible(program, z), Unproved)


def test_the_error_bound_covers_a_dot_product_that_cancels() -> None:
    # 1e16 + 1 - 1e16 rounds to 0: an honest bound must not claim the exact 1 is reached
    A = np.array([[1e16], [1.0], [-1e16]])
    program = make_cone_program(
        [0.0], A, np.zeros(3), n_zero=3, l=np.array([-1.0]), u=np.array([1.0])
    )
    bound = certify_lower_bound(program, np.ones(3))
    assert isinstance(bound, LowerBound) and bound.value <= -1.0  # r = 1 exactly: min is -1
    rows = make_cone_program(
        [0.0], np.zeros((3, 1)), A[:, 0], n_zero=3, l=np.array([-1.0]), u=np.array([1.0])
    )
    bound = certify_lower_bound(rows, np.ones(3))
    assert isinstance(bound, LowerBound) and bound.value <= -1.0  # b'z = 1 exactly


@pytest.mark.parametrize("seed", SEEDS)
def test_the_cone_projection_is_exact_in_rationals(seed: int) -> None:
    case, rng = planted(seed), np.random.default_rng(seed)
    for size in (1e-160, 1e-8, 1.0, 1e8):
        z = _project(case.program, rng.normal(size=case.z.size) * size)
        at = case.program.n_zero + case.program.n_nonneg
        for k in case.program.soc_sizes:
            tail = sum(Fraction(float(v)) ** 2 for v in z[at + 1 : at + k])
            assert Fraction(float(z[at])) ** 2 >= tail and z[at] >= 0.0
            at += k
