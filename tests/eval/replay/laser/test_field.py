"""Odometry that lies, as field robots have it: a scan match neither follows it nor throws it away."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from data.formats.open_log.reader import load_folder
from data.formats.recordings.carmen import load_carmen
from data.se2 import between, compose, dead_reckoned, wrap_angle
from eval.replay.laser.comparison import run_front_end
from eval.replay.laser.parameters import LaserParameters
from tests.eval.replay.laser.field import reporting_forward, slipping_at_rest, symmetric_room

GIVEN = next((p / "shared" / "data" / "laser_field" for p in Path(__file__).parents if (p / "shared").is_dir()), None)
given = pytest.mark.skipif(GIVEN is None, reason="the recorded logs are not here")


def matched(log):
    """The path (N, 3) by scan matching alone."""
    chain = run_front_end(log.recorded, LaserParameters()).chain
    return compose(dead_reckoned(log.recorded.prior.mean, chain.motion)[chain.key], chain.since)


def steps(log, path):
    """Errors (S - 1, 3) of the steps from scan to scan against the truth."""
    at = log.recorded.scans.frame
    truth = log.truth.pose
    error = between(between(truth[at[:-1]], truth[at[1:]]), between(path[at[:-1]], path[at[1:]]))
    error[:, 2] = wrap_angle(error[:, 2])
    return error


def test_a_room_that_looks_the_same_after_half_a_turn_turns_nobody():
    log = symmetric_room(0)
    assert (np.abs(steps(log, matched(log))[:, 2]) < 0.02).all()


@pytest.mark.slow
@pytest.mark.parametrize("angle", [0.3, 0.6])
@pytest.mark.parametrize("seed", range(4))
def test_a_robot_turned_while_its_wheels_rest_is_followed(seed, angle):
    """With a second start per frame, one of eight turned by up to 90 degrees more."""
    log = slipping_at_rest(seed, angle)
    error = steps(log, matched(log))
    assert (np.abs(error[:, 2]) < 0.02).all()
    assert (np.hypot(error[:, 0], error[:, 1]) < 0.1).all()


@pytest.mark.slow
def test_a_robot_that_backs_while_it_reports_forward_is_followed_where_more_than_a_corridor_is_seen():
    """Wheels alone are 0.2 m off in a fifth of the steps; along bare corridors no scan knows better."""
    wrong = [np.hypot(*steps(log, matched(log)).T[:2]) > 0.05 for log in map(reporting_forward, range(4))]
    assert float(np.mean(np.concatenate(wrong))) < 0.02


@given
def test_the_recorded_room_at_rest():
    path = matched(load_carmen(GIVEN / "flip.log"))
    assert path[-1, 2] == pytest.approx(0.98, abs=0.02)


@given
@pytest.mark.slow
def test_the_recorded_castle_has_no_step_of_half_a_turn():
    log = load_folder(GIVEN / "belgioioso")
    path, at = matched(log), log.recorded.scans.frame
    wheels = dead_reckoned(np.zeros(3), log.recorded.increments.mean)
    apart = between(between(wheels[at[:-1]], wheels[at[1:]]), between(path[at[:-1]], path[at[1:]]))
    assert (np.hypot(apart[:, 0], apart[:, 1]) < 0.3).all()
    assert (np.abs(wrap_angle(apart[:, 2])) < 0.5).all()
