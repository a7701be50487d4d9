"""Key poses of a laser log as an open log, with its truth: reference relations, true poses, and true inliers."""

from dataclasses import replace

import numpy as np

from data.inputs import IntArray
from data.log import Log
from data.origin import Origin
from data.se2 import compose, covariances_in_world, inverse
from data.terminal import counted
from data.truth import Relations, Truth
from eval.referee.consistency import true_inliers
from wings.laser.scans.constraints import Chain
from wings.laser.slam.front_end import is_unknown
from wings.laser.slam.key_log import ODOMETRY, SCAN_MATCH, KeyLog


def log_of_keys(name: str, log: Log, made: KeyLog, motion: str) -> Log:
    """The log of key poses under a name, with the truth that the laser log has."""
    inputs, truth = made.inputs, log.truth
    pose = None if truth.pose is None else truth.pose[made.frame]
    relations = None if truth.relations is None else relations_of(truth.relations, made)
    inlier = None if inputs.closures is None or pose is None else true_inliers(inputs.closures, pose)
    keys, of = counted(len(made.chain.frame), "key pose"), counted(len(log.recorded), "frame")
    more = len(made.frame) - len(made.chain.frame)
    beside = f", and {more} more that relations name" if more else ""
    learned = made.error is not None
    scale = f"{made.claimed:.3g} times what scan matching states, " + (
        f"learned from the log's own loops (+- {made.error:.1g}): their NIS is no test of it" if learned
        else "as too few loops tell it"
    )  # fmt: skip
    prior = "by scans alone" if is_unknown(log.recorded.increments) else "with the wheels as its prior"
    moved = f"scan matching, {prior}" if motion == SCAN_MATCH else "that of the wheels"
    notes = [
        f"{keys} of {of}{beside}; the motion is {moved}.", f"Variances of scan matches and loops are {scale}.",
        "A closure is there at its later frame, some key poses before the front end believed it.",
    ]  # fmt: skip
    if motion == ODOMETRY:
        notes.append("Where wheels slip, filters' gate refuses right matches; --gate-poses none switches it off.")
    label = made.label if len(made.label) else None
    if label is not None:
        notes.append("Labels of corners are by the front end's final path; --association jcbb decides without them.")
    if relations is not None and truth.relations is not None and len(relations) < len(truth.relations):
        notes.append(f"{len(relations)} of {len(truth.relations)} relations join two key poses, and are carried there.")
    source = {**log.source, "laser": log.name, "motion": motion, "variance_scale": made.claimed}
    return Log(
        name, inputs, Truth(pose, relations=relations, closure_inlier=inlier), label=label,
        labels_are_sensed=label is not None, source=source, notes=(*log.notes, *notes),
        origins={**log.origins, "closure_noise": Origin.INFERRED if learned else Origin.ASSUMED},
    )  # fmt: skip


def frames_of_relations(log: Log) -> IntArray | None:
    """The frames that reference relations name, ascending; None without relations."""
    r = log.truth.relations
    return None if r is None else np.union1d(r.row1, r.row2)


def relations_of(relations: Relations, made: KeyLog) -> Relations:
    """The relations between frames of the log, as they are where it has both; else all of them between key poses."""
    rows = [np.searchsorted(made.frame, r) for r in (relations.row1, relations.row2)]
    there = [(row < len(made.frame)) & (made.frame[np.minimum(row, len(made.frame) - 1)] == r)
             for row, r in zip(rows, (relations.row1, relations.row2), strict=True)]  # fmt: skip
    if (there[0] & there[1]).all():
        return replace(relations, row1=rows[0], row2=rows[1], stamp=None, frame_stamp=None)
    return relations_at_keys(relations, made.chain)


def relations_at_keys(relations: Relations, chain: Chain) -> Relations:
    """Relations between frames as relations between their key poses, by the scan match that places each frame, with its
    error, as in the path of a laser run; without those within one key pose, and without stamps.
    """
    key1, key2 = chain.key[relations.row1], chain.key[relations.row2]
    there = np.flatnonzero(key1 != key2)
    before, after = chain.since[relations.row1[there]], inverse(chain.since[relations.row2[there]])
    to = compose(before, relations.relative[there])
    relative, covariance = compose(to, after), None
    if relations.covariance is not None:
        F = np.tile(np.eye(3), (len(there), 1, 1))
        F[:, 0, 2], F[:, 1, 2] = to[:, 1] - relative[:, 1], relative[:, 0] - to[:, 0]
        covariance = F @ covariances_in_world(before[:, 2], relations.covariance[there]) @ F.transpose(0, 2, 1)
    exact = None if relations.exact is None else relations.exact[there]
    return Relations(key1[there], key2[there], relative, exact, covariance=covariance)
