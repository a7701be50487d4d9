"""How much of its noise an observation leaves in its residual: cases with a closed form."""

from __future__ import annotations

import numpy as np
import pytest

from data.inputs import Increments, Inputs, LandmarkMap, Observations, Prior
from data.sensors import RelativePoint
from data.worlds.registry import named_log
from graph.batch import smooth
from graph.problem import Start

POINTS = np.array([[2.0, 1.0], [3.0, -1.0], [1.0, -2.0]])


def still(frames, motion, prior, known=None, times=1):
    """A robot at rest that observes every point `times` times in each frame; all is where it is."""
    frame = np.repeat(np.arange(frames), len(POINTS) * times)
    number = np.tile(np.repeat(np.arange(len(POINTS)), times), frames)
    covariance = np.tile(motion * np.eye(3), (frames, 1, 1))
    inputs = Inputs(
        Prior(np.zeros(3), prior * np.eye(3)), np.arange(frames, dtype=float),
        Increments(np.zeros((frames, 3)), covariance),
        Observations(frame, POINTS[number], np.tile(0.01 * np.eye(2), (len(frame), 1, 1))), RelativePoint(), known,
    )  # fmt: skip
    found = smooth(inputs, number, np.full(len(number), -1), Start(np.zeros((frames, 3)), POINTS), with_shares=True)
    return found.residual_share.reshape(frames, -1, 2), found.dof


def test_a_point_seen_n_times_from_known_poses_leaves_all_but_an_nth():
    share, _ = still(4, 1e-12, 1e-12)
    np.testing.assert_allclose(share, 0.75, atol=1e-6)


def test_a_pose_known_by_its_observations_alone_takes_three_of_them():
    share, dof = still(5, 1e6, 1e6, LandmarkMap(np.arange(3), POINTS))
    np.testing.assert_allclose(share.sum(axis=(1, 2)), 3.0, atol=1e-4)
    assert dof == 30  # as many as numbers observed: prior and motion have the others


def test_a_landmark_seen_once_leaves_nothing():
    share, _ = still(1, 1.0, 1e-12)
    np.testing.assert_allclose(share, 0.0, atol=1e-6)


@pytest.mark.parametrize("name", ["arena:0:frames=20", "corridor:0:people"])
def test_residuals_of_drawn_noise_are_as_large(name):
    log = named_log(name)
    inputs = log.inputs(labels=True).without_map()
    number, seen = log.truth.landmark_of, log.recorded.observations
    places = np.zeros((int(log.truth.landmarks.id.max()) + 1, 2))
    places[log.truth.landmarks.id] = log.truth.landmarks.xy
    start = Start(log.truth.pose, places)
    found = smooth(inputs, np.where(number < 0, -2, number), np.full(len(number), -1), start, with_shares=True)
    used = number >= 0
    residual = inputs.sensor.residual(
        seen.z[used], inputs.sensor.predict(
            found.trajectory.pose[seen.frame[used]],
            found.map.xy[np.searchsorted(found.map.number, number[used])],
        ),
    )  # fmt: skip
    squares = np.einsum("ni,nij,nj->n", residual, np.linalg.inv(seen.R[used]), residual)
    expected = found.residual_share.sum(axis=1)
    assert squares.sum() == pytest.approx(expected.sum(), abs=4.0 * np.sqrt(2.0 * expected.sum()))
    assert ((found.residual_share >= 0.0) & (found.residual_share <= 1.0)).all()
