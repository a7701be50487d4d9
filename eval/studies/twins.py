"""Twins of a log: what it would have been, drawn again as it says of itself (a parametric bootstrap).

The batch smoother's path and map stand for the truth; prior, increments and readings are drawn with the covariances as
stated, at the same frames, of the same landmarks; what the smoother did not use is copied as it was read. A twin has a
truth, and every statistic of the log its own reference distribution, linearization, geometry and gates included.

What twins cannot see is an error that the smoother took into what now counts as truth, as a scale that distances and
readings share.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from data import se2
from data.errors import UsageError
from data.inputs import CLUTTER, Increments, Inputs, IntArray, LandmarkMap, Observations, Prior
from data.log import Log
from data.motion.corrected_inputs import corrected_inputs
from data.result import Run
from data.se2 import Array
from data.sensors import RELATIVE_POINT
from data.truth import Truth
from eval.referee import residuals
from eval.replay.foreign.load import digests
from eval.replay.settings import Setup

STREAM = 0x7A17
"""Sets the twins' random numbers apart from those of simulated logs of the same seed."""
SHORTEST = 10
"""Frames: below, a lag-1 correlation or a slope has nothing to stand on."""


@dataclass(frozen=True, eq=False)
class Source:
    """What twins are drawn from and how they are estimated.

    Attributes:
        log: the real one, less the systematic errors that the smoother estimated along: twins have none, and estimate
            them all the same, as well known as before. Of its truth nothing is used.
        task, association, estimators, setup: as the real log is run; `batch` is always among the estimators.
        path: (N, 3) of the batch smoother. landmarks: of its map (localization: the given one).
        landmark_of: (M,) id of the landmark each reading was paired with, `CLUTTER` where none.
    """

    log: Log
    task: str
    association: str
    estimators: tuple[str, ...]
    setup: Setup
    path: Array
    landmarks: LandmarkMap
    landmark_of: IntArray

    def inputs(self) -> Inputs:
        """The real log as the estimators see it."""
        return inputs_of(self.log, self.task, self.association)


def inputs_of(log: Log, task: str, association: str) -> Inputs:
    """A log as the estimators of a task see it."""
    inputs = log.inputs(labels=association == "known")
    return inputs.without_map() if task == "slam" else inputs


def source_of(
    log: Log, smoother: Run, estimators: Sequence[str], setup: Setup, association: str | None = None
) -> Source:
    """What twins of a log are drawn from; raises UsageError with a sentence where there can be none.

    `association`: that of `smoother` as it can be run again, where its name is not enough.
    """
    inputs = inputs_of(log, smoother.task, "known" if smoother.association == "known" else "")
    if len(inputs) < SHORTEST:
        raise UsageError(f"no twins of {log.name}: it has {len(inputs)} frames, at least {SHORTEST} are needed")
    if smoother.flaw is not None or smoother.final is None:
        why = smoother.flaw.why if smoother.flaw is not None else "it has no path"
        what = "failed" if smoother.doubt is None else f"is {smoother.status}"
        raise UsageError(f"no twins of {log.name}: batch, which they would be drawn from, {what} ({why})")
    used = residuals.used_by(smoother, inputs)
    if smoother.errors_final is not None:
        less = corrected_inputs(log.recorded, smoother.errors_final)
        log = replace(log, recorded=replace(less, systematic=log.recorded.systematic))
    if not (used.number >= 0).any():
        raise UsageError(f"no twins of {log.name}: batch used no reading, so nothing is known beside the odometry")
    landmarks = LandmarkMap(used.identity, used.landmarks)
    landmark_of = np.where(used.number >= 0, used.identity[np.maximum(used.number, 0)], CLUTTER)
    wanted = tuple(dict.fromkeys([*estimators, "batch"]))
    again = association or smoother.association
    return Source(log, smoother.task, again, wanted, setup, smoother.final.pose, landmarks, landmark_of)


def twin(source: Source, seed: int) -> Log:
    """A twin: same frames, same landmarks seen, everything else drawn anew. Same seed, same bytes."""
    r = source.log.recorded
    streams = np.random.SeedSequence([seed, STREAM]).spawn(3)
    prior_rng, odometry_rng, sensor_rng = (np.random.default_rng(s) for s in streams)
    path = source.path
    mean = path[0] + _root(r.prior.covariance[None])[0] @ prior_rng.standard_normal(3)
    mean[2] = se2.wrap_angle(mean[2])
    motion = np.zeros_like(path)
    noise = odometry_rng.standard_normal(path.shape)
    motion[1:] = se2.between(path[:-1], path[1:])
    motion[1:] += np.einsum("nij,nj->ni", _root(r.increments.covariance[1:]), noise[1:])
    motion[:, 2] = se2.wrap_angle(motion[:, 2])
    o = r.observations
    z = o.z.copy()
    noise = sensor_rng.standard_normal(z.shape)
    seen = np.flatnonzero(source.landmark_of >= 0)
    if len(seen):
        exact = r.sensor.predict(path[o.frame[seen]], source.landmarks.positions(source.landmark_of[seen]))
        z[seen] = exact + np.einsum("mij,mj->mi", _root(o.R[seen]), noise[seen])
        if r.sensor.kind != RELATIVE_POINT:
            z[seen, 0] = np.abs(z[seen, 0])  # a range is not negative
            z[seen, 1] = se2.wrap_angle(z[seen, 1])
    recorded = replace(
        r, prior=Prior(mean, r.prior.covariance), increments=Increments(motion, r.increments.covariance),
        observations=Observations(o.frame, z, o.R), map=r.map if source.task == "localization" else None,
    )  # fmt: skip
    name = f"{source.log.name}:twin={seed}"
    told = {"kind": "twin", "twin_of": source.log.name, "seed": seed, "task": source.task}
    note = f"Drawn from batch's path and map of {source.log.name}, with the covariances as stated; batch is its truth."
    truth = Truth(path, source.landmarks, source.landmark_of)
    # none is misread, but they are to be treated as those of the log are
    sensed = source.log.labels_are_sensed
    return Log(name, recorded, truth, labels_are_sensed=sensed, source=told, notes=(note,))


def _root(covariance: Array) -> Array:
    """A root (n, d, d) of covariances that may be singular."""
    size, axes = np.linalg.eigh(covariance)
    root: Array = axes * np.sqrt(np.maximum(size, 0.0))[:, None, :]
    return root


def digest_of(source: Source) -> str:
    """Digest of everything about a source that its twins depend on."""
    r = source.log.recorded
    digest = hashlib.sha256(
        repr((source.log.name, source.task, source.association, source.estimators, source.setup, r.sensor)).encode()
    )
    digest.update(repr(digests((*source.estimators, source.association))).encode())
    for array in (
        r.prior.covariance, r.time, r.increments.covariance, r.observations.frame, r.observations.z, r.observations.R,
        source.path, source.landmarks.id, source.landmarks.xy, source.landmark_of,
    ):  # fmt: skip
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
