"""A run that somebody else made: its trajectory at its own stamps, beside a log whose truth is asked there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from data.inputs import Increments, Inputs, IntArray, Observations, Prior
from data.log import Log
from data.result import NEW, MapEstimate, Run, Trajectory, surviving
from data.results.path import GivenPath
from data.results.space import projection
from data.se2 import Array
from data.sensors import RangeBearing
from data.truth import Truth
from eval.referee.paths.align import ABOUT, NONE, alignment, moved, moved_map, moved_walls
from eval.referee.paths.match import GAP, SAME, Match, match

GIVEN = "given"
"""Association of a run whose decisions were handed in, too."""
TRUTH_ALONE = "a truth alone"
"""Kind of a log's source that holds nothing else."""


NO_TRUTH = "no true path is known, so it has no errors: only its distance from batch is measured, where that ran"


@dataclass(frozen=True, eq=False)
class Kept:
    """A map and the decisions that were handed in with a path; either may be None.

    Attributes:
        landmarks: number, xy, covariance.
        decisions, final: (M,) as of `Run`.
    """

    landmarks: MapEstimate | None = None
    decisions: IntArray | None = None
    final: IntArray | None = None


@dataclass(frozen=True, eq=False)
class GivenRun(Run):
    """A run that was handed in.

    Attributes:
        log: its instants, and the truth there; the log beside which it stands where it has that log's frames.
        match: with the truth; None: there is none.
        source: sha256 of what was read, by file.
        aligned: how it was moved onto the truth (`ALIGNMENTS`).
    """

    log: Log | None = None
    match: Match | None = None
    aligned: str = NONE
    source: Mapping[str, str] = field(default_factory=dict)


def log_of(run: Run, log: Log) -> Log:
    """The log whose frames a run has: its own, if it was handed in."""
    return run.log if isinstance(run, GivenRun) and run.log is not None else log


def is_truth_alone(log: Log) -> bool:
    """Whether a log was made of a truth and has nothing else."""
    return log.source.get("kind") == TRUTH_ALONE


def truth_log(name: str, path: GivenPath) -> Log:
    """A log that is a truth alone: no increments, no observations; the prior is the first pose, known exactly."""
    n = len(path)
    nothing = Observations(np.empty(0, np.int64), np.empty((0, 2)), np.empty((0, 2, 2)))
    known = path.pose[np.isfinite(path.pose).all(axis=1)]
    start = known[0] if len(known) else np.zeros(3)
    inputs = Inputs(
        Prior(start, np.zeros((3, 3))), path.time, Increments(np.zeros((n, 3)), np.zeros((n, 3, 3))), nothing,
        RangeBearing(),
    )  # fmt: skip
    said = (f"Truth alone, read from {path.file} ({path.kind})", projection(path), *path.notes)
    notes = tuple(f"{s[0].upper()}{s[1:]}." for s in said if s)
    return Log(name, inputs, Truth(pose=path.pose), source={"kind": TRUTH_ALONE, "file": path.file}, notes=notes)


def with_truth(log: Log, path: GivenPath, gap: float = GAP) -> tuple[Log, Match]:
    """A log with the true path of a file in place of its own, at its frames."""
    found = match(log.recorded.time, path.time, path.pose, gap)
    note = f"True path from {path.file}: {found.text}."
    return replace(log, truth=replace(log.truth, pose=found.truth), notes=(*log.notes, note)), found


@dataclass(frozen=True, eq=False)
class TruePath:
    """The truth as it is asked at other stamps: (K,) s and (K, 3)."""

    time: Array
    pose: Array


