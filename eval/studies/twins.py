"""Twins of a log: parametric bootstrap replicates, drawn from its own noise model.

Path and map of the batch smoother are the truth. Prior, increments and observations are drawn with the stated
covariances, at the same frames, of the same landmarks; unused observations that fit none are copied. The places in an
uncertain map are drawn with its sigmas. All fixes and closures are drawn, so no twin has outliers among them. So every
statistic of the log has a reference distribution that includes linearization, geometry and gates.

Twins do not show an error that the smoother absorbed into this truth, such as a scale common to distances and
observations. Statistics of log and twins that need no truth, of twins also errors, are kept on disk.
"""

import gc
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from association.appearance import Looks
from data import se2
from data.appearance import Appearance, drawn
from data.errors import UsageError
from data.inputs import CLUTTER, Increments, Inputs, IntArray, LandmarkMap, Observations, Prior
from data.log import Log
from data.motion.systematic import corrected_inputs
from data.pose_measurements import MEASURED, Closures, Fixes, FixKind, expected_fix
from data.result import Run
from data.se2 import Array
from data.sensors import RELATIVE_POINT
from data.truth import Truth
from data.whole import whole_file
from eval.compare import compare
from eval.referee import consistency, errors, residuals, truth_free
from eval.referee.plausibility import with_plausibility
from eval.referee.score import confusion_of
from eval.referee.truth_free import Key, Statistic
from eval.replay.batch import batch
from eval.replay.external.adapter import digests
from eval.replay.settings import FILTERS, Setup, steps

STREAM = 0x7A17  # separates the twins' random numbers from those of simulated logs of the same seed
SHORTEST = 10  # frames; least number for a lag-1 correlation or a slope


@dataclass(frozen=True, eq=False)
class Source:
    """Source of twins, and how they are estimated."""

    # the real one, without the systematic errors that the smoother estimated; twins have none and estimate them with
    # the same prior. Its truth is not used
    log: Log
    task: str  # task, association, estimators, setup: as for the real log; `batch` is always among the estimators
    association: str
    estimators: tuple[str, ...]
    setup: Setup
    path: Array  # (N, 3) of the batch smoother. landmarks: of its map (localization: the given one)
    landmarks: LandmarkMap
    landmark_of: IntArray  # (M,) id of the landmark of each observation, `CLUTTER` for none


def inputs_of(log: Log, task: str, association: str) -> Inputs:
    """A log as the estimators of a task see it."""
    inputs = log.inputs(labels=association == "known")
    return inputs.without_map() if task == "slam" else inputs


def source_of(
    log: Log, smoother: Run, estimators: Sequence[str], setup: Setup, association: str | None = None
) -> Source:
    """The source of a log's twins. Raises UsageError where there can be none. `association`: that of `smoother` as it
    can be run again, if its name is not enough.
    """
    inputs = inputs_of(log, smoother.task, "known" if smoother.association == "known" else "")
    if len(inputs) < SHORTEST:
        raise UsageError(f"no twins of {log.name}: it has {len(inputs)} frames, at least {SHORTEST} are needed")
    if smoother.flaw is not None or smoother.final is None:
        why = smoother.flaw.why if smoother.flaw is not None else "it has no path"
        what = "failed" if smoother.implausible is None else f"is {smoother.status}"
        raise UsageError(f"no twins of {log.name}: batch, which they would be drawn from, {what} ({why})")
    used = residuals.used_by(smoother, inputs)
    if smoother.errors_final is not None:
        less = corrected_inputs(log.recorded, smoother.errors_final)
        log = replace(log, recorded=replace(less, systematic=log.recorded.systematic))
    if not any(mask is not None and mask.any() for mask in (used.number >= 0, used.fixes, used.closures)):
        raise UsageError(f"no twins of {log.name}: batch used no observation, so nothing is known beside the odometry")
    landmarks = LandmarkMap(used.identity, used.landmarks)
    row = np.where(used.number >= 0, used.number, _gated(inputs, smoother.final.pose, used))
    landmark_of = np.where(row >= 0, used.identity[np.maximum(row, 0)], CLUTTER)
    wanted = tuple(dict.fromkeys([*estimators, "batch"]))
    again = association or smoother.association
    return Source(log, smoother.task, again, wanted, setup, smoother.final.pose, landmarks, landmark_of)


def _gated(inputs: Inputs, path: Array, used: residuals.Used) -> IntArray:
    """Row of the landmark (M,) that an unused observation fits, -1: none; as clutter it would count as wrong."""
    o = inputs.observations
    row = np.full(len(o.frame), -1)
    for i in np.flatnonzero(used.number < 0):
        same = o.frame == o.frame[i]
        squared = residuals.from_all(inputs, path, used.landmarks, int(i))
        squared[used.number[same & (used.number >= 0)]] = np.inf
        squared[row[same & (row >= 0)]] = np.inf
        best = int(np.argmin(squared))
        if squared[best] < residuals.OUTLYING:
            row[i] = best
    return row


