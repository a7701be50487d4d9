"""Size, power and speed of the audit of factor graphs, on structures like those of the usual benchmarks.

Each structure is a true graph; graphs are drawn from it with the stated noise (Gaussian in the tangent space). Size:
clean graphs in which anything is rejected. Power: one loop off by 5 sigma in each component is named first;
odometry with sigmas 1.3 times as large is put down to odometry. Odd numbers of a draw are re-optimized, even ones are
examined on the linear problem at the true values.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import gtsam
import numpy as np
import pandas as pd

from wings.audit.examined import AuditReport, audit
from wings.audit.files import optimized

N = gtsam.noiseModel
PLANE, SPACE = np.array([0.1, 0.1, 0.03]), np.array([0.02, 0.02, 0.02, 0.1, 0.1, 0.1])
LOOP = 0.10  # redundancy per dimension above which a wrong loop has to be named


class Structure:
    """A true graph: poses by number, relations (a, b), landmarks (pose, landmark, position)."""

    def __init__(self, poses: list, pairs: list[tuple[int, int]], sigma: np.ndarray, seen: list | None = None) -> None:
        self.poses, self.pairs, self.sigma, self.seen = poses, pairs, sigma, seen or []
        self.loops = [i for i, (a, b) in enumerate(pairs) if b != a + 1]

    def graph(
        self, rng: np.random.Generator, odometry: float = 1.0, wrong: int = -1, loops: dict | None = None
    ) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
        """A graph drawn, and the true values; factor `wrong` off by 5 sigma in each component."""
        plane = len(self.sigma) == 3
        factor = gtsam.BetweenFactorPose2 if plane else gtsam.BetweenFactorPose3
        graph, values, model = gtsam.NonlinearFactorGraph(), gtsam.Values(), N.Diagonal.Sigmas(self.sigma)
        for k, pose in enumerate(self.poses):
            values.insert(k, pose)
        for i, (a, b) in enumerate(self.pairs):
            e = rng.normal(0, self.sigma) * (odometry if b == a + 1 else 1.0)
            if i == wrong:
                e += 5.0 * self.sigma * rng.choice([-1.0, 1.0], len(e))
            z = self.poses[a].between(self.poses[b])
            z = (loops or {}).get(i, z)
            graph.add(factor(a, b, z.retract(e), model))
        noise = N.Diagonal.Sigmas([0.02, 0.1])
        for pose, landmark, xy in self.seen:
            key = gtsam.symbol("l", landmark)
            if not values.exists(key):
                values.insert(key, xy)
            bearing = self.poses[pose].bearing(xy).theta() + rng.normal(0, 0.02)
            r = self.poses[pose].range(xy) + rng.normal(0, 0.1)
            graph.add(gtsam.BearingRangeFactor2D(pose, key, gtsam.Rot2(bearing), r, noise))
        return graph, values


def near(poses: list, radius: float, gap: int, rng: np.random.Generator, share: float) -> list[tuple[int, int]]:
    """Pairs of near poses of different times, `share` of them."""
    from scipy.spatial import cKDTree

    xyz = np.array([np.r_[p.translation(), 0.0][:3] for p in poses])
    pairs = cKDTree(xyz).query_pairs(radius, output_type="ndarray")
    pairs = pairs[np.argsort(pairs[:, 0] * len(poses) + pairs[:, 1])]
    pairs = pairs[np.abs(pairs[:, 0] - pairs[:, 1]) > gap]
    return [(int(a), int(b)) for a, b in pairs[rng.random(len(pairs)) < share]]


def manhattan(n: int, seed: int = 0, side: float = 0.0, share: float = 0.25) -> Structure:
    """A walk over a grid of streets (M3500, city10000)."""
    rng = np.random.default_rng(seed)
    side = side or 0.6 * np.sqrt(n)
    poses = [gtsam.Pose2()]
    while len(poses) < n:
        p = poses[-1]
        turn = rng.choice([0.0, np.pi / 2, -np.pi / 2], p=[0.8, 0.1, 0.1])
        q = p.compose(gtsam.Pose2(1, 0, turn))
        ahead = q.compose(gtsam.Pose2(1, 0, 0))
        if max(abs(ahead.x()), abs(ahead.y())) > side:
            q = p.compose(gtsam.Pose2(1, 0, np.pi / 2 if rng.random() < 0.5 else -np.pi / 2))
            if max(abs(q.x()), abs(q.y())) > side + 1:
                q = p.compose(gtsam.Pose2(0, 0, np.pi))
        poses.append(q)
    return Structure(poses, [(k, k + 1) for k in range(n - 1)] + near(poses, 1.1, 10, rng, share), PLANE)


def corridors(n: int, seed: int = 0) -> Structure:
    """Long loops of a building, rarely closed (CSAIL, Intel)."""
    rng = np.random.default_rng(seed)
    poses = [gtsam.Pose2()]
    while len(poses) < n:
        leg = int(rng.integers(8, 20))
        for k in range(leg):
            poses.append(poses[-1].compose(gtsam.Pose2(1, 0, np.pi / 2 if k == leg - 1 else 0.0)))
    poses = poses[:n]
    return Structure(poses, [(k, k + 1) for k in range(n - 1)] + near(poses, 2.0, 20, rng, 0.3), PLANE)


def laser(n: int, seed: int = 0) -> Structure:
    """As `corridors`, closed often (Intel)."""
    s = corridors(n, seed + 7)
    return Structure(s.poses, s.pairs[: n - 1] + near(s.poses, 2.2, 20, np.random.default_rng(seed), 0.5), PLANE)


def landmarks(n: int, seed: int = 0) -> Structure:
    """A walk that sees landmarks by bearing and range."""
    rng = np.random.default_rng(seed)
    s = manhattan(n, seed)
    xy = rng.uniform(-0.7 * np.sqrt(n), 0.7 * np.sqrt(n), (n // 4, 2))
    seen = [
        (k, int(j), xy[j])
        for k, p in enumerate(s.poses)
        for j in np.argsort(np.hypot(*(xy - p.translation()).T))[:3]
        if 0.5 < p.range(xy[j]) < 8.0
    ]
    return Structure(s.poses, s.pairs[: n - 1], PLANE, seen)


def sphere(n: int, seed: int = 0) -> Structure:
    """Rings of a sphere, each tied to the one below (sphere2500)."""
    ring = max(int(np.sqrt(n)), 4)
    poses = []
    for k in range(n):
        up, round_ = -1.3 + 2.6 * k / n, 2 * np.pi * k / ring
        R = gtsam.Rot3.RzRyRx(0.0, up, round_)
        poses.append(gtsam.Pose3(R, R.matrix() @ np.array([0.2 * ring, 0, 0])))
    return Structure(poses, [(k, k + 1) for k in range(n - 1)] + [(k, k + ring) for k in range(n - ring)], SPACE)


def garage(n: int, seed: int = 0) -> Structure:
    """A car up and down a spiral of four floors (parking garage)."""
    rng = np.random.default_rng(seed)
    poses = []
    for k in range(n):
        t = k / n
        level = 4 * (1 - abs(2 * t - 1))
        a = 2 * np.pi * level * 2
        R = gtsam.Rot3.RzRyRx(0.0, -0.05, a + np.pi / 2 * (1 if t < 0.5 else -1))
        poses.append(gtsam.Pose3(R, np.array([20 * np.cos(a), 12 * np.sin(a), 3 * level])))
    return Structure(poses, [(k, k + 1) for k in range(n - 1)] + near(poses, 2.5, 20, rng, 0.5), SPACE)


STRUCTURES: dict[str, Callable[[int, int], Structure]] = {
    "Manhattan": manhattan, "CSAIL-like": corridors, "Intel-like": laser, "landmarks": landmarks, "sphere": sphere,
    "garage": garage,
}  # fmt: skip


def examined(
    s: Structure, rng: np.random.Generator, relinearized: bool, draws: int = 100, **how: object
) -> AuditReport:
    """The audit of a drawn graph."""
    graph, values = s.graph(rng, **how)  # type: ignore[arg-type]
    return audit(graph, optimized(graph, values) if relinearized else values, draws=draws)


def size(out: Path, graphs: int, poses: int, names: tuple[str, ...] = tuple(STRUCTURES)) -> pd.DataFrame:
    """Size and power by structure, to OUT/audit-size.csv."""
    rows = []
    for name in names:
        s = STRUCTURES[name](poses, 0)
        any_, factor, named, told, checked, put = [], [], [], [], [], []
        for k in range(graphs):
            rng = np.random.default_rng([k, 1])
            clean = examined(s, rng, k % 2 == 1)
            any_.append(clean.rejected)
            factor.append(bool((clean.factors["p_family"] < 0.05).any()))
            if s.loops and k < graphs // 2:
                wrong = int(rng.choice(s.loops))
                r = examined(s, rng, k % 2 == 1, wrong=wrong)
                checked.append(r.factors["redundancy"][wrong] > LOOP * len(s.sigma))
                named.append(int(r.factors["p"].idxmin()) == wrong)
                told.append(bool(r.factors["p_family"][wrong] < 0.05))
            if k < graphs // 2:
                r = examined(s, rng, k % 2 == 1, odometry=1.3)
                tested = [*r.kinds["p_family"].items()]
                others = [r.kinds["component"][kind] for kind in r.kinds.index if kind != "odometry"]
                put.append(
                    dict(tested)["odometry"] < 0.05 and r.kinds["component"]["odometry"] > max(others, default=0.0)
                )
        ok = np.array(checked, bool)
        rows.append({
            "structure": name, "poses": poses, "factors": len(s.pairs) + len(s.seen), "graphs": graphs,
            "rejected_%": 100 * np.mean(any_), "factor_rejected_%": 100 * np.mean(factor),
            "loops": int(ok.sum()), "named_first_%": 100 * np.mean(np.array(named)[ok]) if ok.any() else np.nan,
            "rejected_loop_%": 100 * np.mean(np.array(told)[ok]) if ok.any() else np.nan,
            "odometry_1.3_%": 100 * np.mean(put),
        })  # fmt: skip
        print(rows[-1], flush=True)
    table = pd.DataFrame(rows)
    out.mkdir(parents=True, exist_ok=True)
    table.to_csv(out / "audit-size.csv", index=False)
    return table


def speed(out: Path, scale: float = 1.0) -> pd.DataFrame:
    """Processor time of the parts beside gtsam's marginals, to OUT/audit-speed.csv."""
    from threadpoolctl import threadpool_limits

    from wings.audit.audit import firsts
    from wings.audit.linear import factorize, joint_covariances, linearize, ordering

    rows = []
    for name, make, n in (
        ("Manhattan 3500", lambda n: manhattan(n, share=0.13), 3500),
        ("city 10000", lambda n: manhattan(n, share=0.16), 10000),
        ("sphere 2500", sphere, 2500),
    ):
        graph, values = make(int(n * scale)).graph(np.random.default_rng(0))
        with threadpool_limits(1):
            t = [time.process_time()]
            system = linearize(graph, values)
            f = factorize(system, ordering(system, firsts(system)))
            joint_covariances(f)
            t.append(time.process_time())
            audit(graph, values)
            t.append(time.process_time())
            held = gtsam.NonlinearFactorGraph(graph)
            if isinstance(values.atPose2(0) if len(system.dim) and system.dim[0] == 3 else None, gtsam.Pose2):
                held.add(gtsam.PriorFactorPose2(0, values.atPose2(0), N.Isotropic.Sigma(3, 0.1)))
            else:
                held.add(gtsam.PriorFactorPose3(0, values.atPose3(0), N.Isotropic.Sigma(6, 0.1)))
            marginals = gtsam.Marginals(held, values)
            some = range(0, graph.size(), max(1, graph.size() // 200))
            for i in some:
                marginals.jointMarginalCovariance(list(graph.at(i).keys())).fullMatrix()
            t.append(time.process_time())
        rows.append({
            "graph": name, "factors": graph.size(), "marginals_s": t[1] - t[0], "audit_s": t[2] - t[1],
            "gtsam_marginals_s": (t[3] - t[2]) * graph.size() / len(some),
        })  # fmt: skip
        print(rows[-1], flush=True)
    table = pd.DataFrame(rows)
    out.mkdir(parents=True, exist_ok=True)
    table.to_csv(out / "audit-speed.csv", index=False)
    return table
