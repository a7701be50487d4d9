"""Scores of runs against the truth: the rows of metrics.csv, association.csv and timing.csv."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
import pandas as pd

from association.names import SCAN
from data.inputs import CLUTTER, IntArray
from data.log import Log
from data.notice import Notice
from data.result import MapEstimate, Run, Trajectory
from data.se2 import Array
from data.truth_windows import scored
from data.wing import of_all
from data.words import sentence, table_html
from eval.referee import consistency, errors, result_files
from eval.referee.confusion import WITHIN, Confusion, confuse, majority, majority_agreement, share_within
from eval.referee.consistency import NEES_LIMITS, gated, mean_scores, nis_bounds
from eval.referee.errors import Along, along, rpe_columns
from eval.referee.given.in_space import plane_rmse
from eval.referee.given.runs import GivenRun, log_of, match
from eval.referee.intervals import SEED, difference_rows, intervals
from eval.referee.lost import lost, unused
from eval.referee.relations import relation_rows
from eval.referee.result_files import OF_DECISIONS, RUN
from eval.referee.sources import source_rows

HEADS = ("estimator", "association", "phase", "status", "position RMSE [m]", "pose NEES (3 expected)")
SHOWN = (*RUN, "status", "rmse_position_m", "rmse_heading_deg", "nees_pose", "nis")


COUNTED = [m.column for m in OF_DECISIONS if m.column not in ("share_within", "within_m", "majority_agreement")]
"""Columns that are attributes of `Confusion`."""


@dataclass(frozen=True, eq=False)
class Trial:
    """All runs of one log and task on identical inputs.

    Example:
        >>> trial = slamref.Trial(log, "slam", tuple(runs))
        >>> trial.find("ekf", "known").final_decisions.shape  # (M,) observations
    """

    log: Log  # without windows of bad truth (`data.truth_windows.scored`); `log.truth.left_out` lists them
    task: str  # `localization` or `slam`
    runs: tuple[Run, ...]  # results of `compare`
    variant_of: str | None = None  # of a variant, the log whose table it joins
    about: str = ""  # description of a variant

    def __post_init__(self) -> None:
        object.__setattr__(self, "log", scored(self.log))

    def find(self, estimator: str, association: str = "known") -> Run | None:
        """The run of an estimator, or None."""
        return next((r for r in self.runs if (r.estimator, r.association) == (estimator, association)), None)

    @cached_property
    def lost(self) -> Mapping[tuple[str, str], Notice]:
        """Reason and first frame of each lost run, by estimator and association method."""
        found = {(r.estimator, r.association): _lost_of(r, self.log) for r in self.runs}
        return {names: reason for names, reason in found.items() if reason is not None}

    @cached_property
    def unused(self) -> Mapping[tuple[str, str], Notice]:
        """Runs that paired next to nothing, in the same way."""
        found = {(r.estimator, r.association): unused(r, self.log.recorded) for r in self.runs}
        return {names: reason for names, reason in found.items() if reason is not None}

    def _repr_html_(self) -> str:
        rows = [HEADS]
        for run in self.runs:
            rmse = nees = ""
            if run.failure is None and run.phases and (found := along(run, run.phases[-1], self.log)) is not None:
                mean = consistency.mean_or_nan(found.nees["pose"])
                rmse, nees = f"{errors.rms(found.distance):.3g}", f"{mean:.3g}" if math.isfinite(mean) else ""
            rows.append((run.estimator, run.association, run.phases[-1] if run.phases else "", run.status, rmse, nees))
        return table_html(f"{self.log.name}, {self.task}", rows)


def confusion_of(run: Run, log: Log, phase: str) -> Confusion | None:
    """Association outcomes of a run in a phase; None for dead reckoning and where true ids are missing."""
    if run.association == "none" or log.truth.landmark_of is None:
        return None
    known = log.recorded.map if run.task == "localization" else None
    decisions, created = decided(run, phase)
    final = run.final_decisions if phase == "online" else None
    o, sensors = log.recorded.observations, max(len(log.recorded.sensors), 1)
    # the decisions about one sensor's observations of a frame are made together, after those of the sensor before
    instant = sensors * o.frame + (0 if o.sensor is None else o.sensor)
    removed = None if run.removed is None else np.where(run.removed < 0, -1, sensors * run.removed + sensors - 1)
    return confuse(instant, log.truth.landmark_of, decisions, created, known, removed, final)


def nis_of(run: Run, phase: str) -> tuple[float, int] | None:
    """Sum of NIS and its degrees of freedom in a phase; None where the run has none."""
    if phase == "online" and run.innovations is not None:
        formed = np.isfinite(run.innovations.nis)
        return float(run.innovations.nis[formed].sum()), int(run.innovations.dof[formed].sum())
    return run.total_nis if phase == "final" else None


def metrics_row(run: Run, phase: str, log: Log, reference: Run | None, path: Along | None = None) -> dict[str, object]:
    """One row of metrics.csv; `reference`: batch with labels on this log, `path`: the run's errors, if known."""
    own, log = log, log_of(run, log)
    row: dict[str, object] = {**_key(run, log, phase), "status": run.status, "frames": len(log.recorded)}
    row["observations"] = len(log.recorded.observations.frame)
    if run.failure is not None:
        return row
    row |= run.counts(phase)
    if run.task == "slam" and run.association not in ("none", SCAN):
        row["landmarks"] = len(run.map) if run.map is not None else 0
    if isinstance(run, GivenRun) and run.match is not None:
        row |= {"matched": run.match.matched, "unmatched": run.match.unmatched}
    path = path or along(run, phase, log)
    if log.truth.pose is not None and path is not None:
        row |= _path_columns(run.trajectory(phase), log.truth.pose, log.recorded.time, path)
        if run.task != "slam":  # there the frame's error is one draw; blank where the log is too short
            rmse, nees = intervals(path.distance**2, path.nees["pose"], np.random.default_rng(SEED))
            row["block_frames"] = next((i.block for i in (rmse, nees) if not i.why), None)
            for name, found in (("rmse_position", rmse), ("nees_pose", nees)):
                row |= {f"{name}_lower": found.lower, f"{name}_upper": found.upper}
        if isinstance(run, GivenRun) and phase in run.space:
            row["rmse_aligned_m"] = plane_rmse(run.space[phase].original, run.space[phase].truth)
    row |= _map_columns(run, phase, log)
    if phase == "final":
        row |= {"iterations": run.iterations, "last_step_sigma": run.last_step_sigma}
    if reference is not None and reference.final is not None and reference.flaw is None:
        batch = reference.final.pose
        if log is not own:  # at the stamps of another program's result
            batch = match(log.recorded.time, own.recorded.time, batch).truth
        row["rms_from_batch_m"] = errors.rms(errors.position_distance(run.trajectory(phase).pose, batch))
    row |= _innovation_columns(run, phase, log)
    return row


