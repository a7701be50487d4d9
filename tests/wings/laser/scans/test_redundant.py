"""Key poses that tell little go: the ones that a search without tricks would take, and nothing known is lost by it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data.inputs import Prior
from data.se2 import between, compose, dead_reckoned, inverse, pose_error
from graph.batch import smooth
from graph.problem import Start
from tests.graph.poses.worlds import NONE, World
from wings.laser.scans.constraints import Chain, Loops
from wings.laser.scans.redundant import CELL, MOST_IN_A_ROW, cells_of, least_informative, redundant, without

PRIOR = Prior(np.array([1.0, -2.0, 0.4]), np.diag([1e-2, 1e-2, 1e-3]))


def scans(seed, keys):
    """End points in a few dozen cells, seen by several key poses or by one."""
    rng = np.random.default_rng(seed)
    return [CELL * rng.integers(0, 4, (rng.integers(0, 12), 2)) + 0.5 * CELL for _ in range(keys)]


def searched(ends, least):
    """The same by its definition: all shares anew before each that goes."""
    cells = [{(math.floor(x / CELL), math.floor(y / CELL)) for x, y in e} for e in ends]
    gone = [False] * len(ends)

    def share(k):
        if not cells[k]:
            return 0.0
        seen = [sum(c in cells[j] for j in range(len(ends)) if not gone[j]) for c in cells[k]]
        return sum(1.0 / n for n in seen) / len(seen)

    def longest(k):
        trial = [g or j == k for j, g in enumerate(gone)]
        return max(len(run) for run in "".join("x" if t else " " for t in trial).split())

    while True:
        may = [k for k in range(1, len(ends) - 1) if not gone[k] and longest(k) <= MOST_IN_A_ROW]
        told = [(round(share(k), 12), k) for k in may]
        if not told or min(told)[0] >= least:
            return gone
        gone[min(told)[1]] = True


@given(st.integers(0, 10**6), st.integers(2, 9), st.sampled_from([0.01, 0.2, 0.5, 0.9]))
def test_the_same_key_poses_go_as_in_a_plain_search(seed, keys, least):
    ends = scans(seed, keys)
    assert redundant(ends, least).tolist() == searched(ends, least)


def test_those_to_keep_stay_and_no_more_go_than_may():
    cells = [cells_of(np.array([[0.05, 0.05], [0.15, 0.05]]))] * 8
    keep = np.arange(8) < 2
    every = least_informative(cells, 0.4, keep)
    assert every.tolist() == [False, False, *[True] * 6]
    assert least_informative(cells, 0.4, keep, most=2).tolist() == [False, False, True, True, *[False] * 4]
    assert not least_informative(cells, 0.4, np.ones(8, bool)).any()


def test_a_place_that_was_seen_often_keeps_a_key_pose_now_and_then_and_a_new_place_every_one():
    again = [np.array([[0.05, 0.05], [1.05, 0.05]])] * 12
    new = [np.array([[5.05 + k, 0.05]]) for k in range(6)]
    gone = redundant([*again, *new], 0.2)
    assert not gone[12:].any()
    assert not gone[0]
    kept = np.flatnonzero(~gone)
    assert gone[:12].sum() >= 6
    assert np.diff(kept).max() <= MOST_IN_A_ROW + 1


def graph(seed, keys, closures, noise):
    """A chain and loop closures around a true path, and the path."""
    rng = np.random.default_rng(seed)
    motion = np.column_stack([rng.uniform(0.2, 0.6, keys), rng.normal(0, 0.05, keys), rng.normal(0, 0.4, keys)])
    motion[0] = 0.0
    path = dead_reckoned(PRIOR.mean, motion)

    def error(count):
        A = rng.normal(size=(count, 3, 3)) * np.array([0.02, 0.02, 0.01])[:, None]
        return A @ A.transpose(0, 2, 1) + 1e-6 * np.eye(3)

    pairs = np.sort(rng.choice(keys, (closures, 2)), axis=1)
    pairs = pairs[pairs[:, 1] > pairs[:, 0] + 1]
    C, D = error(keys), error(len(pairs))
    C[0] = 0.0
    relative = between(path[pairs[:, 0]], path[pairs[:, 1]])
    frames = 3 * keys
    key = np.arange(frames) // 3
    since = np.column_stack([0.05 * (np.arange(frames) % 3), np.zeros(frames), 0.01 * (np.arange(frames) % 3)])
    since_covariance = (np.arange(frames) % 3)[:, None, None] * 1e-4 * np.eye(3)
    moved = motion + noise * rng.normal(size=motion.shape) * (np.arange(keys) > 0)[:, None]
    chain = Chain(3 * np.arange(keys), moved, C, key, since, since_covariance)
    believed = np.minimum(pairs[:, 1] + rng.integers(0, 3, len(pairs)), keys - 1)
    loops = Loops(pairs[:, 0], pairs[:, 1], relative, D, np.ones(len(pairs)), believed)
    return path, chain, loops


def gone_of(seed, keys):
    gone = np.random.default_rng(seed).random(keys) < 0.5
    gone[0] = False
    return gone


def solved(chain, loops):
    world = World(np.zeros((len(chain.motion), 3)), chain.motion, chain.covariance, *(
        getattr(loops, name) for name in ("key1", "key2", "relative", "covariance")
    ))  # fmt: skip
    inputs = replace(world.inputs(), prior=PRIOR)
    return smooth(inputs, NONE, NONE, Start(dead_reckoned(PRIOR.mean, chain.motion), np.zeros((0, 2)))).trajectory


@given(st.integers(0, 10**6), st.integers(4, 15), st.integers(0, 12))
def test_exact_constraints_stay_exact_and_every_frame_keeps_its_place(seed, keys, closures):
    path, chain, loops = graph(seed, keys, closures, 0.0)
    gone = gone_of(seed, keys)
    thin, left = without(chain, loops, gone)
    assert (thin.frame == chain.frame[~gone]).all()
    assert (
        np.abs(pose_error(between(path[~gone][left.key1], path[~gone][left.key2]), left.relative)).max(initial=0) < 1e-9
    )
    before, after = (compose(p[c.key], c.since) for p, c in ((path, chain), (path[~gone], thin)))
    assert np.abs(pose_error(after, before)).max() < 1e-9
    assert (left.key1 < left.key2).all()
    assert (left.believed >= left.key2).all()


@given(st.integers(0, 10**6), st.integers(4, 10))
def test_without_loop_closures_the_key_poses_left_are_as_certain_as_before(seed, keys):
    _, chain, loops = graph(seed, keys, 0, 0.02)
    gone = gone_of(seed, keys)
    thin, left = without(chain, loops, gone)
    whole, less = solved(chain, loops), solved(thin, left)
    assert less.pose == pytest.approx(whole.pose[~gone], abs=1e-7)
    assert less.covariance == pytest.approx(whole.covariance[~gone], rel=1e-5, abs=1e-12)


def jacobian(f, x):
    steps = 1e-6 * np.eye(3)
    return np.stack([(f(x + d) - f(x - d)) / 2e-6 for d in steps], axis=1)


@pytest.mark.parametrize(("loose", "to"), [(5, 5), (6, 4)])
def test_a_closure_leads_to_the_key_pose_that_is_surer_along_the_chain(loose, to):
    _, chain, _ = graph(0, 8, 0, 0.0)
    C = np.tile(1e-4 * np.diag([1.0, 2.0, 3.0]), (8, 1, 1))
    C[loose] *= 100.0
    one, relative, error = np.array([5]), np.array([2.0, -1.0, 0.7]), 1e-4 * np.diag([3.0, 1.0, 2.0])
    loops = Loops(np.array([1]), one, relative[None], error[None], np.ones(1), one)
    _, left = without(replace(chain, covariance=C), loops, np.arange(8) == 5)
    assert left.key2.tolist() == [to]  # 5 was key pose 6
    assert left.believed.tolist() == [5]  # never before it was found
    step = chain.motion[6] if to == 5 else chain.motion[5]
    way = (lambda m: m) if to == 5 else inverse
    J, D = jacobian(lambda r: compose(r, way(step)), relative), jacobian(lambda m: compose(relative, way(m)), step)
    assert left.relative[0] == pytest.approx(compose(relative, way(step)))
    surer = C[6] if to == 5 else C[5]
    assert left.covariance[0] == pytest.approx(J @ error @ J.T + D @ surer @ D.T, rel=1e-6, abs=1e-12)
