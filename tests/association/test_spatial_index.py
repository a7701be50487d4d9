"""Candidates that can be left out, by place, view or the face of a wall: no decision depends on them."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from association.candidates import BESIDE, FEW, Faces, Places, aligned_with_observations, gate_radius, view_radius
from association.decide import decide, horizon
from association.expectation import Expectation
from association.names import METHODS
from data.inputs import FrameObservations, LandmarkMap, Prior
from data.se2 import wrap_angle
from data.sensors import Line, RangeBearing, RelativePoint
from ekf.localizer import EkfLocalizer
from tests.association.problems import problem
from tests.quick import examples


@settings(max_examples=examples(60), deadline=None)
@given(
    seed=st.integers(0, 10**6),
    method=st.sampled_from(METHODS),
    known_map=st.booleans(),
    gates=st.sampled_from([(0.99, 0.99999), (0.5, 0.9), (0.1, 0.1)]),
    ambiguity=st.sampled_from([0.3, 1.0, 3.0]),
)
def test_no_candidate_beyond_the_horizon_has_any_influence(seed, method, known_map, gates, ambiguity):
    e = problem(seed, 3, 12, ambiguity=ambiguity, clutter=0.4)
    limit = horizon(method, *gates, known_map=known_map)
    near = np.flatnonzero((e.individual_distances() <= limit).any(axis=0))
    some, every = (decide(method, each, *gates, known_map=known_map) for each in (e.only(near), e))
    np.testing.assert_array_equal(some.decisions, every.decisions)


def test_without_a_gate_there_is_no_horizon():
    assert horizon("jcbb", None, 0.99) == np.inf
    assert horizon("jcbb", 0.99, None) == np.inf
    assert np.isfinite(horizon("jcbb", 0.99, None, known_map=True))


@pytest.mark.parametrize("sensor", [RangeBearing(max_range=6.0, translation=(0.5, 0.2)), RelativePoint(max_range=6.0)])
def test_a_localizer_expects_what_may_be_near_a_reading_and_decides_the_same(sensor):
    rng = np.random.default_rng(3)
    known = LandmarkMap(np.arange(2000) * 3, rng.uniform(-60.0, 60.0, (2000, 2)))
    seen = offered = 0
    for _ in range(30):
        P = np.diag([0.05, 0.05, 0.002]) * rng.uniform(0.1, 3.0)
        pose = np.append(rng.uniform(-50.0, 50.0, 2), rng.uniform(-3.0, 3.0))
        f = EkfLocalizer(Prior(pose, P), sensor, known)
        truth = pose + np.linalg.cholesky(P) @ rng.normal(size=3)
        inside = np.flatnonzero(sensor.in_view(sensor.predict(truth, known.xy)))[:6]
        z = sensor.predict(truth, known.xy[inside]) + 0.02 * rng.normal(size=(len(inside), 2))
        observations = FrameObservations(z, np.tile(4e-4 * np.eye(2), (len(inside), 1, 1)))
        every = f.expect(observations)
        assert len(every.number) == 2000
        f.within = horizon("jcbb", 0.99, None, known_map=True)
        e = f.expect(observations)
        a, b = (decide("jcbb", each, 0.99, None, known_map=True).decisions for each in (e, every))
        np.testing.assert_array_equal(a, b)
        assert np.isin(every.number[(every.individual_distances() <= f.within).any(axis=0)], e.number).all()
        seen, offered = seen + len(inside), offered + len(e.number)
    assert seen > 100
    assert offered < 0.1 * 30 * 2000


def test_places_are_those_within_the_radius_and_of_a_few_all():
    xy = np.random.default_rng(0).uniform(0.0, 10.0, (FEW + 50, 2))
    near = np.flatnonzero(np.hypot(*(xy - [3.0, 4.0]).T) <= 2.0)
    np.testing.assert_array_equal(Places(xy).around(np.array([3.0, 4.0]), 2.0), near)
    assert len(Places(xy).around(np.array([3.0, 4.0]), np.inf)) == FEW + 50
    assert len(Places(xy[:FEW]).around(np.array([3.0, 4.0]), 2.0)) == FEW


def test_radii_are_those_on_paper():
    sensor = RangeBearing(max_range=10.0, translation=(3.0, 4.0))
    P = np.diag([9.0, 16.0, 0.04])
    assert view_radius(sensor, P) == pytest.approx(10.0 + 5.0 + 3.0 * (5.0 + 5.0 * 0.2))
    z = FrameObservations(np.array([[7.0, 0.0], [2.0, 1.0]]), np.tile(np.diag([0.25, 0.1]), (2, 1, 1)))
    assert gate_radius(sensor, P, z, 4.0) == pytest.approx(7.0 + 2.0 * 0.5 + 5.0 + 2.0 * (5.0 + 5.0 * 0.2))


SENSOR = Line()
SURE = np.zeros((3, 3))
R = np.array([[[0.02**2, -0.9 * 0.02 * 0.05], [-0.9 * 0.02 * 0.05, 0.05**2]]])


def expectation(z, z_hat, HPHt):
    return Expectation.from_arrays(z, z_hat, HPHt, np.repeat(R, len(z), axis=0), SENSOR.residual)


def other(z):
    return np.array([-z[0], wrap_angle(z[1] + math.pi)])


def test_a_reading_is_as_far_from_a_wall_by_whatever_name_it_is_expected():
    P = np.array([[0.3**2, 0.5 * 0.3 * 0.04], [0.5 * 0.3 * 0.04, 0.04**2]])
    turned = P * [[1, -1], [-1, 1]]
    z, z_hat = np.array([[0.45, -1.5]]), np.array([0.05, -1.55])
    plain = expectation(z, z_hat[None], P).individual_distances()
    renamed = aligned_with_observations(expectation(z, other(z_hat)[None], turned), SENSOR)
    assert np.allclose(renamed.z_hat, z_hat)
    assert np.allclose(renamed.individual_distances(), plain)
    assert np.allclose(renamed.joint(np.array([0])), P)
    # by the other name the error of the distance has the other sign, and that of the noise not
    assert not np.allclose(expectation(z, other(z_hat)[None], turned).individual_distances(), plain, rtol=0.02)


def seen(*poses, d=0.5):
    """Wall 0, the line y = 0, seen on the right by a robot that drives along it to the right."""
    faces = Faces(SENSOR)
    for x in poses:
        faces.see(np.array([x, d, 0.0]), np.array([0]), np.array([[d, -math.pi / 2]]))
    return faces


@pytest.mark.parametrize(
    ("x", "offered"), [(2.0, True), (3.0 + 0.9 * BESIDE, True), (3.0 + 1.1 * BESIDE, False), (-4.0, False)]
)
def test_the_other_face_of_a_wall_is_offered_where_the_first_was_seen(x, offered):
    faces = seen(1.0, 2.0, 3.0)  # from y < 0, driving along it to the right, it is on the left
    below, z_hat = np.array([x, -0.5, 0.0]), np.array([[0.5, math.pi / 2]])
    assert faces.visible(below, SURE, np.array([0]), z_hat).tolist() == [offered]


def test_the_same_face_is_offered_anywhere_and_an_unsure_robot_is_given_more():
    faces = seen(1.0)
    far, right = np.array([30.0, 0.5, 0.0]), np.array([[0.5, -math.pi / 2]])
    assert faces.visible(far, SURE, np.array([0]), right).all()
    below, left = np.array([4.0, -0.5, 0.0]), np.array([[0.5, math.pi / 2]])
    assert not faces.visible(below, SURE, np.array([0]), left).any()
    assert faces.visible(below, np.diag([1.0, 0.0, 0.0]), np.array([0]), left).all()


def test_faces_are_seen_by_a_sensor_wherever_it_is_mounted():
    mounted = Line(rotation=0.7, translation=(0.3, -0.2))
    faces, wall = Faces(mounted), np.array([[2.0, math.pi / 2]])  # y = 2
    pose = np.array([1.0, 0.5, 0.2])
    faces.see(pose, np.array([0]), mounted.predict(pose, wall))
    for x, y, offered in [(9.0, 0.5, True), (1.2, 3.5, True), (5.0, 3.5, False)]:
        here = np.array([x, y, -0.4])
        assert faces.visible(here, SURE, np.array([0]), mounted.predict(here, wall)).tolist() == [offered]