def twin(source: Source, seed: int) -> Log:
    """A twin: same frames, same landmarks seen, everything else drawn. Same seed, same bytes."""
    r = source.log.recorded
    rngs = (np.random.default_rng(s) for s in np.random.SeedSequence([seed, STREAM]).spawn(6))
    prior_rng, odometry_rng, sensor_rng, pose_rng, looks_rng, map_rng = rngs
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
        z = np.where(r.measured(), z, o.z)
    known = r.map if source.task == "localization" else None
    if known is not None and known.sigma is not None:
        drawn = source.landmarks.positions(known.id) + known.sigma * map_rng.standard_normal(known.xy.shape)
        known = replace(known, xy=drawn)
    recorded = replace(
        r, map=known, prior=Prior(mean, r.prior.covariance), increments=Increments(motion, r.increments.covariance),
        observations=Observations(o.frame, z, o.R, appearance=_drawn_looks(source, looks_rng)),
        fixes=None if r.fixes is None else _drawn_fixes(r.fixes, path, pose_rng),
        closures=None if r.closures is None else _drawn_closures(r.closures, path, pose_rng),
    )  # fmt: skip
    name = f"{source.log.name}:twin={seed}"
    origin = {"kind": "twin", "twin_of": source.log.name, "seed": seed, "task": source.task}
    note = f"Drawn from batch's path and map of {source.log.name}, with the covariances as stated; batch is its truth."
    inlier = [None if each is None else np.ones(len(each), np.int64) for each in (r.fixes, r.closures)]
    truth = Truth(path, source.landmarks, source.landmark_of, fix_inlier=inlier[0], closure_inlier=inlier[1])
    sensed = source.log.labels_are_sensed  # none is misread, but they are treated as those of the log
    return Log(name, recorded, truth, labels_are_sensed=sensed, source=origin, notes=(note,))


def _drawn_looks(source: Source, rng: np.random.Generator) -> Appearance | None:
    """Readings of each landmark's appearance: that of the map, else the mean of the log's own readings."""
    r, places = source.log.recorded, source.landmarks
    seen = r.observations.appearance
    if seen is None:
        return None
    looks = Looks.of_map(r.map if source.task == "localization" else None)
    looks.see(source.landmark_of, seen)
    mean = looks.typical(places.id)
    return seen if mean is None else drawn(seen, mean, places.rows(source.landmark_of), rng)


def _drawn_fixes(fixes: Fixes, path: Array, rng: np.random.Generator) -> Fixes:
    """All fixes about a path (N, 3), with their covariances: none is an outlier."""
    z = fixes.z.copy()
    noise = np.einsum("fij,fj->fi", _root(fixes.covariance), rng.standard_normal(z.shape))
    for i, (frame, kind) in enumerate(zip(fixes.frame.tolist(), fixes.kind.tolist(), strict=True)):
        entries = list(MEASURED[FixKind(kind)])
        z_hat, _ = expected_fix(path[frame], kind, fixes.sources[int(fixes.source[i])])
        z[i, entries] = z_hat + noise[i, entries]
    z[:, 2] = se2.wrap_angle(z[:, 2])
    return replace(fixes, z=z)


def _drawn_closures(closures: Closures, path: Array, rng: np.random.Generator) -> Closures:
    """All closures between poses of a path (N, 3), with their covariances: none is an outlier."""
    relative = np.einsum("kij,kj->ki", _root(closures.covariance), rng.standard_normal(closures.relative.shape))
    relative += se2.between(path[closures.frame1], path[closures.frame2])
    relative[:, 2] = se2.wrap_angle(relative[:, 2])
    return replace(closures, relative=relative)


def _root(covariance: Array) -> Array:
    size, axes = np.linalg.eigh(covariance)
    return np.asarray(axes * np.sqrt(np.maximum(size, 0.0))[:, None, :])


def digest_of(source: Source) -> str:
    """Digest of everything that the twins of a source depend on."""
    from joblib import hash as digest

    asked = (source.task, source.association, source.estimators, source.setup)
    foreign = digests((*source.estimators, source.association, source.setup.maintain_by))
    drawn_from = (source.log.name, source.log.recorded, source.path, source.landmarks, source.landmark_of)
    return str(digest((asked, foreign, drawn_from), "sha1"))


PLAIN, STAND_IN = "batch", "batch-cauchy"  # the smoother for comparison, and its replacement if it is implausible


@dataclass(frozen=True)
class Sample:
    """Truth-free consistency statistics of one log, and of a twin the errors of its estimators."""

    measured: Mapping[Key, Statistic]  # the statistics; none of a failed estimator
    failures: Mapping[str, str] = field(default_factory=dict)  # reasons, by estimator
    # RMS [m] between an online path and the batch smoother's, by estimator
    apart: Mapping[str, float] = field(default_factory=dict)
    nees: Mapping[tuple[str, str], float] = field(default_factory=dict)  # mean pose NEES by estimator and phase (twins)
    # tp, tn, fp, fn of the final decisions by estimator (of a twin)
    counts: Mapping[str, tuple[int, int, int, int]] = field(default_factory=dict)


