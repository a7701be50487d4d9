"""Which landmarks are compared at all: the bounds leave out no pair that the joint covariance would let through."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from eval.replay.hindsight.duplicates import Landmarks, comparable, squared_distances


def drawn(seed, m, n, rank, spread):
    """Landmarks (m + n) with a joint covariance in which differences may be much surer, or less sure, than each."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(2 * (m + n), rank)) * rng.lognormal(0.0, 1.0, rank)
    return spread * rng.normal(size=(m + n, 2)), A @ A.T


@given(
    st.integers(0, 10**6), st.integers(1, 6), st.integers(1, 6), st.integers(1, 12), st.floats(0.01, 30.0),
    st.floats(0.5, 20.0),
)  # fmt: skip
def test_no_pair_inside_the_gate_is_left_out(seed, m, n, rank, spread, gate):
    xy, P = drawn(seed, m, n, rank, spread)
    variance = np.diag(P).reshape(-1, 2).sum(axis=1)
    slam = SimpleNamespace(places=lambda numbers: (xy[numbers], variance[numbers]))
    young, old = comparable(slam, list(range(m)), list(range(m, m + n)), gate)
    new, there = Landmarks(xy[:m], P[: 2 * m, : 2 * m]), Landmarks(xy[m:], P[2 * m :, 2 * m :])
    d2, _ = squared_distances(new, there, P[: 2 * m, 2 * m :])
    i, j = np.nonzero(d2 < 0.999 * gate)
    assert set(i) <= set(young)
    assert set(m + j) <= set(old)


def test_what_is_far_for_its_variance_is_left_out_and_nothing_is_compared_with_itself():
    xy, variance = np.array([[0.0, 0.0], [1.0, 0.0], [100.0, 0.0]]), np.full(3, 0.5)
    slam = SimpleNamespace(places=lambda numbers: (xy[numbers], variance[numbers]))
    assert comparable(slam, [0, 2], [0, 1, 2], 9.2) == ([0], [1])
    assert comparable(slam, [2], [2], 9.2) == ([], [])
