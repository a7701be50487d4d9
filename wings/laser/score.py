"""How good a laser run is: outcomes of its loop closures, and what speaks against it, from wheels to doubled walls.

Closures have outcomes where the true poses are known: TP right and believed, FP wrong and believed, FN right and not
believed, TN otherwise. A loop closure is right if its relative pose is near the truth, or inside its own covariance's
gate. One that was not believed is right only if its scans overlap.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import scipy

from data import se2
from data.formats.tables.files import QUANTITIES, Units
from data.formats.tables.motion import KINDS
from data.inputs import Inputs, IntArray, Scans
from data.log import ODOMETRY_KIND, Log
from data.notice import Code, Notice, Value, notice
from data.result import Run
from data.se2 import Array, BoolArray
from eval.referee.consistency import right_relatives
from eval.referee.relations import errors
from eval.referee.score import Trial
from wings.laser.scans.constraints import LaserRun, Loops, consistency
from wings.laser.scans.points import beams_of
from wings.laser.slam.front_end import is_unknown
from wings.laser.slam.incremental import TURNED_WAY

FIT = 0.1  # m, largest distance of matching scan points: three beams of 1 degree at 2 m
OVERLAP = 0.6  # share of each scan's points that must match at the true poses; scan matching needs 0.5


def mapped(trial: Trial) -> LaserRun | None:
    """The run whose final poses a map is drawn from: isam2's, or the first that has some; None: no laser log."""
    found = [r for r in trial.runs if isinstance(r, LaserRun) and r.failure is None and r.last is not None]
    return min(found, key=lambda r: r.estimator != "isam2", default=None)


def right_closures(loops: Loops, truth: Array) -> BoolArray:
    """Which loop closures (L,) are right, given true key poses (K, 3)."""
    return right_relatives(loops.relative, loops.covariance, truth[loops.key1], truth[loops.key2])


def wrong_closures(run: LaserRun, truth: Array | None) -> BoolArray | None:
    """Which loop closures (L,) of a run are wrong, given the true path (N, 3); None without."""
    if truth is None or run.loops is None or run.chain is None:
        return None
    return ~right_closures(run.loops, truth[run.chain.frame])


def knowable(loops: Loops, truth: Array, points: Sequence[Array]) -> BoolArray:
    """Which loop closures (L,) join key poses whose scans (P, 2) overlap at the true poses (K, 3)."""
    pairs = zip(loops.key1.tolist(), loops.key2.tolist(), strict=True)
    return np.array([fits(points[a], points[b], se2.between(truth[a], truth[b])) for a, b in pairs], np.bool_)


def scan_points_of(scans: Scans, frames: IntArray) -> list[Array]:
    """Points (P, 2) of each frame's scan in the body frame; empty without a scan."""
    beams = beams_of(scans.scanner, scans.ranges.shape[1])
    every = (scans.of(frame) for frame in frames.tolist())
    return [np.empty((0, 2)) if r is None else (beams.origin + r[:, None] * beams.direction)[r > 0.0] for r in every]


def fits(first: Array, second: Array, relative: Array) -> bool:
    """Whether two scans (P, 2), (Q, 2) overlap at the relative pose (3,) of the second in the first's frame."""
    if not len(first) or not len(second):
        return False
    moved = se2.transform_points(relative, second)
    ways = (first, moved), (moved, first)
    apart = (scipy.spatial.cKDTree(a).query(b, distance_upper_bound=FIT)[0] for a, b in ways)
    return all(float(np.mean(each <= FIT)) >= OVERLAP for each in apart)


