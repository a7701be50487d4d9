"""What the audit finds, on structures like those of the usual benchmarks.

Each structure is a true graph; graphs are drawn from it with the stated noise (Gaussian in the tangent space), and
spoilt. All are optimized from the path of odometry. It is told how often a false factor is named first, all false ones
and no other are named, and a sound one is, beside what can be known (`chance`).
"""

import time
from collections.abc import Callable, Collection
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import NamedTuple

import gtsam
import numpy as np
import pandas as pd
from scipy.stats import chi2, ncx2, norm

from tests.research.rows import append, read
from tests.research.speed import PLANE, SPACE, near, rings, streets
from wings.audit.audit import without
from wings.audit.examined import audit
from wings.audit.factors import FAMILY, PARTS, directions, tests
from wings.audit.files import optimized
from wings.audit.linear import linearize, ordering

N = gtsam.noiseModel
SEEN = np.array([0.02, 0.1])  # rad, m
DECIDABLE = 0.99  # probability of the ideal test above which a false factor has to be named
LEAST = 15  # loops of a structure
ELSEWHERE = np.inf  # strength of a loop that takes one place for another


class Structure:
    """A true graph: poses by number, relations (a, b), landmarks (pose, landmark, position)."""

    def __init__(self, poses: list, pairs: list[tuple[int, int]], sigma: np.ndarray, seen: list | None = None) -> None:
        self.poses, self.pairs, self.sigma, self.seen = poses, pairs, sigma, seen or []
        self.loops = [i for i, (a, b) in enumerate(pairs) if b != a + 1]
        self.factor = gtsam.BetweenFactorPose2 if len(sigma) == 3 else gtsam.BetweenFactorPose3

    def relation(self, a: int, b: int, z: object, off: np.ndarray) -> gtsam.NonlinearFactor:
        """A relation of two poses, drawn around `z` with an error of its own."""
        return self.factor(a, b, z.retract(off), N.Diagonal.Sigmas(self.sigma))

    def observation(self, pose: int, landmark: int, xy: np.ndarray, off: np.ndarray) -> gtsam.NonlinearFactor:
        """A bearing and range from a pose to a place, of a landmark, with an error of its own."""
        bearing = gtsam.Rot2(self.poses[pose].bearing(xy).theta() + off[0])
        r = abs(self.poses[pose].range(xy) + off[1])
        return gtsam.BearingRangeFactor2D(pose, gtsam.symbol("l", landmark), bearing, r, N.Diagonal.Sigmas(SEEN))

    def graph(self, rng: np.random.Generator, odometry: float = 1.0) -> gtsam.NonlinearFactorGraph:
        """A graph drawn, its odometry with sigmas as many times as large as stated."""
        out = gtsam.NonlinearFactorGraph()
        for a, b in self.pairs:
            e = rng.normal(0, self.sigma) * (odometry if b == a + 1 else 1.0)
            out.add(self.relation(a, b, self.poses[a].between(self.poses[b]), e))
        for pose, landmark, xy in self.seen:
            out.add(self.observation(pose, landmark, xy, rng.normal(0, SEEN)))
        return out

    def path(self, graph: gtsam.NonlinearFactorGraph) -> gtsam.Values:
        """Values along odometry, from the true first pose; landmarks where they are seen first."""
        values, at = gtsam.Values(), self.poses[0]
        values.insert(0, at)
        for k in range(len(self.poses) - 1):
            at = at.compose(graph.at(k).measured())
            values.insert(k + 1, at)
        for i, (pose, landmark, _) in enumerate(self.seen, len(self.pairs)):
            if not values.exists(gtsam.symbol("l", landmark)):
                z = graph.at(i).measured()
                xy = values.atPose2(pose).transformFrom(z.range() * z.bearing().rotate(np.array([1.0, 0.0])))
                values.insert(gtsam.symbol("l", landmark), xy)
        return values


