"""Parking landmarks changes nothing but the size of the state: the filter that never parks is the oracle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import event, given, settings
from hypothesis import strategies as st

from data import se2
from data.inputs import FrameObservations, Increment, Prior, Systematic
from data.result import DISCARD, NEW
from data.sensors import Line, RangeBearing, RelativePoint
from ekf.filter import FilterOptions
from ekf.slam import EkfSlam
from tests.quick import examples

NOBODY = np.empty(0, np.int64)
NOTHING_SEEN = FrameObservations(np.empty((0, 2)), np.empty((0, 2, 2)))
OF_ODOMETRY = Systematic(("scale", "curvature", "drift"), np.array([0.02, 2e-3, 1e-3]), 5.0)
ERRORS = Systematic((*OF_ODOMETRY.names, "range", "bearing"), np.append(OF_ODOMETRY.sigma, [0.03, 0.02]), 5.0)
PRIOR = Prior(np.array([1.0, -2.0, 3.0]), np.diag([0.04, 0.01, 0.002]))


def assert_same(a, b):
    a, b = np.asarray(a), np.asarray(b)
    assert a.shape == b.shape
    assert np.abs(a - b).max(initial=0.0) <= 1e-9 * max(np.abs(b).max(initial=0.0), 1e-3)


def assert_agree(f, full):
    """`f` holds, in state and map, what `full` holds, landmark by landmark."""
    everything, mine = full.finish().map, f.finish().map
    assert np.array_equal(mine.number, everything.number)
    assert_same(mine.xy, everything.xy)
    assert_same(mine.covariance, everything.covariance)
    parked = np.isin(everything.number, f.parked)
    assert parked.sum() == len(f.parked)
    assert_same(f.parked_xy(), everything.xy[parked])
    active = f.expect(NOTHING_SEEN).number
    assert sorted(active) == everything.number[~parked].tolist()
    assert f.size == len(f.mean) == f.base + 2 * len(active)
    slot = np.searchsorted(everything.number, active)
    rows = np.concatenate([np.arange(f.base), (f.base + 2 * slot[:, None] + np.arange(2)).ravel()])
    assert np.abs(se2.wrap_angle(f.mean[2] - full.mean[2])) < 1e-9
    assert_same(np.delete(f.mean, 2), np.delete(full.mean[rows], 2))
    assert_same(f.covariance, full.covariance[np.ix_(rows, rows)])
    e, whole = f.expect(NOTHING_SEEN), full.expect(NOTHING_SEEN)
    assert_same(e.z_hat, whole.z_hat[slot])
    some = np.arange(len(slot))[::-2]
    assert_same(e.joint(some), whole.joint(slot[some]))
    assert f._used <= full.size, "parking never makes a step dearer"


def some_of(rng, numbers, share):
    return np.asarray(numbers, np.int64)[rng.random(len(numbers)) < share]


@settings(max_examples=examples(50), deadline=None)
@given(
    seed=st.integers(0, 10**6),
    sensor=st.sampled_from([RangeBearing(rotation=0.3, translation=(0.2, -0.1)), RelativePoint(), Line(rotation=0.2)]),
    threshold=st.sampled_from([np.inf, 3.0]),
    options=st.builds(FilterOptions, new_variance=st.sampled_from([None, None, 4.0])),
    parking=st.sampled_from([0.1, 0.7]),
    errs=st.booleans(),
)
def test_a_filter_that_parks_equals_one_that_never_does(seed, sensor, threshold, options, parking, errs):
    rng = np.random.default_rng(seed)
    places = rng.uniform(-10, 10, (20, 2))
    truth = PRIOR.mean.copy()
    if not sensor.sees_points:
        options = replace(options, new_variance=None)
    errors = None if not errs else ERRORS if sensor.sees_points else OF_ODOMETRY
    f, full = (EkfSlam(PRIOR, sensor, options, systematic=errors) for _ in range(2))
    place_of, parked = {}, set()
    for _ in range(30):
        u = np.array([0.5, 0.0, 0.4]) + rng.normal(size=3) * [0.1, 0.05, 0.1]
        L = rng.normal(size=(3, 3)) * 0.03
        truth = se2.compose(truth, u)
        for g in (f, full):
            g.predict(Increment(u, L @ L.T + 1e-6 * np.eye(3)))
        if rng.random() < 0.4:
            away = some_of(rng, sorted(set(place_of) - parked), parking)
            f.park(away)
            parked.update(away.tolist())
        if rng.random() < 0.15:
            gone = some_of(rng, sorted(place_of), 0.1)
            for g in (f, full):
                g.remove(gone)
            parked.difference_update(gone.tolist())
            for n in gone.tolist():
                del place_of[n]
        back = some_of(rng, sorted(parked), 0.08)
        f.restore(back)
        parked.difference_update(back.tolist())
        assert f.parked.tolist() == sorted(parked)
        held = {place: n for n, place in place_of.items()}
        seen = np.array([p for p in rng.permutation(len(places))[:4] if held.get(p) not in parked], np.int64)
        decisions = np.array([held.get(p, rng.choice([NEW, DISCARD])) for p in seen], np.int64)
        z = sensor.predict(truth, places[seen]) + rng.normal(size=(len(seen), 2)) * [0.1, 0.03]
        observations = FrameObservations(z, np.tile(np.diag([0.01, 0.0009]), (len(seen), 1, 1)))
        done, expected = (g.update(observations, decisions, threshold=threshold) for g in (f, full))
        assert np.array_equal(done.used, expected.used)
        assert np.array_equal(done.created, expected.created)
        assert done.dof == expected.dof
        assert_same([done.nis, done.log_likelihood], [expected.nis, expected.log_likelihood])
        if (done.used != (decisions >= 0)).any() and parked:
            event("a pairing is gated while landmarks are parked")
        place_of.update((int(n), int(p)) for n, p in zip(done.created, seen) if n >= 0)
        event(f"epochs begin with {'the active part' if f._parked.k else 'the parked part'}")
        assert_agree(f, full)
    f.restore(f.parked)
    assert_agree(f, full)
    if errors is not None:
        assert_same(f.errors[0], full.errors[0])
        assert_same(f.errors[1], full.errors[1])
    assert f._used == f.size == full.size
    assert np.array_equal(f.covariance, f.covariance.T)
    assert np.linalg.eigvalsh(f.covariance)[0] > 0


def initialized(n=4):
    f = EkfSlam(PRIOR, RelativePoint())
    z = np.stack([np.arange(1.0, n + 1), np.ones(n)], 1)
    f.update(FrameObservations(z, np.tile(0.01 * np.eye(2), (n, 1, 1))), np.full(n, NEW))
    return f


def test_what_cannot_be_parked_restored_or_paired_is_named_and_changes_nothing():
    f = initialized()
    f.park(np.array([2]))
    before = f.covariance
    one = FrameObservations(np.array([[2.0, 1.0]]), 0.01 * np.eye(2)[None])
    with pytest.raises(ValueError, match="cannot park landmark 2: it is parked already"):
        f.park(np.array([1, 2]))
    with pytest.raises(ValueError, match="cannot park landmark 9: no landmark has this number"):
        f.park(np.array([1, 9]))
    with pytest.raises(ValueError, match="cannot restore landmark 1: it is not parked"):
        f.restore(np.array([2, 1]))
    with pytest.raises(ValueError, match="landmark 2 is parked: restore it first"):
        f.update(one, np.array([2]))
    with pytest.raises(ValueError, match=r"cannot remove \[2, 9\]: not all are in the map"):
        f.remove(np.array([2, 9]))
    assert f.parked.tolist() == [2]
    assert np.array_equal(f.covariance, before)
    f.remove(np.array([2]))
    with pytest.raises(ValueError, match="cannot restore landmark 2: it is not parked"):
        f.restore(np.array([2]))
    with pytest.raises(ValueError, match="no landmark has number 2"):
        f.update(one, np.array([2]))


def test_parking_makes_expectations_stale_and_parking_nobody_does_not():
    f = initialized()
    e = f.expect(NOTHING_SEEN)
    f.park(NOBODY)
    f.restore(NOBODY)
    assert e.joint(np.array([0])).shape == (2, 2)
    f.park(np.array([0]))
    with pytest.raises(RuntimeError, match="updated since"):
        e.joint(np.array([0]))
    e = f.expect(NOTHING_SEEN)
    assert e.number.tolist() == [1, 2, 3]
    f.restore(np.array([0]))
    with pytest.raises(RuntimeError, match="updated since"):
        e.joint(np.array([0]))
