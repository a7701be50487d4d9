"""iSAM2 with what the run has learned since: landmarks removed and joined, pairings amended, motions not believed."""

from __future__ import annotations

import numpy as np
import pytest

from association.decide import known_decisions
from data.inputs import FrameObservations, Increment
from data.result import DISCARD, NEW
from ekf.slam import EkfSlam
from graph.incremental import Isam2Smoother
from tests.graph.driving import TIGHT, drive, every_sensor, parted
from tests.graph.worlds import SENSORS, circle


@every_sensor
def test_removing_a_landmark_leaves_what_there_would_be_without_its_sightings(sensor):
    inputs, _, _ = circle(sensor)
    inputs = inputs.without_map()
    decisions, created = known_decisions(inputs)
    gone = np.array([1, 4])
    s, *_ = drive(inputs, decisions, **TIGHT)
    # past the last update, so that motion is pending when the landmarks go
    extra = Increment(np.array([0.3, 0.0, 0.1]), inputs.increment(1).covariance)
    s.predict(extra)
    s.remove(gone)
    without = decisions.copy()
    number = np.where(created >= 0, created, decisions)
    without[np.isin(number, gone)] = DISCARD
    renumbered = np.cumsum(~np.isin(np.arange(created.max() + 1), gone)) - 1
    without[without >= 0] = renumbered[without[without >= 0]]
    other, *_ = drive(inputs, without, **TIGHT)
    other.predict(extra)
    assert s.numbers.tolist() == [n for n in range(created.max() + 1) if n not in gone]
    np.testing.assert_allclose(s.estimate().mean, other.estimate().mean, atol=5e-6)
    np.testing.assert_allclose(s.estimate().covariance, other.estimate().covariance, atol=1e-6)
    one, two = s.finish(), other.finish()
    np.testing.assert_allclose(one.final.pose, two.final.pose, atol=1e-6)
    np.testing.assert_allclose(one.map.xy, two.map.xy, atol=1e-6)
    assert set(one.map.number).isdisjoint(gone)
    with pytest.raises(ValueError, match="not all are in the map"):
        s.remove(gone)
    # numbers are never used again
    s.predict(extra)
    assert (
        s.update(
            FrameObservations(*inputs.frame_observations(0)), np.full(len(inputs.frame_observations(0).z), NEW)
        ).created.min()
        > created.max()
    )


@every_sensor
def test_a_motion_that_is_not_believed_is_as_uncertain_as_said(sensor):
    """The filter's prediction with that much more, and what is seen afterwards decides."""
    inputs, _, _ = circle(sensor, noise=0.0)
    inputs = inputs.without_map()
    decisions, _ = known_decisions(inputs)
    more = np.diag([25.0, 25.0, 1.0])
    twin = EkfSlam(inputs.prior, inputs.sensor)
    s, *_ = drive(inputs, decisions, until=20, **TIGHT)
    drive(inputs, decisions, until=20, smoother=twin)
    rows = slice(int(inputs.start[20]), int(inputs.start[21]))
    for f in (s, twin):
        f.predict(inputs.increment(20))
        f.inflate(more)
    np.testing.assert_allclose(s.estimate().covariance, twin.estimate().covariance, atol=1e-6)
    assert s.estimate().covariance[0, 0] > 25.0
    for f in (s, twin):
        f.update(inputs.frame_observations(20), decisions[rows])
    np.testing.assert_allclose(s.estimate().covariance, twin.estimate().covariance, atol=1e-4)
    assert s.estimate().covariance[0, 0] < 1.0
    with pytest.raises(ValueError, match="no motion"):
        s.inflate(more)


@every_sensor
def test_joining_landmarks_is_having_known_that_they_are_one(sensor):
    inputs, _, _ = circle(sensor)
    inputs = inputs.without_map()
    decisions, created = known_decisions(inputs)
    late = int(inputs.observations.frame[created >= 0].max())
    apart, number = parted(inputs, decisions, created, 2, late + 5)
    s, *_ = drive(inputs, apart, **TIGHT)
    assert number in s.numbers
    other, *_ = drive(inputs, decisions, **TIGHT)
    assert np.abs(s.estimate().mean - other.estimate().mean).max() > 1e-4
    s.merge(np.array([number]), np.array([2]))
    assert s.numbers.tolist() == other.numbers.tolist()
    np.testing.assert_allclose(s.estimate().mean, other.estimate().mean, atol=5e-6)
    np.testing.assert_allclose(s.estimate().covariance, other.estimate().covariance, atol=1e-6)
    one, two = s.finish(), other.finish()
    np.testing.assert_allclose(one.final.pose, two.final.pose, atol=1e-6)
    np.testing.assert_allclose(one.map.xy, two.map.xy, atol=1e-6)
    assert one.total_nis[1] == two.total_nis[1]
    for senseless in ((number, 2), (2, 2), (2, 99)):
        with pytest.raises(ValueError, match="cannot merge"):
            s.merge(np.array(senseless[:1]), np.array(senseless[1:]))
    localizer = Isam2Smoother(inputs.prior, inputs.sensor, circle(sensor)[0].map)
    with pytest.raises(ValueError, match="known map"):
        localizer.merge(np.array([1]), np.array([0]))


@every_sensor
def test_amended_pairings_leave_no_trace_of_what_they_replace(sensor):
    inputs, _, _ = circle(sensor, frames=40, landmarks=6)
    right, _ = known_decisions(inputs)
    o, rng = inputs.observations, np.random.default_rng(0)
    amended = np.flatnonzero((o.frame > 5) & (rng.random(len(right)) < 0.3))
    wrong = right.copy()
    wrong[amended] = np.where(rng.random(len(amended)) < 0.5, DISCARD, (right[amended] + 1) % 6)
    straight, *_ = drive(inputs, right, until=30, **TIGHT)
    detour, *_ = drive(inputs, wrong, until=30, **TIGHT)
    detour.predict(inputs.increment(30))  # the newest frame may be without an observation yet
    straight.predict(inputs.increment(30))
    whole = np.flatnonzero(np.isin(o.frame, o.frame[amended]) & (o.frame < 30))
    detour.amend(o.frame[whole], FrameObservations(o.z[whole], o.R[whole]), right[whole])
    detour.refine(10)
    straight.refine(10)
    for a, b in zip(detour.estimate(), straight.estimate(), strict=True):
        assert np.allclose(a, b, atol=1e-7)
    for s in (detour, straight):
        for k in range(30, 40):
            if k > 30:
                s.predict(inputs.increment(k))
            s.update(inputs.frame_observations(k), right[inputs.start[k] : inputs.start[k + 1]])
    ended, expected_end = detour.finish(), straight.finish()
    assert np.allclose(ended.final.pose, expected_end.final.pose, atol=1e-6)
    assert np.allclose(ended.final.covariance, expected_end.final.covariance, rtol=1e-3, atol=1e-8)
    assert ended.total_nis[1] == expected_end.total_nis[1]


def test_a_pairing_can_be_taken_back_without_another_one():
    inputs, _, _ = circle(SENSORS["range-bearing"], frames=12)
    decisions, _ = known_decisions(inputs)
    fewer = np.where(inputs.observations.frame == 4, DISCARD, decisions)
    s, *_ = drive(inputs, decisions, **TIGHT)
    other, *_ = drive(inputs, fewer, **TIGHT)
    rows = slice(inputs.start[4], inputs.start[5])
    s.amend(np.full(rows.stop - rows.start, 4), inputs.frame_observations(4), fewer[rows])
    assert np.allclose(s.finish().final.pose, other.finish().final.pose, atol=1e-6)