def given_run(
    name: str,
    task: str,
    paths: dict[str, GivenPath],
    log: Log,
    truth: TruePath | None,
    *,
    align: str = "none",
    gap: float = GAP,
    kept: Kept = Kept(),
) -> GivenRun:
    """A run of the phases in `paths`, scored against `truth` (None: there is none).

    Phases have the same stamps (the caller sees to that). Where they are the frames of the log, the run is on that log.
    """
    first = next(iter(paths.values()))
    time = first.time
    found = None
    if truth is not None:
        found = match(time, truth.time, truth.pose, 0.0 if log.recorded.time_is_index else gap)
    own = log.recorded.time
    same = len(time) == len(own) and bool((np.abs(time - own) <= SAME).all())
    at = log if same else _at(log, time, None if found is None else found.truth)
    last = paths.get("final") or first
    T = None if found is None else alignment(last.pose, found.truth, align)
    made = {phase: _trajectory(path) for phase, path in paths.items()}
    landmarks = kept.landmarks
    matched = NO_TRUTH if found is None else found.text
    notes = [f"read from {last.file} ({last.kind}): {matched}"]
    if last.covariance is None:
        notes.append("its file has no covariance, so there is no NEES")
    notes += [s for s in (projection(last), *last.notes) if s]
    if T is not None:
        made = {phase: moved(T, path) for phase, path in made.items()}
        move = moved_map if log.recorded.sensor.sees_points else moved_walls
        landmarks = None if landmarks is None else move(T, landmarks)
        notes.append(f"{ABOUT[align]}; its covariance is turned with it")
    notes += _gone(kept, task)
    m = len(log.recorded.observations.frame)
    nothing = np.full(m, -2, np.int64)
    decisions = nothing if kept.decisions is None else kept.decisions
    final = decisions if kept.final is None else kept.final
    created = created_by(decisions, final, task)
    begun = begun_by(final, created)
    return GivenRun(
        name, "none" if kept.decisions is None else GIVEN, task, made.get("online"), made.get("final"), landmarks,
        decisions, np.where(begun >= 0, NEW, final), created, begun=begun, notes=tuple(notes), log=at, match=found,
        aligned=NONE if T is None else align, source={p.file: p.digest for p in paths.values()},
    )  # fmt: skip


def _gone(kept: Kept, task: str) -> list[str]:
    """A sentence where landmarks were removed on the way, which nobody said when."""
    if kept.landmarks is None or kept.decisions is None or task == "localization":
        return []
    final = kept.decisions if kept.final is None else kept.final
    made = created_by(kept.decisions, final, task)
    gone = np.setdiff1d(made[made >= 0], kept.landmarks.number)
    if not len(gone):
        return []
    what = f"{len(gone)} landmarks of its decisions are not in its map, and nothing says when they were removed"
    return [f"{what}: outcomes count them as there to the end"]


def created_by(decisions: IntArray, final: IntArray, task: str) -> IntArray:
    """Number (M,) of the landmark that each observation initialized, by the order of creation; -1 where none."""
    new = (decisions == NEW) | (final == NEW)
    if task == "localization":
        new[:] = False
    return np.where(new, np.cumsum(new) - 1, -1)


def begun_by(final: IntArray, created: IntArray) -> IntArray:
    """Number (M,) of the landmark that begins with each observation by the final decisions (M,), -1 where none does.

    It is the one that created it, or if that was decided otherwise in the end, the first one that is left.
    """
    begun = surviving(final, created)
    numbers, first = np.unique(final, return_index=True)
    moved = np.isin(numbers, created[created >= 0]) & ~np.isin(numbers, begun)
    begun[first[moved & (numbers >= 0)]] = numbers[moved & (numbers >= 0)]
    return begun


def _trajectory(path: GivenPath) -> Trajectory:
    P = np.full((len(path), 3, 3), np.nan) if path.covariance is None else path.covariance
    return Trajectory(path.pose, P)


def _at(log: Log, time: Array, truth: Array | None) -> Log:
    """The log at other instants: nothing is known of it there but the truth."""
    n, o = len(time), log.recorded.observations
    nothing = Observations(o.frame[:0], o.z[:0], o.R[:0])
    recorded = replace(
        log.recorded, time=time, increments=Increments(np.zeros((n, 3)), np.zeros((n, 3, 3))), observations=nothing,
        scans=None,
    )  # fmt: skip
    bare = replace(log.truth, pose=truth, relations=None)
    return replace(log, recorded=recorded, truth=bare, label=None, evidence=None)
