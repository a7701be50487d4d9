"""Odometry that lies, as field robots have it: a scan match neither follows it nor throws it away."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from data.formats.open_log import load_folder
from data.formats.recordings.laser import without_odometry
from data.logs import Reading, open_log
from data.notice import Code
from data.se2 import between, compose, dead_reckoned, pose_error, wrap_angle
from data.worlds.registry import named_log
from eval.referee.errors import aligned_rmse
from eval.referee.relations import relation_errors
from eval.referee.score import Trial
from eval.replay.run import compare
from tests.wings.laser.slam.field import halls, reporting_forward, ring, slipping_at_rest, symmetric_room
from wings.laser.carmen import load_carmen
from wings.laser.score import faults, right_closures
from wings.laser.slam.front_end import run_front_end
from wings.laser.slam.parameters import LaserParameters

GIVEN = next((p / "shared" / "data" / "laser_field" for p in Path(__file__).parents if (p / "shared").is_dir()), None)
INTEL = Path("none") if GIVEN is None else GIVEN.parent / "intel" / "intel_raw_full.log.gz"
given = pytest.mark.skipif(GIVEN is None, reason="the recorded logs are not here")


def matched(log):
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


@pytest.mark.slow
@pytest.mark.parametrize("panes", [0.0, 0.5])
def test_in_halls_of_equal_rows_no_loop_closure_is_wrong(panes):
    log = halls(0, panes=panes)
    (run,) = compare(log.recorded, "slam", ["isam2"], "scan")
    believed = run.loops.believed >= 0
    assert believed.sum() > 100
    assert right_closures(run.loops, log.truth.pose[run.chain.frame])[believed].all()
    assert aligned_rmse(run.last, log.truth.pose) < 0.03
    assert {n.code for n in faults(Trial(log, "slam", (run,)))} <= {Code.WAY_BY_ODOMETRY}


@pytest.mark.slow
def test_where_a_short_reach_between_equal_rows_leads_astray_the_walls_are_doubled():
    """4 m, half of the walls of glass, odometry that turns: nothing contradicts the wheels, the map does."""
    log = halls(0, panes=0.5, reach=4.0, thin=5, bias=0.1)
    (run,) = compare(log.recorded, "slam", ["isam2"], "scan")
    assert aligned_rmse(run.last, log.truth.pose) > 1.0
    assert Code.DOUBLED_WALLS in {n.code for n in faults(Trial(log, "slam", (run,)))}


@pytest.mark.slow
def test_loop_closures_that_a_wrong_path_believes_and_the_map_does_not_are_not_believed():
    """Odometry too long by 8 % along bare walls: the chain is sure of it, and pillars one farther fit."""
    log = ring(0, scale=0.08)
    first = run_front_end(log.recorded, LaserParameters())
    assert not right_closures(first.loops, log.truth.pose[first.chain.frame])[first.loops.believed >= 0].any()
    (run,) = compare(log.recorded, "slam", ["isam2"], "scan")
    believed = run.loops.believed >= 0
    assert believed.sum() > 100
    loops, keys = run.loops, log.truth.pose[run.chain.frame]
    error = pose_error(loops.relative, between(keys[loops.key1], keys[loops.key2]))[believed]
    assert np.hypot(error[:, 0], error[:, 1]).max() < 0.3
    assert Code.CHAIN_WIDENED in {n.code for n in run.notes}
    assert Code.DOUBLED_WALLS not in {n.code for n in faults(Trial(log, "slam", (run,)))}


@pytest.mark.slow
@pytest.mark.parametrize("thin", [1, 5])
def test_scans_alone_tell_the_motion(thin):
    """Five scans a second, and one."""
    log = named_log("floorplan:0")
    scans = log.recorded.scans
    few = replace(scans, frame=scans.frame[::thin], ranges=scans.ranges[::thin])
    (run,) = compare(without_odometry(replace(log.recorded, scans=few)), "slam", ["isam2"], "scan")
    assert aligned_rmse(run.last, log.truth.pose) < 0.03


@pytest.mark.slow
@pytest.mark.skipif(not INTEL.exists(), reason="the recorded log is not here")
def test_scans_of_the_intel_lab_alone_are_worth_three_centimetres():
    """With wheels 0.0167 m. With a search only where no match fits, and frames by their stamps, 0.088 m."""
    log = open_log(INTEL, Reading(no_odometry=True))
    (run,) = compare(log.recorded, "slam", ["isam2"], "scan")
    assert relation_errors(run.last, log.truth.relations, log.recorded.time).trans_mean_m < 0.03


@given
def test_the_recorded_room_at_rest():
    assert matched(load_carmen(GIVEN / "flip.log"))[-1, 2] == pytest.approx(0.98, abs=0.02)


@given
@pytest.mark.slow
def test_the_recorded_castle_has_no_step_of_half_a_turn():
    log = load_folder(GIVEN / "belgioioso")
    path, at = matched(log), log.recorded.scans.frame
    wheels = dead_reckoned(np.zeros(3), log.recorded.increments.mean)
    apart = between(between(wheels[at[:-1]], wheels[at[1:]]), between(path[at[:-1]], path[at[1:]]))
    assert (np.hypot(apart[:, 0], apart[:, 1]) < 0.3).all()
    assert (np.abs(wrap_angle(apart[:, 2])) < 0.5).all()
