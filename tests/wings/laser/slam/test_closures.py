"""Loop closures are believed in pairs, and never two of one key pose: its scan may be wrong in both alike."""

import numpy as np
import pytest

from tests.wings.laser.scans.rooms import ROOM, SCANNER, scan
from wings.laser.scans.points import beams_of, scan_points
from wings.laser.slam.closures import LoopCloser
from wings.laser.slam.parameters import LaserParameters

GAP = LaserParameters().loop_gap
SEEN = scan(np.zeros(3), ROOM)
USUAL = 1e-4 * np.eye(3)


def closer_at(keys, last=SEEN, covariance=USUAL):
    """A robot that stands in a room for some key poses; `last` is what it sees from the newest."""
    found = LoopCloser(LaserParameters(), SCANNER)
    for key in range(keys):
        ranges = last if key == keys - 1 else SEEN
        found.add_key(ranges, scan_points(ranges, beams_of(SCANNER, 180), 20.0), np.zeros(3), covariance)
    return found


def candidates(found, poses):
    assert found.find(poses) == []  # one alone is never believed
    return [(c.key1, c.key2) for c in found.candidates]


def test_of_many_candidates_two_are_looked_at_the_nearest_one_and_the_next_that_is_not_beside_it():
    keys = GAP + 18
    poses = np.zeros((keys, 3))
    poses[:-1, 0] = 0.05 * np.abs(np.arange(keys - 1) - 16)  # where the robot is now it was at key pose 16
    assert sorted(candidates(closer_at(keys), poses)) == [(8, keys - 1), (16, keys - 1)]


@pytest.mark.parametrize("off", [0.0, 0.5])
def test_closures_of_two_key_poses_that_agree_are_believed_at_the_second_unless_one_is_refused(off):
    found = closer_at(GAP + 1)
    assert candidates(found, np.zeros((GAP + 1, 3))) == [(0, GAP)]
    found.add_key(SEEN, found._points[-1], np.zeros(3), USUAL)
    poses = np.zeros((GAP + 2, 3))
    poses[-1, 0] = off  # of the second pose the path says what the scan does not
    ends = [(c.key1, c.key2, c.believed) for c in found.find(poses)]
    assert ends == ([] if off else [(0, GAP, GAP + 1), (0, GAP + 1, GAP + 1)])
    assert len(found.loops().key1) == 2


@pytest.mark.parametrize(("steps", "most"), [(1e-9, 2.0), (1.0, 2.3098), (4.0, 2.6197)])
def test_key_poses_farther_apart_than_the_path_between_allows_are_not_looked_at(steps, most):
    """The middles of what is seen may be 2 m apart, and twice the root of the variances in x and y of 12 steps: those
    of one are 0.0005 and 0.0015 m^2, times `steps`, so that the root is 0.1549 m for `steps` of 1."""
    assert GAP == 12
    for away, expected in ((most - 0.002, [(0, GAP)]), (most + 0.002, [])):
        poses = np.zeros((GAP + 1, 3))
        poses[-1, 0] = away
        found = closer_at(GAP + 1, covariance=steps * np.diag([0.0005, 0.0015, 1e-6]))
        assert candidates(found, poses) == expected
