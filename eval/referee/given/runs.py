"""Runs of other programs: a trajectory at its own stamps, scored against the truth of a log.

The truth is interpolated at these stamps where it is dense enough, and unknown elsewhere. An alignment moves poses,
landmarks and covariances.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from data import se2, se3
from data.formats.results.path import GivenPath, Spatial
from data.formats.results.space import flattened, projection
from data.inputs import Increments, Inputs, IntArray, Observations, Prior
from data.locked import read_only
from data.log import Log
from data.notice import Code, Notice, notice
from data.result import DISCARD, NEW, MapEstimate, Run, Trajectory, surviving
from data.se2 import Array, BoolArray, wrap_angle
from data.sensors import RangeBearing
from data.timeline import usual_gap
from data.truth import Truth
from data.truth_windows import unscored
from data.words import sentence
from eval.referee.given.in_space import EVO, FIRST, NONE, InSpace, Poses, aligning, in_plane, poses


def moved(T: Array, path: Trajectory) -> Trajectory:
    """The trajectory moved by T from the left.

    World-frame errors turn with the poses: P becomes J P J', J = blockdiag(R, 1). The error of the fit is ignored, so
    NEES changes: `se2` removes the common shift and turn that P includes, `first` adds the first pose's error.
    """
    J = se2.world_from_body(float(T[2]))
    return Trajectory(se2.compose(T, path.pose), J @ path.covariance @ J.T)


def moved_map(T: Array, m: MapEstimate) -> MapEstimate:
    """The map moved by T."""
    R = se2.rotation(float(T[2]))
    return replace(m, xy=se2.transform_points(T, m.xy), covariance=R @ m.covariance @ R.T)


def moved_walls(T: Array, m: MapEstimate) -> MapEstimate:
    """The map of walls moved by T: alpha turns with it, rho changes by the shift along the normal."""
    alpha = m.xy[:, 1] + T[2]
    c, s = np.cos(alpha), np.sin(alpha)
    walls = np.stack([m.xy[:, 0] + c * T[0] + s * T[1], se2.wrap_angle(alpha)], axis=1)
    J = np.tile(np.eye(2), (len(walls), 1, 1))
    J[:, 0, 1] = c * T[1] - s * T[0]
    return replace(m, xy=walls, covariance=J @ m.covariance @ J.transpose(0, 2, 1))


SAME = 1e-6  # s, largest difference of equal stamps (files hold microseconds; as in `smfeval`)


@dataclass(frozen=True, eq=False)
class Match:
    """The truth at n stamps."""

    truth: Array  # (n, 3), NaN where unmatched
    matched: int
    unmatched: int
    interpolated: int  # number of matched poses between two truths
    error: float
    """m, RMS error of the interpolation; NaN without one. Truths are left out and interpolated from their neighbours;
    a quarter of that error holds at half the step."""
    apart: float | None = None  # s between truths, where that is more than the largest gap that was asked for

    def __post_init__(self) -> None:
        read_only(self)

    def notice(self, pose: Array | None = None) -> Notice:
        """The counts, and lengths in the plane of the matched paths of poses (n, 3) and the truth."""
        error = self.error if math.isfinite(self.error) else None
        poses, between = self.matched + self.unmatched, self.interpolated
        counts = dict[str, Any](matched=self.matched, poses=poses, between=between, error=error, apart=self.apart)
        if pose is not None and len(pose) == len(self.truth):
            both = np.isfinite(pose[:, :2] + self.truth[:, :2]).all(axis=1)
            ways = (float(np.hypot(*np.diff(p[both, :2], axis=0).T).sum()) for p in (pose, self.truth))
            counts |= dict(zip(("way", "true_way"), ways, strict=True))
        return notice(Code.MATCHED, **counts)


def match(
    time: Array, truth_time: Array, truth: Array, gap: float | None = None, hidden: BoolArray | slice = slice(0)
) -> Match:
    """Truth (n, 3) at stamps `time` (n,) from truths (K, 3) at `truth_time` (K,), both strictly ascending.

    A stamp within `SAME` of a truth's takes that truth. Between two known truths at most `gap` seconds apart (None:
    `usual_gap`), positions and headings are interpolated linearly. Elsewhere, and at the `hidden` stamps, the truth is
    unknown.
    """
    n = len(time)
    if not len(truth_time):
        return Match(np.full((n, 3), np.nan), 0, n, 0, math.nan)
    gap = usual_gap(truth_time) if gap is None else gap
    a, b, share = around(time, truth_time, gap)
    found = _between(truth[a], truth[b], share)
    found[hidden] = np.nan
    known = np.asarray(np.isfinite(found[:, :2]).all(axis=1))
    matched, between = int(known.sum()), int((share[known] > 0.0).sum())
    apart = float(np.median(np.diff(truth_time))) if len(truth_time) > 1 else 0.0
    error = _sagitta(truth_time, truth, gap) if between else math.nan
    return Match(found, matched, n - matched, between, error, apart if apart > gap + SAME else None)


def around(time: Array, truth_time: Array, gap: float) -> tuple[IntArray, IntArray, Array]:
    """Rows of the truths before and after stamps (n,), and the share of the way between them; NaN: too far apart. At a
    stamp within `SAME` of a truth's both are that one. At least one truth is needed.
    """
    after = np.clip(np.searchsorted(truth_time, time), 0, len(truth_time) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(truth_time[before] - time) < np.abs(truth_time[after] - time), before, after)
    same = np.abs(truth_time[nearest] - time) <= SAME
    step = truth_time[after] - truth_time[before]
    within = (truth_time[before] < time) & (time < truth_time[after]) & (step <= gap + SAME)
    share = np.where(within, (time - truth_time[before]) / np.where(within, step, 1.0), np.nan)
    return np.where(same, nearest, before), np.where(same, nearest, after), np.where(same, 0.0, share)


def match_in_space(time: Array, truth: Spatial, gap: float | None, hidden: BoolArray | slice) -> Poses:
    """True poses at stamps (n,), as `match`: positions linearly, rotations at constant rate in between."""
    p, R = np.full((len(time), 3), np.nan), np.full((len(time), 3, 3), np.nan)
    a, b, share = around(time, truth.time, usual_gap(truth.time) if gap is None else gap)
    known = np.isfinite(share)
    a, b, share = a[known], b[known], share[known]
    p[known] = truth.position[a] + share[:, None] * (truth.position[b] - truth.position[a])
    if np.isfinite(truth.rotation).all():  # else of positions alone
        R[known] = se3.between_rotations(truth.rotation[a], truth.rotation[b], share)
    p[hidden], R[hidden] = np.nan, np.nan
    return Poses(p, R)


def _between(first: Array, second: Array, share: Array) -> Array:
    """Poses (m, 3) at shares (m,) of the way from first to second ones."""
    step = second - first
    step[:, 2] = wrap_angle(step[:, 2])
    made = first + share[:, None] * step
    made[:, 2] = wrap_angle(made[:, 2])
    return np.asarray(made)


def _sagitta(time: Array, pose: Array, gap: float) -> float:
    """See `Match.error`."""
    middle = np.arange(1, len(time) - 1)
    if not len(middle):
        return math.nan
    middle = middle[np.maximum(np.diff(time)[:-1], np.diff(time)[1:]) <= gap + SAME]
    share = (time[middle] - time[middle - 1]) / (time[middle + 1] - time[middle - 1])
    off = np.hypot(*(_between(pose[middle - 1], pose[middle + 1], share) - pose[middle])[:, :2].T)
    off = off[np.isfinite(off)]
    return float(0.25 * math.sqrt(np.mean(off**2))) if len(off) else math.nan


GIVEN = "given"  # association method of a run whose decisions were read as well
TRUTH_ALONE = "a truth alone"  # kind of the source of a log that has a truth alone


@dataclass(frozen=True, eq=False)
class MapAndDecisions:
    """The map and the decisions (M,) that were read with a path, as of `Run`."""

    landmarks: MapEstimate | None = None
    decisions: IntArray | None = None
    final: IntArray | None = None
    begun: IntArray | None = None


@dataclass(frozen=True, eq=False)
class GivenRun(Run):
    """A run of another program."""

    log: Log | None = None  # the log at the run's stamps; the scored log itself where the stamps are its frames
    match: Match | None = None  # None: there is no truth
    aligned: str = NONE  # one of the values of `--align`
    space: Mapping[str, InSpace] = field(default_factory=dict)  # by phase, where estimate and truth are in space
    source: Mapping[str, str] = field(default_factory=dict)  # SHA-256 of each file read
    handed_in: ClassVar[bool] = True


def log_of(run: Run, log: Log) -> Log:
    """The log whose frames a run has: for another program's run its own."""
    return run.log if isinstance(run, GivenRun) and run.log is not None else log