def _lost_of(run: Run, log: Log) -> Notice | None:
    """Reason and first frame of a lost run; None if it is not lost, or has no decisions about this log."""
    if not run.decides or log_of(run, log) is not log:
        return None
    found = lost(run, log.recorded, log.granted if run.association == "known" else None)
    if found is None or log.truth.pose is None:
        return found
    # with ground truth nobody is lost whose poses from there on are where they are claimed to be
    path = run.trajectory(run.phases[-1])
    since = slice(found.frame or 0, None)
    of, dof = ("pose", 3) if log.truth.has_headings else ("position", 2)
    nees = consistency.nees(path.pose[since], path.covariance[since], log.truth.pose[since], of)
    return None if consistency.mean_or_nan(nees) <= NEES_LIMITS[dof] else found


def _key(run: Run, log: Log, *phase: str) -> dict[str, object]:
    return dict(zip(RUN, (log.name, run.task, run.estimator, run.association, *phase), strict=False))


def decided(run: Run, phase: str) -> tuple[IntArray, IntArray]:
    """Decisions (M,) of a phase, and the number (M,) of the landmark that each initialized, -1: none."""
    return (run.decisions, run.created) if phase == "online" else (run.final_decisions, run.initialized)


def _path_columns(estimate: Trajectory, truth: Array, time: Array, path: Along) -> dict[str, object]:
    """Errors, consistency and proper scores of a path."""
    pose, distance = estimate.pose, path.distance
    return {
        "rmse_position_m": errors.rms(distance), "rmse_heading_deg": errors.heading_rmse_deg(pose, truth),
        "max_position_m": float(np.nanmax(distance)), "rmse_aligned_m": errors.aligned_rmse(pose, truth),
        "rmse_time_m": errors.time_weighted_rmse(pose, truth, time), "sse_position_m2": float(np.nansum(distance**2)),
        "nees_left_out": int((path.thin & np.isfinite(truth[:, :2]).all(axis=1)).sum()),
        "nees_pose_median": consistency.mean_or_nan(path.nees["pose"], np.median),
        **{f"nees_{quantity}": consistency.mean_or_nan(values) for quantity, values in path.nees.items()},
        "inside_3sigma": consistency.inside_3sigma(path.nees["position"]),
        **mean_scores(pose, estimate.covariance, truth, np.isfinite(path.nees["pose"])),
        **rpe_columns(pose, truth, time),
    }  # fmt: skip


