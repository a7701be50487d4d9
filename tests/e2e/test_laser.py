"""A laser log from the command line: relations, loop closures, the map for people and for map servers."""

from __future__ import annotations

import csv
from dataclasses import replace

import gtsam
import numpy as np
import pytest

from data.formats.open_log import write_folder
from data.se2 import between
from data.truth import Relations
from data.worlds.registry import named_log
from eval.run_all import main

LOOPS = "key1,key2,dx,dy,dtheta,c_xx,c_xy,c_xt,c_yy,c_yt,c_tt,score,accepted,final"


def rows(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


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
    found = {
        (r["estimator"], r["phase"], r["tie"], r["subset"]): r
        for r in rows(results / "relations.csv")
        if r["log"] == "plan"
    }
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


def test_sparser_graphs_stand_beside(results):
    metrics = rows(results / "metrics.csv")
    assert {r["log"] for r in metrics} == {
        "plan",
        "plan:keyframe-distance=0.8",
        "plan:keyframe-distance=1.6",
    }
    assert all(r["status"] == "ok" for r in metrics)
    report = (results / "report.md").read_text(encoding="utf-8")
    assert "## Laser: plan" in report
    assert "how sparse the graph may be" in report
    assert not (results / "runs" / "plan_keyframe-distance=0.8" / "map.pgm").exists()


def test_a_log_without_scans_has_none_to_match(capsys, tmp_path):
    assert main(["--log", "arena:0", "--association", "scan", "--out", str(tmp_path / "out"), "-q"]) == 2
    assert "has no laser scans" in capsys.readouterr().err