def closure_counts(run: Run, log: Log, phase: str) -> dict[str, object] | None:
    """Columns of association.csv for loop closures; None where true key poses are unknown, and of other runs."""
    truth = log.truth.pose
    if truth is None or not isinstance(run, LaserRun) or run.loops is None or run.chain is None:
        return None
    keys, loops, scans = truth[run.chain.frame], run.loops, log.recorded.scans
    if not np.isfinite(keys[np.concatenate([loops.key1, loops.key2])]).all():
        return None
    right, believed = right_closures(loops, keys), run.kept(phase)
    if scans is not None:
        right &= (loops.believed >= 0) | knowable(loops, keys, scan_points_of(scans, run.chain.frame))
    outcomes = right & believed, ~right & believed, ~right & ~believed, right & ~believed
    tp, fp, tn, fn = (int(np.count_nonzero(which)) for which in outcomes)
    precision, recall = (tp / (tp + wrong) if tp + wrong else math.nan for wrong in (fp, fn))
    shares: dict[str, object] = {"precision": precision, "recall": recall}
    counted: dict[str, object] = {"tp": tp, "tn": tn, "fp": fp, "fn": fn, "wrong": fp, "missed": fn}
    return shares | counted | dict.fromkeys(("spurious", "duplicate", "deferred"), 0)


SIGMAS, FAR, TURNED = 10.0, 0.5, 0.5
"""Standard deviations of odometry, and m or rad, from which a step from scan to scan contradicts the wheels. Simulated
slips of 0.6 rad at rest, and robots that back while they report forward, are such steps; noise has none."""
JUMP = 3.0, 0.2, 0.35  # The same of changes of a motion that scans alone tell; they are more often wrong
RUNS, STRETCH = 2.0, 0.5
"""Times the way of the wheels, from which a path runs away from them: then stretches of so many m of a wheel contradict
them, too, as matches that follow a walking person by a little each. On Intel and simulated plans it is 1.00 to 1.05."""


def against_wheels(run: LaserRun, inputs: Inputs) -> Notice | None:
    """A notice where the chain from scan to scan contradicts odometry by many sigmas and far, at once or by and by; or
    without one the motion before, which then goes on.
    """
    unknown = is_unknown(inputs.increments)
    if inputs.scans is None or run.chain is None or not (unknown or inputs.increments.mean.any()):
        return None
    chain, at = run.chain, inputs.scans.frame
    path = se2.compose(se2.dead_reckoned(np.zeros(3), chain.motion)[chain.key], chain.since)
    wheels = se2.dead_reckoned(np.zeros(3), inputs.increments.mean)
    driven, gone = (np.hypot(*np.diff(p[at, :2], axis=0).T) for p in (wheels, path))
    begin = np.arange(len(at) - 1)
    end = begin + 1
    if gone.sum() > RUNS * driven.sum() > 0.0:
        way = np.concatenate([[0.0], np.cumsum(driven + TURNED_WAY * np.abs(se2.wrap_angle(np.diff(wheels[at, 2]))))])
        end = np.maximum(end, np.searchsorted(way, way[:-1] + STRETCH, side="right") - 1)
    a, b = at[begin], at[end]
    told, found = se2.between(wheels[a], wheels[b]), se2.between(path[a], path[b])
    if unknown:
        told[1:], told[0] = found[:-1], found[0]
    sigmas, far, turn = JUMP if unknown else (SIGMAS, FAR, TURNED)
    error = se2.pose_error(found, told)
    # the increments' covariances, added in the world's axes: a heading error between them is small beside FAR
    world = se2.covariances_in_world(wheels[:-1, 2], inputs.increments.covariance[1:])
    gathered = np.concatenate([np.zeros((1, 3, 3)), np.cumsum(world, axis=0)])
    variance = np.einsum("kii->ki", gathered[b] - gathered[a])
    position = np.hypot(error[:, 0], error[:, 1])
    deviation = np.sqrt(variance[:, 0] + variance[:, 1])
    lever = np.hypot(told[:, 0], told[:, 1]) * np.sqrt(variance[:, 2])
    moved = (position > far) & (position > sigmas * (deviation + lever))
    turned = (np.abs(error[:, 2]) > turn) & (np.abs(error[:, 2]) > sigmas * np.sqrt(variance[:, 2]))
    wrong = np.flatnonzero(moved | turned)
    if not len(wrong):
        return None
    worst = int(wrong[np.argmax(np.hypot(position[wrong] / FAR, error[wrong, 2] / TURNED))])
    return _of(
        run, Code.SCANS_JUMP if unknown else Code.AGAINST_WHEELS, frame=int(b[worst]), steps=len(wrong), scans=len(at),
        distance=float(position[worst]), turned=math.degrees(abs(float(error[worst, 2]))),
    )  # fmt: skip


