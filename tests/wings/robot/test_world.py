"""Logs `walls:SEED`, and the wall follower that drives them: off the walls, all round, at its distance."""

import numpy as np
import pytest

from data.errors import UsageError
from data.inputs import CLUTTER
from data.logs import open_log
from wings.robot.driving import SPEED, WANTED, WallFollower
from wings.robot.packets import PERIOD, RADIUS, SONARS, Answer
from wings.robot.simulated import Physics, Room, clearance, drive, room
from wings.robot.traffic import Packet
from wings.robot.walls import FITS


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


def test_a_world_s_walls_may_be_fitted_by_the_author_s_weights_which_also_steer():
    one, other = (open_log(f"walls:0:frames=60{more}").recorded for more in ("", "+fit=author"))
    assert (one.increments.mean != other.increments.mean).any()
    assert len(other.observations.z) > 0
    assert one.observations.z.tobytes() != other.observations.z.tobytes()
    with pytest.raises(UsageError, match="fit = 'ransac'"):
        open_log("walls:0:fit=ransac")


QUIET = Physics(slip=0.0, range_sigma=0.0, dropout=0.0, crosstalk=0.0)


def heard(*rows, k=0, joined=True, **distances):
    """A packet with distances [m] of rows of sonars."""
    ranges = np.full(len(SONARS), np.inf)
    for row, distance in rows:
        ranges[row] = distance
    return Packet(k * PERIOD, ranges, np.zeros(3), joined, Answer((4000,) * 8, 0, 0, 0))


def margin(place, way):
    """Least distance [m] of the rim from a wall on the way driven."""
    return min(clearance(place, pose) for pose in way.poses) - RADIUS


def test_it_stops_and_turns_left_at_a_wall_ahead_but_not_for_one_short_reading():
    follower = WallFollower()
    follower(heard())
    assert follower(heard((0, 0.2), k=1))[0] > 0.0
    assert follower(heard((0, 0.2), k=2))[0] == 0.0
    v, omega = follower(heard((0, 0.2), k=3))
    assert v == 0.0
    assert omega > 0.0


@pytest.mark.parametrize("fit", FITS)
def test_it_comes_to_its_distance_along_a_wall(fit):
    corridor = Room(np.array([[[-5.0, 0.0], [40.0, 0.0]]]), np.array([0.0, 1.0, 0.0]))
    way = drive(corridor, WallFollower(fit), 40.0, np.random.default_rng(0), QUIET)
    assert way.poses[80:, 1] == pytest.approx(WANTED, abs=0.03)
    assert way.poses[:, 1].min() > WANTED - 0.05
    assert way.poses[-1, 0] > 8.0


def test_after_odometry_began_anew_what_was_seen_before_is_forgotten():
    follower = WallFollower()
    for k in range(6):
        follower(heard((6, 0.9), k=k))
    assert follower(heard(k=6, joined=False)) == pytest.approx((SPEED, 0.0))


def five_minutes(seed):
    """Margin [m] in the room of a seed, and the shares of its width and depth that were driven."""
    place = room(seed)
    way = drive(place, WallFollower(), 300.0, np.random.default_rng(100 + seed))
    return margin(place, way), np.ptp(way.poses[:, :2], axis=0) / np.ptp(place.segments.reshape(-1, 2), axis=0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(15))
def test_five_minutes_round_a_room_without_touching_a_wall(seed):
    least, extent = five_minutes(seed)
    assert least > 0.1
    assert (extent > 0.75).all()
