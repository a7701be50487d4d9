"""`python -m tests.research.speed`: audits beside gtsam's joint marginals of all factors, rendering, and detection."""

import statistics
import time
from collections.abc import Sequence
from typing import Any

import gtsam
import numpy as np
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from data.se2 import Array
from eval.benchmarks.speed import Timed, table
from wings.audit.examined import audit
from wings.audit.files import tied
from wings.audit.linear import Graph, Values
from wings.camera.detector import Detector
from wings.camera.gallery import Gallery
from wings.camera.rendering.render import Rendered

PLANE, SPACE = np.array([0.1, 0.1, 0.03]), np.array([0.02, 0.02, 0.02, 0.1, 0.1, 0.1])  # m, rad; rad, m
ASKED = 200  # factors whose joint marginal gtsam is asked for; the time is that of all


def streets(n: int, rng: np.random.Generator) -> list[gtsam.Pose2]:
    """A walk over a grid of streets, n poses, one metre apart."""
    side, poses = 0.6 * np.sqrt(n), [gtsam.Pose2()]
    while len(poses) < n:
        p = poses[-1]
        q = p.compose(gtsam.Pose2(1, 0, rng.choice([0.0, np.pi / 2, -np.pi / 2], p=[0.8, 0.1, 0.1])))
        ahead = q.compose(gtsam.Pose2(1, 0, 0))
        if max(abs(ahead.x()), abs(ahead.y())) > side:
            q = p.compose(gtsam.Pose2(1, 0, np.pi / 2 if rng.random() < 0.5 else -np.pi / 2))
            if max(abs(q.x()), abs(q.y())) > side + 1:
                q = p.compose(gtsam.Pose2(0, 0, np.pi))
        poses.append(q)
    return poses


def rings(n: int) -> list[gtsam.Pose3]:
    """Poses on rings of a sphere, as many of each as there are rings."""
    ring, poses = int(np.sqrt(n)), list[gtsam.Pose3]()
    for k in range(n):
        R = gtsam.Rot3.RzRyRx(0.0, -1.3 + 2.6 * k / n, 2 * np.pi * k / ring)
        poses.append(gtsam.Pose3(R, R.matrix() @ np.array([0.2 * ring, 0, 0])))
    return poses


def near(poses: Sequence[Any], radius: float, gap: int, share: float, rng: np.random.Generator) -> list[list[int]]:
    """Pairs of near poses of different times, `share` of them."""
    pairs = cKDTree([p.translation() for p in poses]).query_pairs(radius, output_type="ndarray")
    pairs = pairs[np.lexsort(pairs.T[::-1])]
    pairs = pairs[np.abs(pairs[:, 0] - pairs[:, 1]) > gap]
    kept: list[list[int]] = pairs[rng.random(len(pairs)) < share].tolist()
    return kept


def drawn(poses: Sequence[Any], loops: Sequence[Sequence[int]], sigma: Array, seed: int = 0) -> tuple[Graph, Values]:
    """A graph of odometry and loops with drawn noise, and the true values."""
    rng, graph, values = np.random.default_rng(seed), Graph(), Values()
    between: Any = gtsam.BetweenFactorPose2 if len(sigma) == 3 else gtsam.BetweenFactorPose3
    for k, pose in enumerate(poses):
        values.insert(k, pose)
    for a, b in [*([k, k + 1] for k in range(len(poses) - 1)), *loops]:
        z = poses[a].between(poses[b]).retract(rng.normal(0, sigma))
        graph.add(between(a, b, z, gtsam.noiseModel.Diagonal.Sigmas(sigma)))
    return graph, values


def lines(quick: bool) -> list[Timed]:
    """Processor time on one thread of graphs of 3500, 2500 (in space) and 15 000 poses; `quick`: a tenth."""
    out = list[Timed]()
    for what, n, goal in (("Manhattan", 3500, "<= 1.5 s"), ("sphere", 2500, "<= 5 s"), ("city", 15_000, "<= 8 s")):
        n, rng = n // 10 if quick else n, np.random.default_rng(0)
        if what == "sphere":
            ring = int(np.sqrt(n))
            graph, values = drawn(rings(n), [[k, k + ring] for k in range(n - ring)], SPACE)
        else:
            poses = streets(n, rng)
            graph, values = drawn(poses, near(poses, 1.1, 10, 0.16, rng), PLANE)
        with threadpool_limits(1):
            begin = time.process_time()
            audit(graph, values)
            ours = time.process_time() - begin
            graph.add(tied(values, values.keys()[0], lambda d: gtsam.noiseModel.Isotropic.Sigma(d, 1.0)))  # the gauge
            begin = time.process_time()
            marginals = gtsam.Marginals(graph, values)
            for i in range(0, graph.size(), max(1, graph.size() // ASKED)):
                marginals.jointMarginalCovariance(list(graph.at(i).keys())).fullMatrix()
            peer = (time.process_time() - begin) * graph.size() / min(ASKED, graph.size())
        title = f"audit: {what}, {n} poses, {graph.size()} factors"
        out.append(Timed(title, ours, graph.size(), "factors", "1", "" if quick else goal))
        out.append(Timed("peer: gtsam's joint marginals of all factors", peer, graph.size(), "factors",
                         f"{peer / ours:.1f}"))  # fmt: skip
    return out


def visual_lines(quick: bool) -> list[Timed]:
    recording = Rendered(Gallery(), 0, frames=6 if quick else 30)
    begin = time.perf_counter()
    frames = list(recording.frames())
    rendered = (time.perf_counter() - begin) / len(frames)
    detector = Detector(recording.references, recording.setup.width)
    detector.detect(frames[0].rgb, frames[0].xyz)
    taken = []
    for _ in range(1 if quick else 3):
        begin = time.perf_counter()
        found = sum(len(seen.detections) for _, seen in detector.detect_each(frames))
        taken.append((time.perf_counter() - begin) / len(frames))
    h, w = frames[0].rgb.shape[:2]
    each = found / len(frames)
    what = f"pictures found in a frame of {w} x {h}, {len(recording.references)} references ({each:.1f} found)"
    return [
        Timed(what, statistics.median(taken), 1, "frames", "", ">= 10 frames/s"),
        Timed("a frame rendered with its stereo points", rendered, 1, "frames"),
    ]


if __name__ == "__main__":
    for of in (lines, visual_lines):
        print(table(of(quick=False)), flush=True)