def smoother_of(runs: Sequence[Run], inputs: Inputs) -> Run | None:
    """Batch over the decisions of the first filter, else of the first stepping estimator; None: all failed."""
    if len(runs) == 1 and runs[0].estimator == PLAIN:
        return runs[0]
    fronts = [r for r in runs if steps(r.estimator) and r.failure is None]
    fronts.sort(key=lambda r: r.estimator not in FILTERS)
    return same_decisions(fronts[0], runs, inputs) if fronts else None


def same_decisions(front: Run, runs: Sequence[Run], inputs: Inputs) -> Run:
    """The batch smoother under the final decisions of `front`: one of the runs, or a new one. If it is implausible, the
    robust `STAND_IN` under the same decisions, if that is plausible.
    """
    alike = {r.estimator: r for r in runs if np.array_equal(r.final_decisions, front.final_decisions)}
    plain = alike.get(PLAIN) or with_plausibility(batch(PLAIN, inputs, front), inputs)
    if plain.implausible is None:
        return plain
    robust = alike.get(STAND_IN) or with_plausibility(batch(STAND_IN, inputs, front), inputs)
    return robust if robust.flaw is None else plain


def sample_of(log: Log, task: str, association: str, runs: Sequence[Run], smoother: Run | None) -> Sample:
    """Statistics of a log from its runs with one association method; `smoother`: see `smoother_of`."""
    inputs = inputs_of(log, task, association)
    measured: dict[Key, Statistic] = {}
    failures: dict[str, str] = {}
    apart: dict[str, float] = {}
    for run in runs:
        if not steps(run.estimator):
            continue
        if run.failure is not None:
            failures[run.estimator] = run.failure.text
            continue
        own = None if smoother is None else same_decisions(run, [*runs, smoother], inputs)
        own = own if own is not None and own.flaw is None else None
        measured |= {(run.estimator, name): m for name, m in truth_free.of_online(run, own, inputs).items()}
        if own is not None and own.final is not None and run.online is not None:
            apart[run.estimator] = errors.rms(errors.position_distance(run.online.pose, own.final.pose))
    if smoother is not None and smoother.flaw is not None:
        failures[smoother.estimator] = smoother.flaw.why if smoother.implausible is None else smoother.implausible.text
    if smoother is None or smoother.flaw is not None:
        return Sample(measured, failures, apart=apart)
    measured |= {(smoother.estimator, name): m for name, m in truth_free.of_smoother(smoother, inputs).items()}
    return Sample(measured, failures, apart=apart)


def one_twin(source: Source, seed: int) -> Sample:
    """All estimators on a twin, with statistics and errors."""
    if not gc.get_freeze_count():  # or every collection searches all that is loaded: a tenth of the time
        gc.freeze()
    with threadpool_limits(1):  # the same bytes for any number of cores
        log = twin(source, seed)
        inputs = inputs_of(log, source.task, source.association)
        runs = compare(inputs, source.task, source.estimators, source.association, source.setup)
        return twin_sample(source, log, runs, smoother_of(runs, inputs))


def twin_sample(source: Source, log: Log, runs: Sequence[Run], smoother: Run | None) -> Sample:
    """Statistics of a twin, and the errors of its runs."""
    sample = sample_of(log, source.task, source.association, runs, smoother)
    nees: dict[tuple[str, str], float] = {}
    counts: dict[str, tuple[int, int, int, int]] = {}
    for run in runs:
        if run.flaw is not None or run.estimator == "dead-reckoning":
            continue
        for phase in run.phases:
            t = run.trajectory(phase)
            each = consistency.nees(t.pose, t.covariance, source.path, "pose")
            thin = consistency.nearly_singular(t.covariance, log.recorded.covariance_floor)
            nees[run.estimator, phase] = consistency.mean_or_nan(np.where(thin, math.nan, each))
        found = confusion_of(run, log, "final")
        if found is not None:
            counts[run.estimator] = found.tp, found.tn, found.fp, found.fn
    return replace(sample, nees=nees, counts=counts)


PLAIN_FIELDS = ("failures", "apart")  # stored without conversion


def save(path: Path, sample: Sample) -> None:
    """Keep a sample; the file is written atomically."""
    kept = {
        "measured": [[*key, *m] for key, m in sample.measured.items()],
        "nees": [[*key, value] for key, value in sample.nees.items()],
        **{name: getattr(sample, name) for name in (*PLAIN_FIELDS, "counts")},
    }
    with whole_file(path) as partial:
        partial.write_bytes(json.dumps(kept).encode())


def load(path: Path) -> Sample | None:
    """A kept sample; None if it is missing or damaged."""
    try:
        kept = json.loads(path.read_bytes())
        measured = {(e, name): Statistic(*m) for e, name, *m in kept["measured"]}
        nees = {(e, phase): v for e, phase, v in kept["nees"]}
        counts = {e: (tp, tn, fp, fn) for e, (tp, tn, fp, fn) in kept["counts"].items()}
        return Sample(measured, nees=nees, counts=counts, **{name: kept[name] for name in PLAIN_FIELDS})
    except (FileNotFoundError, ValueError, KeyError, TypeError):
        return None