def is_truth_alone(log: Log) -> bool:
    """Whether a log has a truth alone."""
    return log.source.get("kind") == TRUTH_ALONE


def truth_log(name: str, path: GivenPath) -> Log:
    """A log of a truth without increments and observations; the prior is the first pose, known exactly."""
    n = len(path)
    nothing = Observations(np.empty(0, np.int64), np.empty((0, 2)), np.empty((0, 2, 2)))
    known = path.pose[np.isfinite(path.pose[:, :2]).all(axis=1)]
    start = np.nan_to_num(known[0]) if len(known) else np.zeros(3)
    still = Increments(np.zeros((n, 3)), np.zeros((n, 3, 3)))
    inputs = Inputs(Prior(start, np.zeros((3, 3))), path.time, still, nothing, RangeBearing())
    sentences = (f"Truth alone, read from {path.file} ({path.kind})", projection(path), *path.notes)
    notes = tuple(f"{s[0].upper()}{s[1:]}." for s in sentences if s)
    return Log(name, inputs, Truth(pose=path.pose), source={"kind": TRUTH_ALONE, "file": path.file}, notes=notes)


def with_truth(log: Log, path: GivenPath, gap: float | None = None) -> tuple[Log, Match]:
    """The log with the true path of a file instead of its own."""
    found = match(log.recorded.time, path.time, path.pose, gap)
    note = f"True path from {path.file}: {sentence(found.notice())}."
    truth = replace(log.truth, pose=found.truth, left_out=(), excluded=(), screened=False)
    return replace(log, truth=truth, notes=(*log.notes, note)), found


