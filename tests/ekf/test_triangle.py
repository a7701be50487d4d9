"""The lower triangle in blocks of rows is the dense symmetric matrix."""

from __future__ import annotations

import numpy as np
import pytest

from ekf.parking import ROWS, Triangle, root
from ekf.updates import subtract


def test_columns_products_and_squares_are_those_of_the_dense_matrix():
    rng = np.random.default_rng(0)
    t, dense = Triangle(), np.zeros((0, 0))
    for size in (40, ROWS, 2 * ROWS + 100, 4 * ROWS + 2):
        t.grow(size)
        larger = np.zeros((size, size))
        larger[: len(dense), : len(dense)] = dense
        dense = larger
        index = rng.permutation(size)[:30]
        columns = rng.normal(size=(size, 30))
        columns[index] = columns[index] + columns[index].T
        t.put(index, columns)
        dense[:, index], dense[index] = columns, columns.T
        C, S = rng.normal(size=(size, 9)), rng.normal(size=(9, 9))
        t.add_product(C @ (S + S.T), C)
        dense += C @ (S + S.T) @ C.T
        index = rng.permutation(size)[:20]
        np.testing.assert_allclose(t.columns(index), dense[:, index], atol=1e-11)
        index.sort()
        np.testing.assert_allclose(t.square(index), dense[np.ix_(index, index)], atol=1e-11)
        at = np.arange(size).reshape(-1, 2)
        np.testing.assert_allclose(t.blocks(), dense[at[:, :, None], at[:, None, :]], atol=1e-11)


def test_a_singular_covariance_has_a_regular_root():
    P = np.diag([1.0, 0.0, 4.0])
    P[0, 2] = P[2, 0] = 2.0
    L = root(P)
    assert np.diag(L).min() > 0.0
    np.testing.assert_allclose((L @ L.T)[np.ix_([0, 2], [0, 2])], P[np.ix_([0, 2], [0, 2])], rtol=1e-6)


@pytest.mark.parametrize("d", [3, 63, 64, 101, 801])
def test_the_update_of_a_covariance_has_the_same_bytes_whichever_way_it_goes(d):
    rng = np.random.default_rng(d)
    W = 0.01 * rng.normal(size=(d, 6))
    P = np.eye(d)
    subtract(P, d, W)
    expected = np.zeros((d, d))
    for i in range(6):
        expected += W[:, i : i + 1] * W[:, i]
    np.testing.assert_array_equal(P, np.eye(d) - expected)
