"""Walls have two names and two faces: noise keeps its own name, and what is solid is seen from one side."""

from __future__ import annotations

import math

import numpy as np
import pytest

from association.decide import decide
from association.expectation import Expectation
from association.faces import MARGIN, Faces, aligned_with_observations
from data.se2 import wrap_angle
from data.sensors import Line

SENSOR = Line()
SURE = np.zeros((3, 3))
R = np.array([[[0.02**2, -0.9 * 0.02 * 0.05], [-0.9 * 0.02 * 0.05, 0.05**2]]])


def expectation(z, z_hat, HPHt):
    return Expectation.from_arrays(z, z_hat, HPHt, np.repeat(R, len(z), axis=0), SENSOR.residual)


def other(z):
    """The same wall under its other name."""
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


def test_of_parallel_walls_each_is_named_as_its_own_reading():
    z = np.array([[0.45, -1.57], [0.8, 1.57]])
    z_hat = np.array([other([0.40, -1.55]), [0.85, 1.60], [6.0, 0.0]])
    e = aligned_with_observations(expectation(z, z_hat, 0.01 * np.eye(6)), SENSOR)
    assert np.allclose(e.z_hat, [[0.40, -1.55], [0.85, 1.60], [6.0, 0.0]])
    assert decide("jcbb", e, 0.99, 0.99999, known_map=False).decisions.tolist() == [0, 1]
    chosen = np.array([1, 0])
    assert np.allclose(e.only(np.array([1, 2])).joint(np.array([0, 1])), 0.01 * np.eye(4))
    assert np.allclose(e.joint(chosen), 0.01 * np.eye(4))


def seen(*poses, d=0.5):
    """Wall 0, the line y = 0, seen on the right by a robot that drives along it to the right."""
    faces = Faces(SENSOR)
    for x in poses:
        faces.see(np.array([x, d, 0.0]), np.array([0]), np.array([[d, -math.pi / 2]]))
    return faces


@pytest.mark.parametrize(
    ("x", "offered"), [(2.0, True), (3.0 + 0.9 * MARGIN, True), (3.0 + 1.1 * MARGIN, False), (-4.0, False)]
)
def test_the_other_face_of_a_wall_is_offered_where_the_first_was_seen(x, offered):
    # from y < 0, driving along it to the right, it is on the left
    faces = seen(1.0, 2.0, 3.0)
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
