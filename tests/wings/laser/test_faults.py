"""What speaks against a laser result: doubled walls, steps against the wheels, refused loop closures, claims."""

import re
from dataclasses import replace

import numpy as np
import pytest

from data.formats.recordings.laser import laser_inputs, without_odometry
from data.inputs import Scans
from data.log import Log
from data.notice import Code
from data.result import Trajectory
from data.se2 import between
from data.truth import Relations, Truth
from data.worlds.registry import named_log
from eval.judgement.judgement import Cause, Verdict, decided, judge
from eval.judgement.runs import Objection
from eval.referee.score import Trial, score
from eval.replay.run import compare
from tests.wings.laser.scans.rooms import CORRIDOR, ROOM, SCANNER, scan
from wings.laser.score import faults


@pytest.fixture(scope="module")
def trial():
    log = named_log("floorplan:0:frames=1500+beams=90")
    return Trial(log, "slam", tuple(compare(log.recorded, "slam", ["isam2"], "scan")))


def changed(trial, **parts):
    return replace(trial, runs=(replace(trial.runs[0], **parts),))


def codes(trial):
    return {n.code for n in faults(trial)}


def test_half_a_turn_that_no_wheel_reported_is_named_with_its_frame(trial):
    chain = trial.runs[0].chain
    motion = chain.motion.copy()
    motion[40, 2] += 3.1
    (found,) = faults(changed(trial, chain=replace(chain, motion=motion), key_pose=trial.runs[0].key_pose))
    assert found.code is Code.AGAINST_WHEELS
    assert found.frame == chain.frame[40]
    assert found.named["turned"] > 170.0


def test_a_path_that_runs_away_by_a_little_each_scan_is_named_and_one_of_frozen_wheels_is_not(trial):
    chain, increments = trial.runs[0].chain, trial.log.recorded.increments
    since = chain.since + 0.04 * np.stack([np.zeros(1500), np.arange(1500) - chain.frame[chain.key], np.zeros(1500)], 1)
    motion = chain.motion + np.diff(chain.frame, prepend=0)[:, None] * [0.0, 0.3, 0.0]
    found, _ = faults(changed(trial, chain=replace(chain, since=since, motion=motion)))
    assert found.code is Code.AGAINST_WHEELS
    assert 0.5 < found.named["distance"] < 30.0
    assert codes(trial) == set()
    recorded = replace(trial.log.recorded, increments=replace(increments, mean=increments.mean.copy()))
    recorded.increments.mean.setflags(write=True)
    recorded.increments.mean[300:400] = 0.0
    assert codes(replace(trial, log=replace(trial.log, recorded=recorded))) == set()


@pytest.mark.parametrize(("told", "source", "mended", "by"), [
    ([0.5, 0.5, 1.0], {"odometry_kind": "poses", "unit": {"x": "cm"}}, "--unit odometry.x=#m,odometry.y=#m", [0.02, 2]),
    ([1.0, 1.0, 0.5], {"odometry_kind": "velocities"}, "--unit odometry.omega=#rad/s", [2]),
    ([0.5, 0.5, 1], {"wheels": {"metres": [0.01], "track_width": 1}}, "--metres-per-tick=# --track-width=#", [0.02, 2]),
    ([0.5, 0.5, 1.0], {}, "", []), ([0.9, 0.9, 1.1], {"odometry_kind": "poses"}, None, []),
])  # fmt: skip
def test_wheels_that_are_wrong_by_a_factor_are_named_with_it(trial, told, source, mended, by):
    increments = replace(trial.log.recorded.increments, mean=trial.log.recorded.increments.mean * told)
    log = replace(trial.log, recorded=replace(trial.log.recorded, increments=increments), source=source)
    found = [n for n in faults(replace(trial, log=log)) if n.code in (Code.WHEELS_SCALE, Code.WHEELS_TURN)]
    assert len(found) == (mended is not None)
    for flags in (" ".join(one.named["flags"]) for one in found):
        assert re.sub(r"\d[\d.]*", "#", flags) == mended
        assert list(map(float, re.findall(r"\d[\d.]*", flags))) == pytest.approx(by, rel=0.03)


