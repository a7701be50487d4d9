"""One front end and every back end on its constraints: the same optimum, and every frame at its best place."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from data.inputs import Scans
from data.se2 import between, compose, pose_error
from data.worlds.registry import named_log
from eval.referee.score import Trial, score
from eval.replay.run import compare
from eval.replay.settings import ESTIMATORS, OF_SCANS
from tests.builders.logs import increments_of, inputs_of
from tests.graph.poses.worlds import corridors
from wings.laser.scans.constraints import Chain, LaserRun, Loops
from wings.laser.score import closure_counts
from wings.laser.slam import front_end
from wings.laser.slam.backends import estimated, key_inputs, smoothed, wheels_alone
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


def test_all_back_ends_get_the_same_chain_and_loop_closures_which_cannot_be_changed(runs):
    first = runs["ekf"]
    assert len(first.loops) > 5
    for name in ("isam2", "batch", "gnc"):
        assert runs[name].chain is first.chain
        assert runs[name].loops is first.loops
    assert runs["dead-reckoning"].loops is None
    for shared in (first.chain, first.loops):
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
    assert (given.loops.believed >= 0).sum() < FEWEST
    assert given.scale is None, "with few no scale is learned"
    front = FrontEndResult(given.chain, given.loops, given.last, given.frame_seconds, given.key_pose, given.loose)
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
    nis, dof = smoothed.total_nis  # chi-square of the graph is that of its degrees of freedom, once the scale is in
    assert nis == pytest.approx(dof, rel=0.5)
    assert given.total_nis[0] == pytest.approx(factor * nis, rel=1e-3)


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
    chain = runs["ekf"].chain  # each frame hangs on its key pose as under scan matching
    np.testing.assert_allclose(
        pose_error(between(run.online.pose[chain.frame[chain.key]], run.online.pose), chain.since), 0.0, atol=1e-9
    )
    (row,) = score([Trial(log, "slam", (run,))]).metrics.to_dict("records")
    assert row["landmarks"] == len(run.map)
    assert row["rmse_position_m"] < 0.3


PER_KEY = 3
"""Frames from one key pose to the next."""


def laser_log(seed=1, keys=100):
    """Inputs, chain, loops (the first never believed), true poses (N, 3) of a world with frames between key poses."""
    world = corridors(seed, keys, loops=40, blocks=2)
    rng = np.random.default_rng(seed)
    n = PER_KEY * (keys - 1) + 1
    key = np.minimum(np.arange(n) // PER_KEY, keys - 1)
    since = np.zeros((n, 3))
    part = np.arange(n) % PER_KEY / PER_KEY
    since[:-1] = world.motion[np.minimum(key[:-1] + 1, keys - 1)] * part[:-1, None]
    since_covariance = 1e-4 * part[:, None, None] * np.eye(3)
    chain = Chain(PER_KEY * np.arange(keys), world.motion, world.covariance, key, since, since_covariance)
    believed = world.key2.copy()
    believed[0] = -1
    score = rng.uniform(0.5, 1.0, len(believed))
    loops = Loops(world.key1, world.key2, world.relative, world.loop_covariance, score, believed)
    truth = compose(world.truth[key], since)
    wheels = np.zeros((n, 3))
    wheels[1:] = between(truth[:-1], truth[1:]) + rng.normal(0, 0.02, (n - 1, 3))
    prior = world.prior()
    inputs = inputs_of(increments_of(wheels, 4e-4 * np.eye(3)), start=prior.mean, spread=prior.covariance)
    return inputs, chain, loops, truth


LOG = laser_log()


def rmse(pose, truth):
    return float(np.sqrt(((pose - truth)[:, :2] ** 2).sum(1).mean()))


@pytest.mark.parametrize("name", OF_SCANS[1:])
def test_every_back_end_has_a_path_of_all_frames_and_beats_wheels_alone(name):
    inputs, chain, loops, truth = LOG
    solved = estimated(name, inputs, chain, loops)
    run = solved.run
    assert name in ESTIMATORS
    assert (run.estimator, run.task, run.status) == (name, "slam", "ok")
    assert run.association == "scan"
    assert len(run.decisions) == len(run.final_decisions) == len(run.created) == 0
    assert ("online" in run.phases) == (name in ("ekf", "isam2", "fixed-lag"))
    assert ("final" in run.phases) == (name != "ekf")
    wheels = rmse(wheels_alone(inputs).online.pose, truth)
    for phase in run.phases:
        path = run.trajectory(phase)
        assert path.pose.shape == truth.shape
        assert np.linalg.eigvalsh(path.covariance[1:]).min() > 0.0
        assert rmse(path.pose, truth) < 0.5 * wheels
    assert np.isnan(solved.weight[0])
    if name not in ("ekf", "fixed-lag"):
        assert run.last_step_sigma < 1e-3
        assert run.iterations > 0
        np.testing.assert_allclose(solved.final_keys, run.final.pose[chain.frame], atol=1e-12)
    if name in ("ekf", "batch", "gnc"):
        total, dof = run.total_nis
        assert chi2.ppf(1e-6, dof) < total < chi2.ppf(1.0 - 1e-6, dof)


def test_isam2_and_batch_end_at_the_same_optimum():
    inputs, chain, loops, _ = LOG
    a, b = estimated("isam2", inputs, chain, loops), estimated("batch", inputs, chain, loops)
    sigma = np.sqrt(np.diagonal(b.run.final.covariance[1:], axis1=1, axis2=2))
    assert np.abs(pose_error(a.run.final.pose[1:], b.run.final.pose[1:]) / sigma).max() < 1e-3
    assert a.run.total_nis == pytest.approx(b.run.total_nis)


@pytest.mark.parametrize("name", ["ekf", "isam2", "fixed-lag"])
def test_online_nothing_is_known_of_what_comes_later(name):
    inputs, chain, loops, _ = LOG
    cut = int(loops.believed[20])
    known = loops.believed <= cut
    past = Loops(*(getattr(loops, f)[known] for f in ("key1", "key2", "relative", "covariance", "score", "believed")))
    whole, part = (estimated(name, inputs, chain, each).run.online for each in (loops, past))
    same = chain.key <= cut
    np.testing.assert_array_equal(whole.pose[same], part.pose[same])
    np.testing.assert_array_equal(whole.covariance[same], part.covariance[same])
    assert np.abs(whole.pose - part.pose)[~same].max() > 1e-3


@pytest.mark.parametrize("name", ["ekf", "isam2"])
def test_a_loop_closure_counts_from_the_key_pose_at_which_it_is_believed(name):
    inputs, chain, loops, _ = LOG
    first = int(loops.believed[1:].min())
    without = estimated(name, inputs, chain, replace(loops, believed=np.full(len(loops), -1))).run.online
    with_it = estimated(name, inputs, chain, loops).run.online
    before = chain.key < first
    np.testing.assert_array_equal(with_it.pose[before], without.pose[before])
    at = chain.frame[first]
    assert np.trace(with_it.covariance[at]) < np.trace(without.covariance[at])


def test_false_loop_closures_are_told_by_the_gate_and_by_gnc_and_their_weight_says_so():
    inputs, chain, loops, truth = LOG
    i, keys = np.array([30, 31]), truth[chain.frame]
    wrong = compose(between(keys[loops.key1[i]], keys[loops.key2[i]]), np.array([[3.0, 1.0, 0.2]] * 2))
    relative = loops.relative.copy()
    relative[i] = wrong
    bad = replace(loops, relative=relative)
    for name, kwargs in (("gnc", {}), ("ekf", {"gate": 0.9999}), ("batch-cauchy", {})):
        solved = estimated(name, inputs, chain, bad, **kwargs)
        assert (solved.weight[i] < 0.01).all()
        assert rmse(solved.run.trajectory(solved.run.phases[-1]).pose, truth) < 1.0