@dataclass(frozen=True, eq=False)
class TruePath:
    """True poses (K, 3) at stamps (K,) [s], and the path of the file that they are from."""

    time: Array
    pose: Array
    path: GivenPath | None = None

    @classmethod
    def of(cls, path: GivenPath) -> "TruePath":
        """The truth of a file."""
        return cls(path.time, path.pose, path)


def given_run(
    name: str, task: str, paths: dict[str, GivenPath], log: Log, truth: TruePath | None, *, align: str = NONE,
    gap: float | None = None, pairs: str = EVO, kept: MapAndDecisions = MapAndDecisions(),
) -> GivenRun:  # fmt: skip
    """A run of the phases in `paths`, which have the same stamps, scored against `truth`."""
    own, time = log.recorded.time, next(iter(paths.values())).time
    last = paths.get("final") or next(iter(paths.values()))
    found, hidden = None, unscored(log, time)
    if truth is not None:
        found = match(time, truth.time, truth.pose, 0.0 if log.recorded.time_is_index else gap, hidden)
    same = len(time) == len(own) and bool((np.abs(time - own) <= SAME).all())
    unknown, landmarks = np.full((len(time), 3, 3), np.nan), kept.landmarks
    true_space = None if truth is None or truth.path is None else truth.path.space
    space: dict[str, InSpace] = {}
    if true_space is not None and last.space is not None:
        at = match_in_space(time, true_space, gap, hidden)
        fit = aligning(poses(last.space), at, align)
        for phase, path in paths.items():
            assert path.space is not None  # all phases are of one format
            space[phase] = InSpace(path.space if fit is None else fit.of(path.space), at, path.space, pairs)
        paths = paths if fit is None else {k: flattened(space[k].estimate) for k in paths}
    else:
        fit = None if found is None else aligning(in_plane(last.pose), in_plane(found.truth), align, plane=True)
    T = None if fit is None else fit.planar
    scale = np.array([1.0, 1.0, 1.0] if fit is None or space else [fit.scale, fit.scale, 1.0])  # of x, y and theta
    C = {k: unknown if p.covariance is None else p.covariance * np.outer(scale, scale) for k, p in paths.items()}
    made = {k: Trajectory(p.pose * scale, C[k]) for k, p in paths.items()}
    if T is not None:
        made = made if space else {phase: moved(T, path) for phase, path in made.items()}
        if landmarks is not None:
            move, of_map = (moved_map, scale[:2]) if log.recorded.sensor.sees_points else (moved_walls, scale[1:])
            of_both = landmarks.covariance * np.outer(of_map, of_map)
            landmarks = move(T, replace(landmarks, xy=landmarks.xy * of_map, covariance=of_both))
    m = len(log.recorded.observations.frame)
    decisions = np.full(m, DISCARD, np.int64) if kept.decisions is None else kept.decisions
    final = decisions if kept.final is None else kept.final
    created = created_by(decisions, final, task)
    begun = begun_by(final, created) if kept.begun is None else kept.begun
    gone: list[Notice] = []
    if kept.landmarks is not None and kept.decisions is not None and task != "localization":
        removed = np.setdiff1d(created[created >= 0], kept.landmarks.number)
        gone = [notice(Code.LANDMARKS_GONE, landmarks=len(removed))] if len(removed) else []
    return GivenRun(
        name, "none" if kept.decisions is None else GIVEN, task, made.get("online"), made.get("final"), landmarks,
        decisions, np.where(begun >= 0, NEW, final), created, begun=begun,
        notes=(*_notes(last, found, "" if T is None else align, in_space=bool(space)), *gone),
        log=log if same else _at(log, time, None if found is None else found.truth), match=found,
        aligned=NONE if T is None else align, space=space, source={p.file: p.digest for p in paths.values()},
    )  # fmt: skip


