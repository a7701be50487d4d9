"""Logs `walls:SEED`: the room's walls seen from where the robot starts, and which of them each observation shows."""

from __future__ import annotations

import numpy as np
import pytest

from data.errors import UsageError
from data.inputs import CLUTTER
from data.logs import open_log


@pytest.fixture(scope="module")
def log():
    return open_log("walls:0:frames=500")


def test_the_robot_starts_at_the_origin_and_walls_are_as_far_as_they_are(log):
    assert (log.truth.pose[0] == 0).all()
    # room 0: 10 x 6 m, started at (1, 1): to the wall behind it, ahead, on the right and on the left
    found = {tuple(np.round(row, 9)) for row in log.truth.landmarks.xy}
    for rho, alpha in [(1.0, np.pi), (9.0, 0.0), (1.0, -np.pi / 2), (5.0, np.pi / 2)]:
        assert (rho, round(alpha, 9)) in found
    assert len(found) == 12


def test_observations_show_walls_and_err_by_their_covariance(log):
    o, truth, sensor = log.recorded.observations, log.truth, log.recorded.sensor
    shows = truth.landmark_of != CLUTTER
    assert shows.mean() > 0.97
    at = truth.landmarks.positions(truth.landmark_of[shows])
    e = sensor.residual(o.z[shows], sensor.predict(truth.pose[o.frame[shows]], at))
    nees = np.einsum("ni,nij,nj->n", e, np.linalg.inv(o.R[shows]), e)
    assert nees.mean() == pytest.approx(2.0, abs=3 * 2 / np.sqrt(shows.sum()))


@pytest.mark.slow
def test_the_same_name_is_the_same_log_and_a_room_may_be_chosen(log):
    again = open_log("walls:0:frames=500")
    assert again.recorded.observations.z.tobytes() == log.recorded.observations.z.tobytes()
    other = open_log("walls:4:room=0+frames=40")
    assert (other.truth.landmarks.xy == log.truth.landmarks.xy).all()
    assert other.recorded.increments.mean[-1].tobytes() != log.recorded.increments.mean[39].tobytes()
    with pytest.raises(UsageError, match="range_sigma"):
        open_log("walls:0:range_sigma=0")


def test_a_world_s_walls_may_be_fitted_by_the_author_s_weights():
    one, other = (open_log(f"walls:0:frames=60{more}").recorded for more in ("", "+fit=author"))
    assert (one.increments.mean == other.increments.mean).all()
    assert len(other.observations.z) > 0
    assert one.observations.z.tobytes() != other.observations.z.tobytes()
    with pytest.raises(UsageError, match="fit = 'ransac'"):
        open_log("walls:0:fit=ransac")
