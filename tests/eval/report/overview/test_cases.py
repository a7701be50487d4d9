"""Headlines of logs on which users acted: what stands there may not contradict the numbers of the same report."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import slamref
from data.inputs import Increments, Inputs, LandmarkMap, Observations, Prior
from data.log import Log, shortened
from data.logs import open_log
from data.sensors import RangeBearing
from data.truth import Truth
from eval.compare import compare
from eval.judgement.judgement import judge
from eval.referee.score import Trial, score
from eval.report.overview import trust_mark
from tests.quick import slow


def first_screen(log: Log, task: str, association: str):
    """Facts and mark of EKF and batch on a log, as `slamref run` shows them first."""
    inputs = log.inputs(labels=association == "known")
    inputs = inputs.without_map() if task == "slam" else inputs
    trial = Trial(log, task, tuple(compare(inputs, task, ("ekf", "batch"), association)))
    facts = judge(trial, score([trial]), ())
    return facts, trust_mark(facts)


def turn_first(frames: int = 300) -> Log:
    """Exact readings on a circle of 4 m/s and 0.4 rad/s whose truth turns and then drives; increments are arcs."""
    dt, v, w = 0.1, 4.0, 0.4
    theta = w * dt * np.arange(frames)
    step = v * dt * np.stack([np.cos(theta), np.sin(theta)], axis=1)
    path = np.column_stack([np.cumsum(step, axis=0) - step[0], theta])
    arc = np.array([v / w * np.sin(w * dt), v / w * (1.0 - np.cos(w * dt)), w * dt])
    mean = np.vstack([np.zeros(3), np.tile(arc, (frames - 1, 1))])
    angle = 2.0 * np.pi * np.arange(8) / 8
    places = LandmarkMap(np.arange(8), np.array([0.0, 10.0]) + 14.0 * np.column_stack([np.cos(angle), np.sin(angle)]))
    sensor = RangeBearing(max_range=12.0)
    frame, which, z = [], [], []
    for k in range(frames):
        seen = sensor.predict(path[k], places.xy)
        for i in np.flatnonzero(seen[:, 0] < 12.0):
            frame.append(k), which.append(i), z.append(seen[i])
    R = np.tile(np.diag([0.1**2, 0.03**2]), (len(z), 1, 1))
    inputs = Inputs(
        Prior(path[0], np.diag([0.01, 0.01, 0.001]) ** 2), dt * np.arange(frames),
        Increments(mean, np.tile(np.diag([0.02, 0.001, 0.002]) ** 2, (frames, 1, 1))),
        Observations(np.array(frame), np.array(z), R), sensor, places,
    )  # fmt: skip
    return Log("turn-first", inputs, Truth(path, places, np.array(which)))


def test_pairings_of_the_nearest_neighbour_that_ruin_nees_take_the_tick():
    facts, mark = first_screen(open_log("corridor:3"), "localization", "nn")
    assert facts.compared.smoothed.nees > 100
    assert mark.tone != "good"
    assert "NEES 136" in mark.note


def test_a_motion_model_that_integrates_otherwise_takes_the_tick():
    facts, mark = first_screen(turn_first(), "localization", "known")
    assert facts.compared.filtered.nees > 9
    assert mark.tone != "good"
    assert f"NEES {facts.compared.smoothed.nees:.3g}" in mark.note


def test_a_smoother_other_than_batch_is_compared_and_not_denied():
    """Without truth the tests need batch; iSAM2 beside the filter is a smoother all the same."""
    log = shortened(open_log("arena:0"), 60)
    blind = replace(log, truth=replace(log.truth, pose=None))
    ekf, isam2 = compare(blind.inputs(labels=True).without_map(), "slam", ("ekf", "isam2"), "known")

    def judged(*runs):
        trial = Trial(blind, "slam", runs)
        facts = judge(trial, score([trial]), ())
        return facts, trust_mark(facts)

    facts, mark = judged(ekf, isam2)
    assert mark.note == "no ground truth, and only batch gives the tests that need none"
    off = ekf.online.pose[:, :2] - isam2.final.pose[:, :2]
    assert facts.compared.apart == pytest.approx(np.sqrt(np.mean(np.sum(off**2, axis=1))), rel=1e-12)
    assert judged(ekf)[1].note == "no smoother ran"


def test_copies_of_dead_reckoning_are_not_equally_good_estimates(tmp_path):
    chain = [f"VERTEX_SE2 {k} {k} 0 0" for k in range(30)]
    chain += [f"EDGE_SE2 {k} {k + 1} 1 0 0 100 0 0 100 0 400" for k in range(29)]
    (tmp_path / "chain.g2o").write_text("\n".join(chain) + "\n")
    assert slamref.main(["convert", "g2o", str(tmp_path / "chain.g2o"), str(tmp_path / "chain")]) == 0
    _, mark = first_screen(open_log(tmp_path / "chain"), "slam", "jcbb")
    assert (mark.word, mark.tone) == ("neither", "bad")


@pytest.mark.parametrize("seed", [0, slow(1), slow(2)])
def test_right_logs_keep_their_tick(seed):
    for task in ("localization", "slam"):
        _, mark = first_screen(open_log(f"arena:{seed}"), task, "known")
        assert (mark.word in ("smoother", "either"), mark.tone) == (True, "good")
