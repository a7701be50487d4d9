"""Laser logs compared: one front end, every back end on it, every frame at its best place in the end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from data.inputs import Scans
from data.se2 import between, compose, pose_error
from data.worlds.registry import named_log
from eval.referee.score import Trial, score
from eval.replay.run import compare
from wings.laser.scans.constraints import LaserRun
from wings.laser.score import closure_counts
from wings.laser.slam import front_end
from wings.laser.slam.backends import key_inputs, smoothed
from wings.laser.slam.comparison import between_scans
from wings.laser.slam.front_end import FEWEST, FrontEndResult, run_front_end
from wings.laser.slam.parameters import LaserParameters


@pytest.fixture(scope="module")
def log():
    return named_log("floorplan:0:frames=700")


@pytest.fixture(scope="module")
def runs(log):
    names = ["dead-reckoning", "ekf", "isam2", "batch", "gnc"]
    return dict(zip(names, compare(log.recorded, "slam", names, "scan"), strict=True))


def test_all_back_ends_get_the_same_chain_and_loop_closures(runs):
    first = runs["ekf"]
    assert len(first.loops) > 5
    for name in ("isam2", "batch", "gnc"):
        assert runs[name].chain is first.chain
        assert runs[name].loops is first.loops
    assert runs["dead-reckoning"].loops is None


def test_what_all_back_ends_share_cannot_be_changed(runs):
    for shared in (runs["ekf"].chain, runs["ekf"].loops):
        with pytest.raises(ValueError, match="read-only"):
            shared.covariance[0] = 0.0


def test_metrics_count_loop_closures_and_association_says_whether_they_are_right(log, runs):
    scores = score([Trial(log, "slam", tuple(runs.values()))])
    rows = scores.metrics.set_index(["estimator", "phase"])
    loops = runs["ekf"].loops
    assert rows.loc[("ekf", "online"), "observations"] == len(loops)
    assert rows.loc[("isam2", "final"), "accepted"] == (loops.believed >= 0).sum()
    assert rows.loc[("dead-reckoning", "online"), "observations"] == 0
    counts = scores.association.set_index(["estimator", "phase"])[["tp", "tn", "fp", "fn"]]
    assert (counts.sum(axis=1) == len(loops)).all()
    assert (counts["fp"] == 0).all()
    assert not len(scores.relations)  # the log has none


def test_a_loop_closure_without_weight_counts_as_left_out_in_the_end_only(log, runs):
    run, weight = runs["gnc"], runs["gnc"].weight.copy()
    weight[np.flatnonzero(run.loops.believed >= 0)[:2]] = 0.0
    changed = replace(run, weight=weight)
    assert changed.kept("online").sum() - changed.kept("final").sum() == 2
    online, final = (closure_counts(changed, log, phase) for phase in ("online", "final"))
    assert final["fn"] - online["fn"] == 2
    assert online["tp"] - final["tp"] == 2


@pytest.mark.slow
def test_variances_are_scaled_by_what_loop_closures_tell_and_no_pose_moves_by_it():
    """Of these key poses some steps are spanned by no loop closure: they fit exactly and tell nothing."""
    longer = named_log("floorplan:0:frames=1000").recorded
    (run,) = compare(longer, "slam", ["batch"], "scan")
    parameters = LaserParameters()
    front = run_front_end(longer, parameters)
    (factor, error), claimed = run.scale, front.chain.covariance[1:] / parameters.variance_scale
    assert 0.2 < factor < 1.5
    assert 0.0 < error < 0.3 * factor
    np.testing.assert_allclose(run.chain.covariance[1:], factor * claimed, rtol=1e-9)
    unscaled = smoothed("batch", key_inputs(longer, front.chain, front.loops))
    np.testing.assert_allclose(run.key_pose, unscaled.final.pose, atol=1e-6)


def test_with_enough_loop_closures_every_estimator_gets_the_scale_and_no_pose_moves(log, runs, monkeypatch):
    given = runs["batch"]
    front = FrontEndResult(given.chain, given.loops, given.last, given.frame_seconds, given.key_pose)
    monkeypatch.setattr(front_end, "consistent_front_end", lambda inputs, parameters: (front, None))
    monkeypatch.setattr(front_end, "FEWEST", 1)
    filtered, smoothed, dead = compare(log.recorded, "slam", ["ekf", "batch", "dead-reckoning"], "scan")
    assert filtered.scale == smoothed.scale
    assert dead.scale is None
    np.testing.assert_allclose(smoothed.key_pose, given.key_pose, atol=1e-6)
    np.testing.assert_allclose(filtered.chain.motion, given.chain.motion)
    factor = smoothed.scale[0] / LaserParameters().variance_scale
    assert 0.05 < factor < 1.5
    np.testing.assert_allclose(filtered.chain.covariance, factor * given.chain.covariance)
    np.testing.assert_allclose(filtered.loops.covariance, factor * given.loops.covariance)
    # chi-square of the graph is that of its degrees of freedom, once the scale is in
    nis, dof = smoothed.total_nis
    assert nis == pytest.approx(dof, rel=0.5)
    assert given.total_nis[0] == pytest.approx(factor * nis, rel=1e-3)


def test_with_few_loop_closures_no_scale_is_learned(runs):
    assert (runs["batch"].loops.believed >= 0).sum() < FEWEST
    assert runs["batch"].scale is None


def test_between_two_scans_the_odometry_is_made_to_lead_from_the_one_to_the_other(log):
    frames = np.arange(0, len(log.recorded), 10)
    scans = log.recorded.scans
    inputs = replace(log.recorded, scans=Scans(scans.scanner, frames, scans.ranges[frames]))
    truth = log.truth.pose
    path = truth.copy()
    for k in range(len(path)):  # between scans by odometry alone
        if k % 10:
            path[k] = compose(path[k - 1], inputs.increments.mean[k])
    mended = between_scans(inputs, path)
    np.testing.assert_array_equal(mended[frames], path[frames])
    last = frames[-1]
    np.testing.assert_array_equal(mended[last:], path[last:])
    before, after = (np.abs(pose_error(p, truth)[:last]).mean(axis=0) for p in (path, mended))
    assert (after < 0.8 * before).all()


@pytest.mark.slow
def test_corners_of_walls_are_landmarks_under_any_other_association(log, runs):
    (run,) = compare(log.recorded, "slam", ["ekf"], "jcbb")
    assert isinstance(run, LaserRun)
    assert len(run.map) > 3
    assert run.online.pose.shape == log.truth.pose.shape
    assert run.status == "ok"
    assert run.state_size.shape == (len(log.recorded),)
    assert run.state_size[-1] == 3 + 2 * len(run.map)
    # each frame hangs on its key pose as under scan matching
    chain = runs["ekf"].chain
    np.testing.assert_allclose(
        pose_error(between(run.online.pose[chain.frame[chain.key]], run.online.pose), chain.since), 0.0, atol=1e-9
    )
    (row,) = score([Trial(log, "slam", (run,))]).metrics.to_dict("records")
    assert row["landmarks"] == len(run.map)
    assert row["rmse_position_m"] < 0.3