LEAST, STEPS = 0.2, 10  # m or rad of a step between key poses that tells a factor, and how many of them do
FACTOR, ALIKE = 1.25, 1.1
"""By so much steps differ from the wheels' to be named, and half of those on one side by less from each other. Of
simulated wheels the factor is right to 2 %; by 1.1 the path is right, by 2 and above up to 10 m wrong."""


def scale_of_wheels(run: LaserRun, log: Log) -> Notice | None:
    """A notice where by scans the robot drives, or turns, by one factor more or less than by its odometry."""
    chain, increments = run.chain, log.recorded.increments
    if chain is None or is_unknown(increments):
        return None
    wheels = se2.dead_reckoned(np.zeros(3), increments.mean)[chain.frame]
    told, found = se2.between(wheels[:-1], wheels[1:]), chain.motion[1:]
    factors = np.full(2, np.nan)
    for k, (a, b) in enumerate(((np.hypot(*told[:, :2].T), np.hypot(*found[:, :2].T)), (told[:, 2], found[:, 2]))):
        some = (np.abs(b) > LEAST) & (a != 0.0)
        ratios = b[some] / a[some] if some.sum() >= STEPS else [np.nan]
        low, middle, high = np.quantile(ratios, (0.25, 0.5, 0.75))
        factors[k] = middle if min(middle / low, high / middle) < ALIKE else np.nan
    far = np.maximum(factors, 1.0 / factors) > FACTOR
    if not far.any():
        return None
    way, turn = np.where(far, factors, 1.0).tolist()
    flags = _rescaled(log.source, way, turn, way / float(factors[1]))
    return _of(run, Code.WHEELS_SCALE if far[0] else Code.WHEELS_TURN, way=way, turn=turn, flags=flags)


def _rescaled(source: Mapping[str, Any], way: float, turn: float, wide: float) -> tuple[str, ...]:
    """Flags of `slamref convert table` that state lengths and turns of an odometry times factors, and the distance of
    wheels times `wide`, if known; none of a bag.
    """
    if wheels := source.get("wheels"):
        metres = ",".join(f"{way * m:.4g}" for m in wheels["metres"])
        track = wheels["track_width"] * wide
        return (f"--metres-per-tick={metres}", *[f"--track-width={track:.4g}"] * (0.0 < track < math.inf))
    units, by = Units(dict(source.get("unit", {}))), {"length": (way, "m"), "angle": (turn, "rad")}
    each = []
    for q in KINDS.get(str(source.get(ODOMETRY_KIND)), ()):
        of, slash, second = QUANTITIES[q].partition("/")
        factor, unit = by[of]
        if factor != 1.0:
            own = f"{factor * units.factor('odometry', q):.4g}{unit}{slash}{'s' * bool(second)}"
            each.append(f"odometry.{q}={own}")
    return (f"--unit {','.join(each)}",) if each else ()


def _of(run: Run, code: Code, frame: int | None = None, **values: Value) -> Notice:
    return notice(code, frame, **values).about(estimator=run.estimator, association=run.association)


LONGEST = 30
"""Scans in a row whose way is not observed, from which on that is said: in simulated bare corridors, and halls beyond
the laser's reach, 80 and more, in a recorded corridor 76, in simulated buildings 30 at most, on Intel 6.
"""


