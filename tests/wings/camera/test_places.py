"""Places that a camera sees again."""

import math
from itertools import pairwise

import numpy as np
import pytest

from data.inputs import Increments, Prior
from data.pictures import VisualSetup
from data.se2 import between, pose_error
from eval.referee.consistency import squared_distance
from wings.camera import places
from wings.camera.detector import UNIT, Features

CAMERA = places.Camera(
    np.array([[554.0, 0.0, 319.5], [0.0, 554.0, 239.5], [0.0, 0.0, 1.0]]),
    VisualSetup(0.2, (0.1, -0.05), np.zeros((1, 4, 2)), Prior(np.zeros(3), np.eye(3))),
)
POSES = np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.03], [0.3, 0.1, -0.2]])
"""Of two key frames and a later one."""


@pytest.fixture
def keys():
    """Points with a descriptor each, seen from `POSES` with noise of half a pixel."""
    rng = np.random.default_rng(0)
    words = rng.normal(size=(150, 128))
    words = (UNIT * words / np.linalg.norm(words, axis=1, keepdims=True)).astype(np.float32)
    first = np.column_stack([rng.uniform(-1, 1, 150), rng.uniform(-0.8, 0.8, 150), rng.uniform(2.0, 3.0, 150)])
    made = []
    for k, pose in enumerate(POSES):
        R, t = CAMERA.moved(between(POSES[0], pose))
        seen = first @ R.T + t
        pixels = seen[:, :2] / seen[:, 2:] * 554.0 + CAMERA.K[:2, 2] + rng.normal(0.0, 0.5, (150, 2))
        made.append(places.KeyFrame(k, Features(pixels, np.ones(150), words)))
    return made


def odometry(sigma):
    """Increments through `POSES` with a standard deviation in each entry."""
    mean = np.array([np.zeros(3), *(between(a, b) for a, b in pairwise(POSES))])
    return Increments(mean, np.tile(sigma**2 * np.eye(3), (3, 1, 1)))


def test_the_later_pose_is_that_of_the_images_within_its_covariance(keys):
    cloud = places.cloud_of(CAMERA, keys[1], keys[0], odometry(0.01))
    inliers, relative, covariance = places.verified(CAMERA, keys[1], cloud, keys[2])
    error = pose_error(relative, between(POSES[1], POSES[2]))
    assert inliers > 100
    assert np.hypot(*error[:2]) < 0.05
    assert squared_distance(error[None], covariance[None])[0] < 16.3  # chi-square, 3 dof, 0.999


def test_other_places_and_candidates_that_contradict_share_the_likelihood():
    def one(frame, x):
        return places.Candidate(frame, 2, 0.9, 99, np.array([x, 0.0, 0.0]), 1e-4 * np.eye(3), 0.0)

    increments = odometry(0.01)
    assert places._likelihoods([one(0, 0.3)], [9.0], 1.0, increments) == [pytest.approx(0.9)]
    assert places._likelihoods([one(0, 0.3), one(0, 2.0)], [9.0, 9.0], 1.0, increments) == [pytest.approx(9 / 19)] * 2
    assert places._likelihoods([one(0, 0.3), one(0, 0.31)], [9.0, 9.0], 1.0, increments) == [pytest.approx(0.9)] * 2


def test_frames_of_one_place_have_similar_bags(keys):
    other = keys[0]._replace(features=Features(keys[0].features.place, np.ones(150), -keys[0].features.descriptor))
    bag = places.bags([keys[0], keys[1], other])
    assert bag[0] @ bag[1] == pytest.approx(1.0)
    assert bag[0] @ bag[2] == 0.0


def test_the_odometry_adds_up():
    pose, covariance = places.travelled(odometry(0.1), 0, 2)
    assert pose == pytest.approx(POSES[2])
    assert math.sqrt(covariance[2, 2]) == pytest.approx(0.1 * math.sqrt(2.0))


def test_a_sure_candidate_that_its_neighbours_contradict_is_no_closure():
    def one(first, later, x):
        return places.Candidate(first, later, 0.9, 99, np.array([x, 0.0, 0.0]), 1e-4 * np.eye(3), 0.999)

    still = Increments(np.zeros((8, 3)), np.tile(1e-6 * np.eye(3), (8, 1, 1)))
    keys = [places.KeyFrame(k, None) for k in range(8)]
    found = [one(0, 4, 0.1), one(1, 5, 0.11), one(1, 6, 0.1), one(0, 7, 2.0)]
    assert places.closures_of(found, keys, still).later.tolist() == [4, 5, 6]
    assert places.closures_of(found[:1], keys, still) is None
