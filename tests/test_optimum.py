"""A proof goes on from a relaxation that has been solved before it."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from relax import load_trip, make_instance
from relax.bound import relax_subset
from relax.tighten import tighten

MILD = load_trip("paper-400km", {"route.ambient_c": 0.0})


@pytest.mark.parametrize("subset", [(1,), (1, 2)])
def test_a_proof_goes_on_from_a_relaxation_that_was_solved_before(subset: tuple[int, ...]) -> None:
    instance = make_instance(MILD, subset)
    relaxed = relax_subset(instance)
    known = relaxed.optimum
    assert known is not None and relaxed.lower_bound is not None
    cutoff = relaxed.lower_bound * 1.01
    anew = tighten(instance, known.box, cutoff, fresh=True)
    on = tighten(instance, known.box, cutoff, fresh=True, known=known)
    assert on.programs == anew.programs - 1
    assert (on.closed, on.bound, on.proved) == (anew.closed, anew.bound, anew.proved)
    assert [s.kind for s in on.steps] == [s.kind for s in anew.steps]
    np.testing.assert_array_equal(on.steps[0].dual, relaxed.steps[0].dual)


def test_a_wrong_dual_vector_handed_over_proves_less() -> None:
    instance = make_instance(MILD, (1,))
    known = relax_subset(instance).optimum
    assert known is not None
    wrong = replace(known, z=np.random.default_rng(3).normal(size=known.z.size))
    done = tighten(instance, known.box, np.inf, fresh=True, known=wrong)
    right = tighten(instance, known.box, np.inf, fresh=True, known=known)
    assert done.bound <= right.bound * (1.0 + 1e-4)


def test_an_optimum_goes_to_another_process_whole() -> None:
    known = relax_subset(make_instance(MILD, (1,))).optimum
    assert known is not None
    copy = pickle.loads(pickle.dumps(known))
    np.testing.assert_array_equal(copy.program.A.toarray(), known.program.A.toarray())
    assert copy.program.variables.keys() == known.program.variables.keys()
    with pytest.raises(TypeError):
        copy.program.rows["new"] = np.zeros(1)