def _map_columns(run: Run, phase: str, log: Log) -> dict[str, object]:
    """Errors of the last map's landmarks, with true ids by their first observation, and by majority."""
    if run.map is None or not len(run.map):
        return {}
    off = _landmark_distance(run.map, errors.true_ids_of(run, log), log)
    row: dict[str, object] = {"rmse_landmark_m": errors.rms(off), "rmse_landmark_majority_m": math.nan}
    if np.isfinite(off).any():
        row["sse_landmark_m2"] = float(np.nansum(off**2))
    ids = errors.identified(log).landmark_of
    if ids is not None and run.task == "slam":
        decisions, created = decided(run, phase)
        named = majority(np.where(created >= 0, created, decisions), ids, created >= 0)
        padded = np.full(max(len(named), int(run.map.number.max()) + 1), CLUTTER, np.int64)
        padded[: len(named)] = named
        row["rmse_landmark_majority_m"] = errors.rms(_landmark_distance(run.map, padded[run.map.number], log))
    return row


def _landmark_distance(estimate: MapEstimate, true_id: IntArray, log: Log) -> Array:
    """Distance [m] (L,) of mapped landmarks from the true ones `true_id` (L,); NaN where unknown."""
    return np.asarray(np.hypot(*errors.landmark_errors(estimate.xy, true_id, log.truth, log.recorded.sensor).T))


def _innovation_columns(run: Run, phase: str, log: Log) -> dict[str, object]:
    """NIS with its bounds, and the lag-1 correlation of innovations."""
    row: dict[str, object] = {}
    if phase == "online" and run.innovations is not None:
        r, error = consistency.lag1_correlation(run.innovations.white, log.recorded.observations.frame, run.decisions)
        row = {"innovation_lag1": r, "innovation_lag1_se": error}
    total = nis_of(run, phase)
    if total is not None and total[1] > 0:
        expected = gated(run, phase)
        lower, upper = nis_bounds(total[1], expected)
        row |= {"nis": total[0] / total[1], "nis_expected": expected[0], "nis_lower": lower, "nis_upper": upper}
    return row


def association_row(run: Run, phase: str, log: Log) -> dict[str, object] | None:
    """One row of association.csv; None for a run that failed, and without truth."""
    if run.failure is not None:
        return None
    if run.decides:
        columns = _outcomes(run, phase, log)
    else:
        columns = next((c for of_wing in of_all("outcomes") if (c := of_wing(run, log, phase)) is not None), None)
    return None if columns is None else {**_key(run, log, phase), **columns}