def test_scans_alone_that_jump_are_matched_and_said():
    true = np.stack([np.linspace(-2.0, 0.0, 40), np.zeros(40), np.zeros(40)], axis=1)
    true[30::2] += [0.5, 0.3, 0.4]
    scanner = replace(SCANNER, max_range=8.0)
    scans = Scans(scanner, np.arange(40), np.array([scan(pose, ROOM, scanner) for pose in true]))
    log = Log("jumps", without_odometry(laser_inputs(true, 0.2 * np.arange(40), scans)), Truth())
    seen = Trial(log, "slam", tuple(compare(log.recorded, "slam", ["batch"], "scan")))
    assert codes(seen) == {Code.SCANS_JUMP}
    assert np.hypot(*(seen.runs[0].last - true)[:, :2].T).max() < 0.02


def test_the_verdict_says_that_nothing_was_tested_where_no_loop_was_closed():
    log = named_log("floorplan:0:frames=100+beams=90")
    log = replace(log, truth=Truth(None))
    alone = Trial(log, "slam", tuple(compare(log.recorded, "slam", ["ekf", "batch"], "scan")))
    fine = Cause("nothing", (), None, None)
    assert decided(judge(alone).compared, fine, measured=False)[0] is Verdict.UNKNOWN


def test_the_headline_names_no_path_where_walls_are_doubled(trial):
    drift = np.linspace(0.0, 1.0, len(trial.runs[0].key_pose))[:, None] * np.array([1.5, 1.0, 0.0])
    wrong = changed(trial, key_pose=trial.runs[0].key_pose + drift)
    assert (codes(trial), codes(wrong)) == (set(), {Code.DOUBLED_WALLS})
    facts = judge(wrong, score([wrong]), [])
    assert facts.verdict is Verdict.NEITHER
    assert facts.objections[0].objection is Objection.CONVENTION
    assert facts.log_faults.conventions[0].code is Code.DOUBLED_WALLS


@pytest.mark.parametrize(
    ("walls", "alone", "named", "verdict"),
    [
        (CORRIDOR, False, {Code.WAY_BY_ODOMETRY}, Verdict.UNKNOWN),
        (CORRIDOR, True, {Code.WAY_UNOBSERVED}, Verdict.NEITHER),
        (ROOM, False, set(), Verdict.UNKNOWN),
        (ROOM, True, set(), Verdict.UNKNOWN),
    ],
)
def test_along_bare_walls_odometry_tells_the_way_or_no_path_is_trusted(walls, alone, named, verdict):
    scanner = replace(SCANNER, max_range=8.0)
    true = np.stack([np.linspace(-2.0, 1.0, 50), np.zeros(50), np.zeros(50)], axis=1)
    ranges = np.array([scan(pose, walls, scanner) for pose in true])
    ranges += np.where(ranges > 0.0, np.random.default_rng(0).normal(0.0, 0.01, ranges.shape), 0.0)
    ranges[:, 20:26] = 0.8  # parts of the robot, which go along
    inputs = laser_inputs(true, 0.2 * np.arange(50), Scans(scanner, np.arange(50), ranges))
    log = Log("walls", without_odometry(inputs) if alone else inputs, Truth())
    seen = Trial(log, "slam", tuple(compare(log.recorded, "slam", ["ekf", "isam2"], "scan")))
    assert codes(seen) == named
    assert judge(seen).verdict is verdict
    if verdict is not Verdict.NEITHER:
        assert np.ptp(seen.runs[1].last[:, 0]) == pytest.approx(3.0, abs=0.1)


@pytest.mark.parametrize(("share", "named"), [(0.7, set()), (0.95, {Code.CLOSURES_REFUSED})])
def test_a_log_of_which_hardly_any_loop_closure_is_believed_is_named(trial, share, named):
    loops = trial.runs[0].loops
    believed = loops.believed.copy()
    believed[: int(share * len(believed))] = -1
    assert codes(changed(trial, loops=replace(loops, believed=believed))) == named


def test_covariances_are_compared_with_the_relations(trial):
    truth = trial.log.truth.pose
    rows = np.arange(0, 800, 20)
    related = Relations(rows, rows + 60, between(truth[rows], truth[rows + 60]))
    given = replace(trial, log=replace(trial.log, truth=replace(trial.log.truth, relations=related)))
    assert codes(given) == set()
    final = given.runs[0].final
    proud = changed(given, final=Trajectory(final.pose, 1e-3 * final.covariance))
    assert codes(proud) == {Code.BEYOND_CLAIMS}
