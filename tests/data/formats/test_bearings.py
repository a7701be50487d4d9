"""Graphs of bearings alone: landmarks begin where their rays cross, whatever the file's vertices are."""

from __future__ import annotations

import numpy as np
import pytest

import slamref
from data import se2
from data.formats.g2o import log_of, read_graph
from eval.replay.settings import Setup
from eval.studies.twins import source_of, twin

RADIUS, FRAMES = 8.0, 120
STEP = np.array([0.4, 0.0, 0.4 / RADIUS])
SIGMA = [0.02, 0.02, 0.005]
SIGMA_BEARING = 0.01


def circle(path, points, *, frames=FRAMES, reach=12.0, seed=0):
    """A robot on a circle that sees the directions of landmarks; returns its true path (N, 3).

    Vertices of poses are the odometry's; of landmarks the `true` ones, all `zero`, or `none`.
    """
    rng = np.random.default_rng(seed)
    landmarks = rng.uniform(-14.0, 14.0, (14, 2))
    true, reckoned, edges = [np.array([RADIUS, 0.0, 0.5 * np.pi])], [np.array([RADIUS, 0.0, 0.5 * np.pi])], []
    for k in range(frames - 1):
        true.append(se2.compose(true[-1], STEP))
        measured = STEP + rng.normal(size=3) * SIGMA
        reckoned.append(se2.compose(reckoned[-1], measured))
        x, y, a = (1.0 / s**2 for s in SIGMA)
        edges.append(f"EDGE_SE2 {k} {k + 1} {' '.join(map(repr, measured.tolist()))} {x} 0 0 {y} 0 {a}")
    for k, pose in enumerate(true):
        off = landmarks - pose[:2]
        bearing = np.arctan2(off[:, 1], off[:, 0]) - pose[2] + SIGMA_BEARING * rng.normal(size=len(off))
        for i in np.flatnonzero(np.hypot(*off.T) < reach):
            turned = float(se2.wrap_angle(bearing[i]))
            edges.append(f"EDGE_BEARING_SE2_XY {k} {1000 + i} {turned!r} {SIGMA_BEARING**-2}")
    lines = [f"VERTEX_SE2 {k} {' '.join(map(repr, p.tolist()))}" for k, p in enumerate(reckoned)]
    if points != "none":
        places = landmarks if points == "true" else np.zeros_like(landmarks)
        lines += [f"VERTEX_XY {1000 + i} {x} {y}" for i, (x, y) in enumerate(places.tolist())]
    path.write_text("\n".join([*lines, *edges, "FIX 0"]) + "\n")
    return np.array(true)


@pytest.mark.parametrize("points", ["none", *(pytest.param(p, marks=pytest.mark.slow) for p in ("true", "zero"))])
def test_a_graph_of_bearings_is_solved_whatever_its_vertices(points, tmp_path):
    true = circle(tmp_path / "b.g2o", points)
    log = log_of("bearings", read_graph(tmp_path / "b.g2o"))
    runs = slamref.compare(log.inputs(labels=True), "slam", ["ekf", "isam2", "batch"])
    rmse = {}
    for run in runs:
        assert run.failure is None
        off = run.trajectory(run.phases[-1]).pose[:, :2] - true[:, :2]
        rmse[run.estimator] = float(np.sqrt((off**2).sum(axis=1).mean()))
    assert max(rmse["isam2"], rmse["batch"]) < 0.06
    assert rmse["ekf"] < 0.2
    trial = slamref.Trial(log, "slam", tuple(runs))
    assert "landmarks" not in {n.code for n in slamref.notices([trial])}
    nis = slamref.score([trial]).metrics.query("estimator == 'batch'").nis
    assert nis.item() == pytest.approx(1.0, abs=0.15)  # a bearing has one degree of freedom


def test_twins_of_bearings_draw_no_ranges(tmp_path):
    circle(tmp_path / "b.g2o", "none")
    log = log_of("bearings", read_graph(tmp_path / "b.g2o"))
    (smoother,) = slamref.compare(log.inputs(labels=True), "slam", ["batch"])
    found = twin(source_of(log, smoother, ("batch",), Setup()), 0).recorded.observations
    np.testing.assert_array_equal(found.z[:, 0], log.recorded.observations.z[:, 0])
    off = se2.wrap_angle(found.z[:, 1] - log.recorded.observations.z[:, 1])
    assert np.std(off) == pytest.approx(np.sqrt(2.0) * SIGMA_BEARING, rel=0.1)
