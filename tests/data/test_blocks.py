"""Joint covariances of points: what stands where, written out for few points and as loops for more."""

import numpy as np
import pytest

from data.blocks import (
    add_to_diagonal,
    block_diagonal,
    blocks_of,
    coordinates,
    coordinates_from,
    diagonal_blocks,
    of_points,
)


@pytest.fixture
def P():
    return np.arange(64.0).reshape(8, 8)


def test_point_i_stands_in_rows_2i_and_2i_plus_1():
    assert coordinates(np.array([2, 0])).tolist() == [4, 5, 0, 1]
    assert coordinates_from(np.array([7, 3])).tolist() == [7, 8, 3, 4]
    assert coordinates(np.empty(0, np.int64)).tolist() == []


def test_the_covariance_of_some_points_is_in_the_order_asked_for(P):
    chosen = of_points(P, np.array([3, 1]))
    assert np.array_equal(chosen, P[np.ix_([6, 7, 2, 3], [6, 7, 2, 3])])
    chosen[:] = 0.0
    assert P.any(axis=1).all(), "a copy"


def test_blocks_are_those_that_slices_cut_out(P):
    blocks = blocks_of(P[:, :6])
    assert blocks.shape == (4, 3, 2, 2)
    for i in range(4):
        for j in range(3):
            assert np.array_equal(blocks[i, j], P[2 * i : 2 * i + 2, 2 * j : 2 * j + 2])
    assert np.array_equal(diagonal_blocks(P), [P[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] for i in range(4)])
    part = P[2:, 2:]
    assert np.array_equal(diagonal_blocks(part), diagonal_blocks(P)[1:])


def test_independent_points_have_no_covariance_between_them(P):
    own = diagonal_blocks(P)
    whole = block_diagonal(own)
    assert np.array_equal(diagonal_blocks(whole), own)
    assert np.count_nonzero(whole) <= own.size
    assert block_diagonal(np.empty((0, 2, 2))).shape == (0, 0)


def test_what_is_added_to_the_diagonal_is_added_in_place_from_the_first_point_on(P):
    before = P.copy()
    add_to_diagonal(P, np.array([np.eye(2), 2.0 * np.eye(2)]))
    assert np.array_equal(P - before, np.diag([1.0, 1.0, 2.0, 2.0, 0.0, 0.0, 0.0, 0.0]))