def _notes(path: GivenPath, found: Match | None, aligned: str, *, in_space: bool) -> Iterator[Notice]:
    """Notices of a path that was read; `aligned`: its alignment, empty for none."""
    yield notice(Code.READ_FROM, file=str(path.file), kind=path.kind)
    yield notice(Code.NO_TRUTH) if found is None else found.notice(path.pose)
    if path.covariance is None:
        yield notice(Code.NO_COVARIANCE, name="")
    yield from (notice(Code.NOTE, text=s) for s in (projection(path), *path.notes) if s)
    if aligned:
        bare = found is not None and not np.isfinite(found.truth[:, 2] + path.pose[:, 2]).any()
        how = "course" if aligned == FIRST and bare else aligned
        yield notice(Code.ALIGNED, how=how, in_space=in_space)


def created_by(decisions: IntArray, final: IntArray, task: str) -> IntArray:
    """Number (M,) of the landmark that each observation initialized, in order of creation; -1: none. A landmark may
    begin anew with another observation in the final decisions, which creates none.
    """
    new = decisions == NEW if (decisions == NEW).any() else final == NEW
    if task == "localization":
        new[:] = False
    return np.where(new, np.cumsum(new) - 1, -1)


def begun_by(final: IntArray, created: IntArray) -> IntArray:
    """Number (M,) of the landmark whose first observation by the final decisions (M,) it is; -1: none."""
    begun = surviving(final, created)
    numbers, first = np.unique(final, return_index=True)
    later = (numbers >= 0) & np.isin(numbers, created[created >= 0]) & ~np.isin(numbers, begun)
    begun[first[later]] = numbers[later]
    return begun


def _at(log: Log, time: Array, truth: Array | None) -> Log:
    """The log at other instants, where only the truth is known."""
    n, o = len(time), log.recorded.observations
    nothing = Observations(o.frame[:0], o.z[:0], o.R[:0])
    still = Increments(np.zeros((n, 3)), np.zeros((n, 3, 3)))
    recorded = replace(log.recorded, time=time, increments=still, observations=nothing, scans=None)
    bare = replace(log.truth, pose=truth, relations=None)
    return replace(log, recorded=recorded, truth=bare, label=None, evidence=None)