def manhattan(n: int, seed: int = 0, share: float = 0.25) -> Structure:
    """A walk over a grid of streets (M3500, city10000)."""
    rng = np.random.default_rng(seed)
    poses = streets(n, rng)
    return Structure(poses, [(k, k + 1) for k in range(n - 1)] + near(poses, 1.1, 10, share, rng), PLANE)


def corridors(n: int, seed: int = 0) -> Structure:
    """Long loops of a building, rarely closed (CSAIL)."""
    rng = np.random.default_rng(seed)
    poses = [gtsam.Pose2()]
    while len(poses) < n:
        leg = int(rng.integers(8, 20))
        for k in range(leg):
            poses.append(poses[-1].compose(gtsam.Pose2(1, 0, np.pi / 2 if k == leg - 1 else 0.0)))
    poses = poses[:n]
    return Structure(poses, [(k, k + 1) for k in range(n - 1)] + near(poses, 2.0, 20, 0.3, rng), PLANE)


def laser(n: int, seed: int = 0) -> Structure:
    """As `corridors`, closed often (Intel)."""
    s = corridors(n, seed + 7)
    return Structure(s.poses, s.pairs[: n - 1] + near(s.poses, 2.2, 20, 0.5, np.random.default_rng(seed)), PLANE)


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
    ring = int(np.sqrt(n))
    return Structure(rings(n), [(k, k + 1) for k in range(n - 1)] + [(k, k + ring) for k in range(n - ring)], SPACE)


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
    return Structure(poses, [(k, k + 1) for k in range(n - 1)] + near(poses, 2.5, 20, 0.5, rng), SPACE)


STRUCTURES: dict[str, Callable[[int, int], Structure]] = {
    "Manhattan": manhattan, "CSAIL-like": corridors, "Intel-like": laser, "garage": garage, "sphere": sphere,
    "landmarks": landmarks,
}  # fmt: skip


def structure(name: str, poses: int, k: int) -> Structure:
    made = (STRUCTURES[name](poses, seed) for seed in count(k, 1000))
    return next(s for s in made if s.seen or len(s.loops) >= LEAST)


class Spoilt(NamedTuple):
    graph: gtsam.NonlinearFactorGraph
    path: gtsam.Values
    false: list[int]


OPTIMUM, GUESS = "optimum", "initial guess"


class Case(NamedTuple):
    """A kind of error, the number of false factors, how far off in sigmas of each component, and values examined."""

    kind: str
    count: int
    strength: float
    at: str = OPTIMUM


LOOPS, AGREE, STEPS, ANCHOR = "loops", "loops that agree", "steps of odometry", "loop at the anchor"
SWAPPED, NOISE = "landmarks swapped", "noise of odometry"
NONE = Case(NOISE, 0, 1.0)
CASES = (
    *(Case(LOOPS, 1, far) for far in (5.0, 10.0, 20.0, 1e3, 1e6, ELSEWHERE)), Case(LOOPS, 1, 20.0, GUESS),
    Case(LOOPS, 1, ELSEWHERE, GUESS), Case(LOOPS, 10, 20.0), Case(LOOPS, 10, ELSEWHERE), Case(AGREE, 3, 10.0),
    Case(AGREE, 3, ELSEWHERE), Case(STEPS, 1, 20.0), Case(ANCHOR, 1, ELSEWHERE), Case(SWAPPED, 1, ELSEWHERE),
    Case(SWAPPED, 10, ELSEWHERE), Case(NOISE, 0, 1.3),
)  # fmt: skip