def _outcomes(run: Run, phase: str, log: Log) -> dict[str, object] | None:
    """Columns of association.csv for decisions about observations; none about places without truth, and of walls."""
    counts, own, places = confusion_of(run, log, phase), log.truth.landmark_of, log.truth.landmarks
    if counts is None or own is None:
        return None
    decisions, _ = decided(run, phase)
    near = None
    if places is not None and log.recorded.sensor.sees_points:
        taken, paired = decisions.copy(), decisions >= 0
        if run.task != "localization":
            named = run.created if phase == "online" else errors.named(run)
            taken[paired] = errors.landmark_true_ids(named, log.truth, decisions[paired])
        near = share_within(decisions, own, taken, places)
    row = {k: getattr(counts, k) for k in COUNTED} | {"share_within": near, "within_m": WITHIN}
    return row | {"majority_agreement": majority_agreement(decisions, own)}


@dataclass(frozen=True)
class Scores:
    """The tables of a set of trials; docs/results-folder.md describes their columns. Numbers are float64 (unknown:
    NaN), counts `Int64` (unknown: `pd.NA`), words `str`.
    """

    metrics: pd.DataFrame
    association: pd.DataFrame
    timing: pd.DataFrame
    differences: pd.DataFrame
    relations: pd.DataFrame
    sources: pd.DataFrame

    def _repr_html_(self) -> str:
        shown = self.metrics[list(SHOWN)].to_html(index=False, na_rep="", float_format="{:.3g}".format)
        counts = (f"{f.name}: {len(getattr(self, f.name))} rows" for f in fields(self))
        return f"{shown}<small>{', '.join(counts)}</small>"


def score(trials: Sequence[Trial]) -> Scores:
    """Score every run of every trial.

    Returns:
        Tables (`pandas.DataFrame`) with a row per run and phase, columns as in docs/results-folder.md: `metrics` (RMSE
        [m], [deg], NEES, NIS), `association` (TP, TN, FP, FN), `timing` [s], `differences` (paired), `relations`,
        `sources` (fixes and closures).

    Example:
        >>> scores = slamref.score([slamref.Trial(log, "slam", tuple(runs))])
        >>> scores.metrics[["estimator", "phase", "rmse_position_m"]]
    """
    metrics, association, timing, differences, relations = [], [], [], [], []
    sources: list[dict[str, object]] = []
    for trial in trials:
        reference = trial.find("batch") or trial.find("batch", SCAN)
        known: dict[tuple[int, str], Along] = {}
        for i, run in enumerate(trial.runs):
            for phase in run.phases:
                path = along(run, phase, log_of(run, trial.log))
                if path is not None:
                    known[i, phase] = path
                metrics.append(metrics_row(run, phase, trial.log, reference, path))
                if (found := trial.lost.get((run.estimator, run.association))) is not None:
                    metrics[-1] |= {"lost_frame": found.frame, "lost_why": sentence(found)}
            if run.association != "none":
                rows = (association_row(run, phase, trial.log) for phase in ("online", "final"))
                association += [row for row in rows if row is not None]
            if log_of(run, trial.log) is trial.log:  # relations are between frames of the log
                relations += relation_rows(run, trial.log)
                sources += source_rows(run, trial.log)
            if not run.handed_in:
                row: dict[str, object] = {**_key(run, trial.log), "frames": len(trial.log.recorded)}
                speed = len(trial.log.recorded) / run.seconds if run.seconds > 0 else None
                timing.append(row | {"seconds": run.seconds, "frames_per_second": speed})
        differences += difference_rows(trial.log, trial.task, trial.runs, known)
    return Scores(
        result_files.METRICS.table(metrics), result_files.DECISION_COUNTS.table(association),
        result_files.TIMING.table(timing), result_files.DIFFERENCES.table(differences),
        result_files.RELATIONS.table(relations), result_files.SOURCES.table(sources),
    )  # fmt: skip
