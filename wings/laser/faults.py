"""What speaks against the result of a laser log: wheels, refused closures, doubled walls, and reference relations."""

import math
from collections.abc import Sequence

import numpy as np

from data.inputs import Inputs
from data.notice import Code, Notice, Value, notice
from data.result import Run
from data.se2 import between, compose, covariances_in_world, dead_reckoned, pose_error
from eval.referee.relations import errors
from eval.referee.score import Trial
from wings.laser.scans.constraints import LaserRun, consistency
from wings.laser.score import mapped

SIGMAS, FAR, TURNED = 10.0, 0.5, 0.5
"""Standard deviations of odometry, and m or rad, from which a step from scan to scan contradicts the wheels. Simulated
slips of 0.6 rad at rest, and robots that back while they report forward, are such steps; noise has none."""


def against_wheels(run: LaserRun, inputs: Inputs) -> Notice | None:
    """A notice where steps of the chain from scan to scan contradict odometry by many sigmas and far."""
    if inputs.scans is None or run.chain is None or not inputs.increments.mean.any():
        return None
    chain, at = run.chain, inputs.scans.frame
    path = compose(dead_reckoned(np.zeros(3), chain.motion)[chain.key], chain.since)
    wheels = dead_reckoned(np.zeros(3), inputs.increments.mean)
    told, found = between(wheels[at[:-1]], wheels[at[1:]]), between(path[at[:-1]], path[at[1:]])
    error = pose_error(found, told)
    # the increments' covariances, added in the world's axes: a heading error between them is small beside FAR
    world = covariances_in_world(wheels[:-1, 2], inputs.increments.covariance[1:])
    gathered = np.concatenate([np.zeros((1, 3, 3)), np.cumsum(world, axis=0)])
    variance = np.einsum("kii->ki", gathered[at[1:]] - gathered[at[:-1]])
    position = np.hypot(error[:, 0], error[:, 1])
    deviation = np.sqrt(variance[:, 0] + variance[:, 1])
    lever = np.hypot(told[:, 0], told[:, 1]) * np.sqrt(variance[:, 2])
    moved = (position > FAR) & (position > SIGMAS * (deviation + lever))
    turned = (np.abs(error[:, 2]) > TURNED) & (np.abs(error[:, 2]) > SIGMAS * np.sqrt(variance[:, 2]))
    wrong = np.flatnonzero(moved | turned)
    if not len(wrong):
        return None
    size = np.hypot(position[wrong] / FAR, error[wrong, 2] / TURNED)
    worst = int(wrong[np.argmax(size)])
    return _of(
        run, Code.AGAINST_WHEELS, frame=int(at[worst + 1]), steps=len(wrong), scans=len(at),
        distance=float(position[worst]), turned=math.degrees(abs(float(error[worst, 2]))),
    )  # fmt: skip


def _of(run: Run, code: Code, frame: int | None = None, **values: Value) -> Notice:
    return notice(code, frame, **values).about(estimator=run.estimator, association=run.association)


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
        found += [against_wheels(run, inputs), doubled_walls(run, inputs), refused(run)]
    found += [beyond_claims(r, trial) for r in trial.runs if isinstance(r, LaserRun) and r.chain is not None]
    return [n for n in found if n is not None]