def spoilt(s: Structure, case: Case, rng: np.random.Generator) -> Spoilt:
    graph = s.graph(rng, case.strength if case.kind == NOISE else 1.0)
    path, false, n = s.path(graph), [], len(s.poses)
    place = np.array([p.translation() for p in s.poses])

    def off(sigma: np.ndarray) -> np.ndarray:
        return case.strength * sigma * rng.choice([-1.0, 1.0], len(sigma)) + rng.normal(0, sigma)

    def add(a: int, b: int, z: object) -> None:
        false.append(graph.size())
        graph.add(s.relation(a, b, z, rng.normal(0, s.sigma)))

    def apart(least: int = 20) -> tuple[int, int]:
        a, b = np.sort(rng.choice(n - case.count, 2, replace=False))
        far = np.linalg.norm(place[a] - place[b]) > 0.25 * np.ptp(place, axis=0).max()
        return (int(a), int(b)) if b - a > least and far else apart(least)

    if case.kind == LOOPS and s.seen:
        false = [len(s.pairs) + i for i in sorted(rng.choice(len(s.seen), case.count, replace=False).tolist())]
        for i in false:
            graph.replace(i, s.observation(*s.seen[i - len(s.pairs)], off(SEEN)))
        path = s.path(graph)
    elif case.kind in (LOOPS, STEPS) and case.strength < ELSEWHERE:
        some = s.loops if case.kind == LOOPS else range(n - 1)
        false = sorted(rng.choice(some, case.count, replace=False).tolist())
        for i in false:
            a, b = s.pairs[i]
            graph.replace(i, s.relation(a, b, s.poses[a].between(s.poses[b]), off(s.sigma)))
        path = s.path(graph)
    elif case.kind == LOOPS:
        for _ in range(case.count):
            add(*apart(), type(s.poses[0])())
    elif case.kind == AGREE:  # all say that place b is elsewhere
        a, b = apart()
        there = s.poses[a] if case.strength == ELSEWHERE else s.poses[b].retract(off(s.sigma))
        moved = there.compose(s.poses[b].inverse())
        for k in range(case.count):
            add(a + k, b + k, s.poses[a + k].inverse().compose(moved).compose(s.poses[b + k]))
    elif case.kind == ANCHOR:
        add(1, max(apart()), type(s.poses[0])())
        prior = gtsam.PriorFactorPose2 if len(s.sigma) == 3 else gtsam.PriorFactorPose3
        graph.add(prior(0, s.poses[0], N.Isotropic.Sigma(len(s.sigma), 1e-3)))
    elif case.kind == SWAPPED:  # the place of another landmark in view, under this one's key
        at = {landmark: xy for _, landmark, xy in s.seen}
        for m in sorted(rng.choice(len(s.seen), case.count, replace=False).tolist()):
            pose, landmark, xy = s.seen[m]
            other = min([j for j in at if j != landmark], key=lambda j: float(np.linalg.norm(at[j] - xy)))
            false.append(len(s.pairs) + m)
            graph.replace(false[-1], s.observation(pose, landmark, at[other], rng.normal(0, SEEN)))
    return Spoilt(graph, path, false)


class Chance(NamedTuple):
    """Of the false factor that is hardest to name, beside all sound ones, with its error and no noise."""

    noncentrality: float  # of its test, on `rank` degrees of freedom
    rank: int
    apart: float  # by how much it is above that of any other factor's test

    def named(self, tests: int) -> float:
        """Probability that it is rejected and is the worst: of two tests, the difference has variance 4 `apart`."""
        gate = chi2.isf(PARTS[0] * FAMILY / tests, max(self.rank, 1))
        seen = ncx2.sf(gate, max(self.rank, 1), self.noncentrality) if np.isfinite(self.noncentrality) else 0.0
        return float(seen * norm.cdf(0.5 * np.sqrt(max(self.apart, 0.0))) * (self.apart > 0.0))


def chance(drawn: Spoilt, s: Structure) -> Chance:
    """How well the false factors can be told, around the truth."""
    values, out = gtsam.Values(drawn.path), list[Chance]()
    for k, pose in enumerate(s.poses):
        values.update(k, pose)
    for _, landmark, xy in s.seen:
        values.update(gtsam.symbol("l", landmark), xy)
    system = linearize(drawn.graph, values)
    order = ordering(system)
    for i in drawn.false:
        errors = [replace(g, r=np.where((g.factor == i)[:, None], g.r, 0.0)) for g in system.groups]
        others = np.setdiff1d(drawn.false, [i])
        f = without(replace(system, groups=errors), others, order)
        T, rank = tests(f, directions(f))
        out.append(Chance(float(T[i]), int(rank[i]), float(T[i] - np.delete(T, [i, *others]).max())))
    return min(out, key=lambda c: c.named(len(system.keys)))


