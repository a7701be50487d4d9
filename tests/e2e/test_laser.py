"""A laser log from the command line: relations, loop closures, the map for people and for map servers."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from data.formats.open_log import write_folder
from data.logs import open_log
from data.se2 import between
from data.truth import Relations
from data.worlds.registry import named_log
from eval.referee.consistency import CONSISTENT, nees, verdict
from eval.referee.score import confusion_of
from eval.replay.run import compare
from eval.run_all import main
from tests.builders.tables import rows

LOOPS = "key1,key2,dx,dy,dtheta,c_xx,c_xy,c_xt,c_yy,c_yt,c_tt,score,accepted,final"


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """An open log folder with scans and relations taken from its truth, which is left out; run as a person would."""
    place = tmp_path_factory.mktemp("laser")
    log = named_log("floorplan:0:frames=700")
    pose = log.truth.pose
    row1 = np.arange(0, 680, 20)
    row2 = row1[::-1].copy()
    exact = (np.arange(len(row1)) % 2).astype(np.int64)
    stamp = np.stack([log.recorded.time[row1], log.recorded.time[row2]], 1)
    relations = Relations(row1, row2, between(pose[row1], pose[row2]), exact, stamp)
    write_folder(replace(log, name="plan", truth=replace(log.truth, pose=None, relations=relations)), place / "plan")
    out = place / "out"
    arguments = ["--log", str(place / "plan"), "--out", str(out), "--no-plots", "--jobs", "1", "-q"]
    assert main([*arguments, "--estimator", "dead-reckoning,ekf,isam2"]) == 0
    return out


def test_relations_are_scored_by_row_and_by_time_for_every_phase(results):
    of_plan = [r for r in rows(results / "relations.csv") if r["log"] == "plan"]
    found = {(r["estimator"], r["phase"], r["tie"], r["subset"]): r for r in of_plan}
    assert len(found) == (1 + 1 + 2) * 4
    best = found["isam2", "final", "row", "all"]
    assert float(best["trans_mean_m"]) < 0.1 < float(found["dead-reckoning", "online", "row", "all"]["trans_mean_m"])
    assert int(best["relations"]) == 34
    assert int(found["isam2", "final", "row", "exact"]["relations"]) == 17
    # the stamps are those of the rows
    assert found["isam2", "final", "time", "all"]["trans_mean_m"] == best["trans_mean_m"]


def test_map_and_loop_closures_are_written_without_plots_too(results):
    place = results / "runs" / "plan"
    files = {"map.png", "map.pgm", "map.yaml", "loops.csv", "graph.g2o"}
    assert {p.name for p in place.iterdir() if p.is_file()} == files
    assert (place / "loops.csv").read_text().splitlines()[0] == LOOPS
    loops = rows(place / "loops.csv")
    assert all(int(r["key1"]) < int(r["key2"]) for r in loops)
    assert any(r["accepted"] == "1" and r["final"] == "1" for r in loops)
    assert (place / "map.pgm").read_bytes().startswith(b"P5\n")


def test_the_graph_of_key_poses_opens_in_gtsam_at_its_own_minimum(results):
    place = results / "runs" / "plan"
    graph, values = gtsam.readG2o(str(place / "graph.g2o"), False)
    loops = sum(int(row["final"]) for row in rows(place / "loops.csv"))
    assert graph.size() == values.size() - 1 + loops
    graph = gtsam.NonlinearFactorGraph(graph)
    graph.add(gtsam.NonlinearEqualityPose2(0, values.atPose2(0)))
    best = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    assert graph.error(values) == pytest.approx(graph.error(best), rel=1e-3)


def test_a_log_without_scans_has_none_to_match(refused, tmp_path):
    assert "has no laser scans" in refused(
        main, ["--log", "arena:0", "--association", "scan", "--out", str(tmp_path / "out"), "-q"]
    )


SEEDS = range(50)
FIRST = 20
"""Frames, 5 s: until walls are seen odometry's rounding is all there is."""


def drive(log, task, name, association):
    """Pose error at the end [m], mean pose NEES, wrong pairings of a run."""
    (run,) = compare(log.inputs(labels=association == "known"), task, [name], association)
    assert run.status == "ok"
    path = run.online
    c = confusion_of(run, log, "online")
    end = float(np.hypot(*(path.pose[-1, :2] - log.truth.pose[-1, :2])))
    means = nees(path.pose, path.covariance, log.truth.pose, "pose")
    return end, float(np.nanmean(means[FIRST:])), c.wrong + c.spurious


@pytest.mark.slow
def test_walls_are_found_and_the_robot_back_at_the_start_knows_where_it_is():
    end, _, wrong = drive(open_log("walls:0:frames=660"), "slam", "ekf-fej", "jcbb")
    assert end < 0.1
    assert wrong == 0


@pytest.mark.slow
def test_over_fifty_drives_the_end_is_known_to_five_centimetres_and_claims_are_right():
    """Labels known; the robot drives twice round the room of 10 x 6 m with two boxes and ends near its start."""
    ends, means = {}, {}
    for seed in SEEDS:
        log = open_log(f"walls:{seed}:room=0")
        for task, name in (("slam", "ekf-fej"), ("slam", "isam2"), ("localization", "isam2")):
            end, mean, _ = drive(log, task, name, "known")
            ends.setdefault((task, name), []).append(end)
            means.setdefault((task, name), []).append(mean)
    for key, values in ends.items():
        assert np.sqrt(np.mean(np.square(values))) < 0.05, key
        found = verdict(np.array(means[key]), 3)
        assert found.word == CONSISTENT, f"{key}: {found.mean:.2f} [{found.lower:.2f}, {found.upper:.2f}]"
