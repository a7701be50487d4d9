"""Parking landmarks, in epochs too, changes nothing but the size of the state; oracle: a filter that never parks."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import event, given, settings, strategies as st

from association.decide import known_decisions
from data import se2
from data.inputs import FrameObservations, Increment, Prior, Systematic
from data.result import DISCARD, NEW
from data.sensors import Line, RangeBearing, RelativePoint
from data.worlds.registry import named_log
from ekf import whole_run as epochs
from ekf.filter import FilterOptions
from ekf.slam import JOINED, EkfSlam
from ekf.whole_run import plan, run_filter, worthwhile
from tests.builders.estimators import assert_close
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


@pytest.fixture(scope="module")
def park():
    inputs = named_log("park:1:frames=800+spacing=2.5").inputs(labels=True).without_map()
    decisions, _ = known_decisions(inputs)
    return inputs, np.where((decisions >= 0) & (np.arange(len(decisions)) % 97 == 0), DISCARD, decisions)


def assert_same_run(run, plain):
    assert_close(run, plain)
    np.testing.assert_allclose(run.log_likelihood, plain.log_likelihood, rtol=1e-9, atol=1e-8)
    np.testing.assert_allclose(run.white, plain.white, rtol=1e-9, atol=1e-8)
    assert run.failure == plain.failure


@pytest.mark.parametrize(("options", "threshold"), [
    (FilterOptions(), np.inf), (FilterOptions(), 3.0), (FilterOptions(first_estimates=True), np.inf),
    (FilterOptions(new_variance=4.0), np.inf),
])  # fmt: skip
def test_epochs_change_nothing(park, options, threshold):
    inputs, decisions = park
    found = plan(decisions, inputs.start).epochs
    run = run_filter(inputs, decisions, threshold=threshold, options=options, epochs=found)
    assert_same_run(run, run_filter(inputs, decisions, threshold=threshold, options=options))
    if np.isfinite(threshold):
        assert (run.decisions != decisions).sum() > 20, "gated while landmarks were parked"
    active = np.array([len(e.active) for e in found])
    assert np.sum(active < 0.3 * len(run.map.number)) > 10, "most of the map is parked most of the time"


@pytest.mark.parametrize("options", [FilterOptions(), FilterOptions(first_estimates=True)], ids=["plain", "fej"])
def test_epochs_change_nothing_where_systematic_errors_are_estimated(park, options):
    inputs, decisions = park
    of = Systematic(("left", "drift", "range", "bearing"), np.full(4, 0.01), 20.0)
    inputs = replace(inputs, systematic=of, sensor=replace(inputs.sensor, translation=(0.1, -0.05)))
    run = run_filter(inputs, decisions, options=options, epochs=plan(decisions, inputs.start).epochs)
    plain = run_filter(inputs, decisions, options=options)
    assert_same_run(run, plain)
    np.testing.assert_allclose(run.errors.mean, plain.errors.mean, atol=1e-11)
    np.testing.assert_allclose(run.errors.sigma, plain.errors.sigma, rtol=1e-9)


def test_a_failure_is_that_of_the_plain_filter(park):
    """Half way the covariance of an increment is negative: written into the inputs, which are checked when made."""
    given, decisions = park
    inputs, at = copy.deepcopy(given), len(given) // 2
    covariance = inputs.increments.covariance
    covariance.setflags(write=True)
    covariance[at] = -1e3 * np.eye(3)
    run = run_filter(inputs, decisions, epochs=plan(decisions, inputs.start).epochs)
    plain = run_filter(inputs, decisions)
    assert run.failure == plain.failure
    assert plain.failure[0] == at
    np.testing.assert_array_equal(run.state_size, plain.state_size)
    assert len(run.map.number) == len(plain.map.number)
    np.testing.assert_array_equal(np.isnan(run.pose), np.isnan(plain.pose))


def test_a_small_map_and_filters_that_move_everything_are_left_alone(park, monkeypatch):
    inputs, decisions = park
    assert worthwhile(inputs, decisions) is None, "too few landmarks"
    monkeypatch.setattr(epochs, "LEAST", 50)
    assert worthwhile(inputs, decisions) is not None
    assert worthwhile(inputs, decisions, FilterOptions(first_estimates=True)) is not None
    assert worthwhile(inputs, decisions, FilterOptions(invariant=True)) is None
    assert worthwhile(inputs, decisions, FilterOptions(iterations=3)) is None


SENSORS = [
    RangeBearing(), RangeBearing(rotation=0.3, translation=(0.4, -0.2)), RelativePoint(translation=(0.5, 0.0)),
    Line(translation=(0.3, 0.1)),
]  # fmt: skip


@settings(max_examples=examples(20), deadline=None)
@given(
    seed=st.integers(0, 10**6),
    sensor=st.sampled_from(SENSORS),
    within=st.sampled_from([1.0, 9.2, 23.0]),
    drift=st.sampled_from([0.02, 0.2]),
)
def test_no_parked_landmark_inside_the_gate_is_missed(seed, sensor, within, drift):
    rng = np.random.default_rng(seed)
    prior = Prior(np.array([1.0, -2.0, 3.0]), np.diag([0.04, 0.01, 0.002]))
    places = rng.uniform(-25, 25, (150, 2))
    truth = prior.mean.copy()
    f, full = EkfSlam(prior, sensor), EkfSlam(prior, sensor)
    number = {}
    inside = found_in_all = asked = 0
    for k in range(45):
        u = np.array([1.0, 0.0, 0.15])
        L = rng.normal(size=(3, 3)) * drift * np.array([[1.0], [1.0], [0.1]])
        P = L @ L.T + 1e-8 * np.eye(3)
        truth = se2.compose(truth, u + np.linalg.cholesky(P) @ rng.normal(size=3))
        for g in (f, full):
            g.predict(Increment(u, P))
        seen = np.argsort(np.hypot(*(places - truth[:2]).T))[: 4 if k else 8]
        z = sensor.predict(truth, places[seen]) + rng.normal(size=(len(seen), 2)) * [0.05, 0.02]
        observations = FrameObservations(z, np.tile(np.diag([0.0025, 0.0004]), (len(seen), 1, 1)))
        parked = f.parked
        near = f.parked_within(observations, within)
        if len(parked):
            e = full.expect(observations)
            must = parked[e.individual_distances()[:, np.isin(e.number, parked)].min(axis=0) <= within]
            assert np.isin(must, near).all(), f"missed {np.setdiff1d(must, near)}"
            inside, asked, found_in_all = inside + len(must), asked + len(parked), found_in_all + len(near)
        decisions = np.array([number.get(p, NEW) for p in seen.tolist()])
        f.restore(np.intersect1d(decisions, f.parked))
        done = f.update(observations, decisions)
        full.update(observations, decisions)
        number.update((int(p), int(n)) for p, n in zip(seen, done.created) if n >= 0)
        if rng.random() < 0.3:
            f.park(f.active[rng.random(len(f.active)) < 0.8])
    event(f"{'some' if inside else 'no'} parked landmark was inside the gate")
    event(f"{'less' if found_in_all < 0.5 * asked else 'more'} than half were taken for near")


SENSOR = RangeBearing(max_range=20.0)
R = np.diag([0.05, 0.01]) ** 2


def mapped():
    """A filter that initialized the first two of four landmarks again after a way with drift."""
    rng = np.random.default_rng(1)
    f = EkfSlam(Prior(np.zeros(3), np.diag([0.01, 0.01, 0.001]) ** 2), SENSOR)
    z = np.array([[5.0, 0.2], [6.0, -0.5], [7.0, 0.8], [4.0, 1.2]])
    f.update(FrameObservations(z, np.tile(R, (4, 1, 1))), np.full(4, NEW))
    for _ in range(10):
        f.predict(Increment(np.array([0.01, 0.0, 0.0]), np.diag([0.05, 0.05, 0.01]) ** 2))
    z = z[:2] + rng.normal(0.0, [0.05, 0.01], (2, 2))
    f.update(FrameObservations(z, np.tile(R, (2, 1, 1))), np.full(2, NEW))
    return f


def test_positions_are_those_of_the_landmarks_asked_for_and_joining_conditions_on_their_difference_being_zero():
    f = mapped()
    at, cov = f.position(np.array([3, 1]))
    assert at.tolist() == f.mean[[9, 10, 5, 6]].tolist()
    assert np.array_equal(cov, f.covariance[np.ix_([9, 10, 5, 6], [9, 10, 5, 6])])
    mean, P = f.mean, f.covariance
    H = np.zeros((4, len(mean)))
    H[:, 11:15], H[:, 3:7] = np.eye(4), -np.eye(4)
    posterior = np.linalg.inv(np.linalg.inv(P) + H.T @ H / JOINED**2)
    expected = posterior @ np.linalg.solve(P, mean)
    f.merge(np.array([4, 5]), np.array([0, 1]))
    np.testing.assert_allclose(f.mean, expected[:11], atol=1e-6)
    np.testing.assert_allclose(f.covariance, posterior[:11, :11], atol=1e-8)
    assert np.linalg.eigvalsh(f.covariance)[0] > 0.0
    assert np.linalg.eigvalsh(P[:3, :3] - f.covariance[:3, :3])[0] > 0.0
    assert f.finish().map.number.tolist() == [0, 1, 2, 3]
    again = f.update(FrameObservations(np.array([[9.0, 0.0]]), R[None]), np.array([NEW]))
    assert again.created.tolist() == [6], "numbers are not used again"