def applies(name: str, case: Case) -> bool:
    if name == "landmarks":
        return case.kind in (STEPS, NOISE, SWAPPED) or (case.kind == LOOPS and case.strength < ELSEWHERE)
    return case.kind != SWAPPED


class Row(NamedTuple):
    """One graph: its error, what could be known, and what was found. `ideal`: see `Chance.named`."""

    error: str
    number: int
    strength: float
    values: str
    structure: str
    graph: int
    factors: int
    noncentrality: float
    apart: float
    ideal: float
    rejected: bool
    first: bool
    exact: bool
    sound_named: bool
    s: float


def row_of(name: str, k: int, case: Case, poses: int) -> Row:
    s, begin = structure(name, poses, k), time.process_time()
    drawn = spoilt(s, case, np.random.default_rng([k, 1 + (case != NONE)]))
    could = chance(drawn, s) if drawn.false else Chance(np.nan, 0, np.nan)
    report = audit(drawn.graph, drawn.path if case.at == GUESS else optimized(drawn.graph, drawn.path))
    false, wrong = set(drawn.false), set(report.audit.wrong.tolist())
    first = bool(wrong) and report.ranked.index[0] in false
    if case.kind == NOISE:
        first = report.kinds["p_family"]["odometry"] < FAMILY and report.kinds["component"].idxmax() == "odometry"
    return Row(
        case.kind if case != NONE else "none", case.count, case.strength, case.at, name, k, drawn.graph.size(),
        could.noncentrality, could.apart, could.named(drawn.graph.size()) if false else np.nan, report.rejected,
        bool(first), wrong == false, bool(wrong - false), time.process_time() - begin,
    )  # fmt: skip


def table(out: Path, graphs: int, poses: int, sound: int, names: Collection[str] = tuple(STRUCTURES)) -> pd.DataFrame:
    """Each kind of error in each structure; graphs to OUT/audit-graphs.csv, where none is drawn again, shares of them
    to OUT/audit-table.csv. `sound` graphs have no error, and are as many times the size.
    """
    file = out / "audit-graphs.csv"
    out.mkdir(parents=True, exist_ok=True)
    done = {row[:6] for row in read(Row, file)}
    for k in range(max(graphs, sound)):
        for name in names:
            for case in (NONE, *CASES):
                key = case.kind if case != NONE else "none", case.count, case.strength, case.at, name, k
                wanted = k < (sound if case == NONE else graphs) and applies(name, case)
                if wanted and key not in done:
                    append(row_of(name, k, case, poses), file)
    return summary(pd.DataFrame(read(Row, file)), out / "audit-table.csv")


def summary(rows: pd.DataFrame, path: Path) -> pd.DataFrame:
    """Shares of the graphs of a kind in %: of all, and of those where the ideal probability is above `DECIDABLE`."""
    made = list[dict]()
    for key, some in rows.groupby(["error", "number", "strength", "values", "structure"], sort=False):
        clear = some[some["ideal"] > DECIDABLE]
        made.append(dict(zip(("error", "number", "strength", "values", "structure"), key, strict=True)) | {
            "graphs": len(some), "factors": some["factors"].median(), "rejected_%": 100.0 * some["rejected"].mean(),
            "first_%": 100.0 * some["first"].mean(), "ideal_%": 100.0 * some["ideal"].mean(), "decidable": len(clear),
            "first_of_decidable_%": 100.0 * clear["first"].mean(),
            "exact_of_decidable_%": 100.0 * clear["exact"].mean(),
            "sound_named_%": 100.0 * some["sound_named"].mean(), "s": some["s"].mean(),
        })  # fmt: skip
    shares = pd.DataFrame(made)
    shares.to_csv(path, index=False, float_format="%.3g")
    return shares