def unobserved(run: LaserRun, inputs: Inputs) -> Notice | None:
    """A notice where for long no scan fixes the way along bare walls: odometry alone tells it, or nothing does."""
    if inputs.scans is None or run.loose is None:
        return None
    loose = run.loose[inputs.scans.frame]
    longest = int(np.diff(np.flatnonzero(np.diff(loose, prepend=False, append=False)).reshape(-1, 2)).max(initial=0))
    if longest <= LONGEST:
        return None
    code = Code.WAY_UNOBSERVED if is_unknown(inputs.increments) else Code.WAY_BY_ODOMETRY
    return _of(run, code, loose=int(loose.sum()), scans=len(loose), longest=longest)


REFUSED, TESTED = 0.9, 50
"""Share of refused loop closures that is worth a warning, and their least number. On Intel and simulated plans
0.33 to 0.57 are refused, as they do not fit well enough or find no second one; in halls of equal rows, with half of the
walls of glass and a reach of 5 m, up to 0.85 beside a right path, 0.99 beside a wrong one."""


def refused(run: LaserRun) -> Notice | None:
    """A notice where hardly any loop closure was believed."""
    if run.loops is None or len(run.loops) < TESTED:
        return None
    out = int((run.loops.believed < 0).sum())
    if out <= REFUSED * len(run.loops):
        return None
    return _of(run, Code.CLOSURES_REFUSED, refused=out, tested=len(run.loops))


def doubled_walls(run: LaserRun, inputs: Inputs) -> Notice | None:
    """A notice where scans of revisited places contradict each other more than neighbouring ones."""
    if inputs.scans is None or run.chain is None or run.key_pose is None:
        return None
    found = consistency(inputs.scans, run.chain.frame, run.key_pose)
    if found is None or not found.is_doubled:
        return None
    return _of(run, Code.DOUBLED_WALLS, revisits=found.revisits, neighbours=found.neighbours, pairs=found.pairs)


CLAIMED = 3.0
"""Mean squared error over the variance that a claim allows at most, from which it is too small. The sum of both ends'
variances is the largest that the relation between them can have, unless their errors oppose each other."""


def beyond_claims(run: Run, trial: Trial) -> Notice | None:
    """A notice where errors against reference relations exceed the claimed standard deviations."""
    relations, path = trial.log.truth.relations, run.final
    if relations is None or path is None or run.failure is not None or len(relations) < 10:
        return None
    a, b = relations.row1, relations.row2
    error = errors(path.pose[a], path.pose[b], relations.relative)
    P = np.einsum("kii->ki", path.covariance[a]) + np.einsum("kii->ki", path.covariance[b])
    fine = np.isfinite(error).all(axis=1) & (P > 0.0).all(axis=1)
    if fine.sum() < 10:
        return None
    turned, claimed = np.abs(error[fine, 2]), np.sqrt(P[fine, 2])
    moved, allowed = np.hypot(error[fine, 0], error[fine, 1]), np.sqrt(P[fine, 0] + P[fine, 1])
    ratio = max(float(np.mean((turned / claimed) ** 2)), float(np.mean((moved / allowed) ** 2)))
    if ratio <= CLAIMED:
        return None
    return _of(
        run, Code.BEYOND_CLAIMS, ratio=ratio, relations=int(fine.sum()),
        turned=math.degrees(float(np.sqrt(np.mean(turned**2)))), claimed=math.degrees(float(np.median(claimed))),
        moved=float(np.sqrt(np.mean(moved**2))), allowed=float(np.median(allowed)),
    )  # fmt: skip


def faults(trial: Trial, _: Sequence[Trial] = ()) -> list[Notice]:
    """What speaks against the runs of a laser log."""
    found: list[Notice | None] = []
    inputs = trial.log.recorded
    if (run := mapped(trial)) is not None:
        found += [against_wheels(run, inputs), scale_of_wheels(run, trial.log)]
        found += [doubled_walls(run, inputs), unobserved(run, inputs), refused(run)]
    found += [beyond_claims(r, trial) for r in trial.runs if isinstance(r, LaserRun) and r.chain is not None]
    return [n for n in found if n is not None]
