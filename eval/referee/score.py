"""The referee: a run and the truth in, the rows of metrics.csv, association.csv and timing.csv out.

HTML of a trial and of its scores: the main numbers, and the paths of all runs over the true one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import cycle

import numpy as np
import pandas as pd

from association.scans.constraints import SCAN, LaserRun
from data import card
from data.inputs import CLUTTER
from data.log import Log
from data.notice import Notice
from data.result import DISCARD, Run
from data.se2 import Array
from data.words import sentence
from eval.referee import consistency, errors, result_files
from eval.referee.confusion import WITHIN, Confusion, confuse, majority, majority_agreement, share_within
from eval.referee.consistency import gated, nis_bounds
from eval.referee.errors import Along, along, rpe_columns
from eval.referee.given_runs import GivenRun, log_of, match
from eval.referee.intervals import SEED, difference_rows, run_intervals
from eval.referee.laser import closure_counts, kept, relation_rows
from eval.referee.lost import lost
from eval.referee.metrics import RUN
from eval.referee.proper_scores import mean_scores

HEADS = ("estimator", "association", "phase", "status", "position RMSE [m]", "pose NEES (3 expected)")
SHOWN = (*RUN, "status", "rmse_position_m", "rmse_heading_deg", "nees_pose", "nis")


def trial_html(log: Log, task: str, runs: Sequence[Run]) -> str:
    """A row for each run at its last phase, and a map."""
    true = log.truth.pose
    paths = [] if true is None else [card.Path("true path", true[:, :2], card.BLACK)]
    rows = []
    for run, colour in zip(runs, cycle(card.COLOURS), strict=False):
        rmse = nees = ""
        if run.failure is None and run.phases:
            t = run.trajectory(run.phases[-1])
            reckoned = run.estimator == "dead-reckoning"
            paths.append(card.Path(run.estimator, t.pose[:, :2], card.GREY if reckoned else colour, reckoned))
            if true is not None:
                rmse = f"{errors.rms(errors.position_distance(t.pose, true)):.3g}"
                mean = consistency.mean_or_nan(consistency.nees(t.pose, t.covariance, true, "pose"))
                nees = f"{mean:.3g}" if math.isfinite(mean) else ""
        rows.append((run.estimator, run.association, run.phases[-1] if run.phases else "", run.status, rmse, nees))
    return card.side_by_side(f"{log.name}, {task}", card.columns_table(HEADS, rows), card.drawing(paths, ()))


def scores_html(tables: Mapping[str, pd.DataFrame]) -> str:
    """The main columns of `metrics`, and how large each table is."""
    shown = tables["metrics"][list(SHOWN)].to_html(index=False, na_rep="", float_format="{:.3g}".format)
    return f"{shown}<small>{', '.join(f'{name}: {len(table)} rows' for name, table in tables.items())}</small>"


METRICS, ASSOCIATION, CONSISTENCY = (
    result_files.METRICS.names,
    result_files.DECISION_COUNTS.names,
    result_files.CONSISTENCY.names,
)
COUNTED = tuple(c for c in ASSOCIATION if c not in (*RUN, "share_within", "within_m", "majority_agreement"))
"""Columns that `Confusion` has."""


@dataclass(frozen=True, eq=False)
class Trial:
    """All runs of one log and task on identical inputs; `beside`: the log whose table they join, `about`: why."""

    log: Log
    task: str
    runs: tuple[Run, ...]
    beside: str | None = None
    about: str = ""

    def find(self, estimator: str, association: str = "known") -> Run | None:
        """The run of an estimator, or None."""
        found = [r for r in self.runs if r.estimator == estimator and r.association == association]
        return found[0] if found else None

    def _repr_html_(self) -> str:
        return trial_html(self.log, self.task, self.runs)


def confusion_of(run: Run, log: Log, phase: str) -> Confusion | None:
    """Association outcomes of a run in a phase; None for dead reckoning and where true ids are missing."""
    if run.association == "none" or log.truth.landmark_of is None:
        return None
    known = log.recorded.map if run.task == "localization" else None
    decisions = run.decisions if phase == "online" else run.final_decisions
    # in the end a landmark that was retracted has never been
    created = run.created if phase == "online" else run.initialized
    final = run.final_decisions if phase == "online" else None
    frame = log.recorded.observations.frame
    return confuse(frame, log.truth.landmark_of, decisions, created, known, run.removed, final)


def nis_of(run: Run, phase: str) -> tuple[float, int] | None:
    """Sum of NIS and its degrees of freedom that belong to a phase, if the run has them."""
    if phase == "online" and run.innovations is not None:
        formed = np.isfinite(run.innovations.nis)
        return float(run.innovations.nis[formed].sum()), int(run.innovations.dof[formed].sum())
    return run.total_nis if phase == "final" else None


def metrics_row(run: Run, phase: str, log: Log, reference: Run | None, path: Along | None = None) -> dict[str, object]:
    """One row of metrics.csv.

    `reference` is the batch smoother with labels on the same log, or None; `path` what `along` gives, if at hand.
    """
    own, log = log, log_of(run, log)
    frames = len(log.recorded)
    decisions = run.decisions if phase == "online" else run.final_decisions
    row: dict[str, object] = {
        "log": log.name, "task": run.task, "estimator": run.estimator, "association": run.association, "phase": phase,
        "status": run.status, "frames": frames, "observations": len(log.recorded.observations.frame),
    }  # fmt: skip
    if run.failure is not None:
        return row
    trajectory = run.trajectory(phase)
    pose, covariance = trajectory.pose, trajectory.covariance
    if isinstance(run, LaserRun) and run.loops is not None:  # what is decided are loop closures
        believed = kept(run.loops, run.weight, phase)
        row["observations"] = len(believed)
        row["accepted"], row["rejected"] = int(believed.sum()), int((~believed).sum())
    elif run.association != "none" and not isinstance(run, LaserRun):
        row["accepted"] = int((decisions >= 0).sum())
        row["rejected"] = int((decisions == DISCARD).sum())
    if run.task == "slam" and run.association not in ("none", SCAN):
        row["landmarks"] = len(run.map) if run.map is not None else 0
    truth = log.truth.pose
    path = path or along(run, phase, log)
    if truth is not None and path is not None:
        distance = path.distance
        row["rmse_position_m"] = errors.rms(distance)
        row["rmse_heading_deg"] = errors.heading_rmse_deg(pose, truth)
        row["max_position_m"] = float(np.nanmax(distance))
        row["rmse_aligned_m"] = errors.aligned_rmse(pose, truth)
        row["rmse_time_m"] = errors.time_weighted_rmse(pose, truth, log.recorded.time)
        row["sse_position_m2"] = float(np.nansum(distance**2))
        row["nees_left_out"] = int((path.thin & np.isfinite(truth).all(axis=1)).sum())
        row["nees_pose_median"] = consistency.median_or_nan(path.nees["pose"])
        for quantity, values in path.nees.items():
            row[f"nees_{quantity}"] = consistency.mean_or_nan(values)
        row["inside_3sigma"] = consistency.inside_3sigma(path.nees["position"])
        row |= mean_scores(pose, covariance, truth, np.isfinite(path.nees["pose"]))
        row |= _intervals(path)
        row |= rpe_columns(pose, truth)
    if isinstance(run, GivenRun) and run.match is not None:
        row["matched"], row["unmatched"] = run.match.matched, run.match.unmatched
    if run.map is not None and len(run.map):
        ids = errors.landmark_true_ids(errors.named(run), log.truth, run.map.number)
        off = np.hypot(*errors.landmark_errors(run.map.xy, ids, log.truth, log.recorded.sensor).T)
        row["rmse_landmark_m"] = errors.rms(off)
        if np.isfinite(off).any():
            row["sse_landmark_m2"] = float(np.nansum(off**2))
        row["rmse_landmark_majority_m"] = errors.rms(_by_majority(run, phase, log))
    if phase == "final":
        row["iterations"], row["last_step_sigma"] = run.iterations, run.last_step_sigma
    if reference is not None and reference.final is not None and reference.flaw is None:
        batch = reference.final.pose
        if log is not own:  # at the stamps of a result that was handed in
            batch = match(log.recorded.time, own.recorded.time, batch).truth
        row["rms_from_batch_m"] = errors.rms(errors.position_distance(pose, batch))
    if phase == "online" and run.innovations is not None:
        o = log.recorded.observations
        row["innovation_lag1"], row["innovation_lag1_se"] = consistency.lag1_correlation(
            run.innovations.white, o.frame, decisions
        )
    found = lost_of(run, own)
    if found is not None:
        row["lost_frame"], row["lost_why"] = found.frame, sentence(found)
    total = nis_of(run, phase)
    if total is not None and total[1] > 0:
        row["nis"] = total[0] / total[1]
        row["nis_expected"] = gated(run, phase)[0]
        row["nis_lower"], row["nis_upper"] = nis_bounds(total[1], gated(run, phase))
    return row


def lost_of(run: Run, log: Log) -> Notice | None:
    """Why and from where on a run is lost; None where it is not, or cannot be asked."""
    # a laser run decides about no observation of its log; a result at other instants is asked about none
    if isinstance(run, LaserRun) or log_of(run, log) is not log:
        return None
    return lost(run, log.recorded, log.granted if run.association == "known" else None)


def _by_majority(run: Run, phase: str, log: Log) -> Array:
    """Distance [m] of each mapped landmark from the true one that most of its observations show; NaN where unknown."""
    assert run.map is not None
    own, decisions = log.truth.landmark_of, run.decisions if phase == "online" else run.final_decisions
    if own is None:
        return np.full(len(run.map), np.nan)
    created = run.created if phase == "online" else run.initialized
    number = np.where(created >= 0, created, decisions)
    named = majority(number, own, created >= 0)
    padded = np.full(max(len(named), int(run.map.number.max()) + 1), CLUTTER, np.int64)
    padded[: len(named)] = named
    ids = padded[run.map.number]
    off: Array = np.hypot(*errors.landmark_errors(run.map.xy, ids, log.truth, log.recorded.sensor).T)
    return off


def _intervals(path: Along) -> dict[str, object]:
    """What chance along the log leaves of RMSE and mean NEES; blank where the log is too short to tell."""
    rmse, nees = run_intervals(path.distance**2, path.nees["pose"], np.random.default_rng(SEED))
    used = [i.block for i in (rmse, nees) if not i.why]
    return {
        "rmse_position_lower": rmse.lower, "rmse_position_upper": rmse.upper,
        "nees_pose_lower": nees.lower, "nees_pose_upper": nees.upper, "block_frames": used[0] if used else None,
    }  # fmt: skip


def association_row(run: Run, phase: str, log: Log) -> dict[str, object] | None:
    """One row of association.csv; None for a run that failed, and where there is nothing to compare with."""
    if isinstance(run, LaserRun):
        closures = None if run.failure is not None else closure_counts(run, log, phase)
        return None if closures is None else {**_name_of(run, phase, log), **closures}
    counts = confusion_of(run, log, phase)
    if counts is None or run.failure is not None:
        return None
    return {
        **_name_of(run, phase, log),
        **{k: getattr(counts, k) for k in COUNTED}, "share_within": _near(run, phase, log), "within_m": WITHIN,
        "majority_agreement": _agreement(run, phase, log),
    }  # fmt: skip


def _name_of(run: Run, phase: str, log: Log) -> dict[str, object]:
    return {
        "log": log.name, "task": run.task, "estimator": run.estimator, "association": run.association, "phase": phase,
    }  # fmt: skip


def _agreement(run: Run, phase: str, log: Log) -> float | None:
    """Share of the pairings that show what most of their landmark's do; None without truth."""
    own = log.truth.landmark_of
    return None if own is None else majority_agreement(run.decisions if phase == "online" else run.final_decisions, own)


def _near(run: Run, phase: str, log: Log) -> float | None:
    """Share of the pairings with a landmark that truly stands within `WITHIN` of the right one; None without truth, and
    of walls.
    """
    own, places = log.truth.landmark_of, log.truth.landmarks
    if own is None or places is None or not log.recorded.sensor.sees_points:
        return None
    decisions = run.decisions if phase == "online" else run.final_decisions
    taken = decisions.copy()
    if run.task != "localization":
        paired = decisions >= 0
        named = run.created if phase == "online" else errors.named(run)
        taken[paired] = errors.landmark_true_ids(named, log.truth, decisions[paired])
    return share_within(decisions, own, taken, places)


def frame_of(rows: Sequence[Mapping[str, object]], columns: Sequence[str]) -> pd.DataFrame:
    """Rows as a table with exactly these columns; unknown is None, integers stay integers."""
    plain = [{k: _blank(v) for k, v in row.items()} for row in rows]
    unknown = {k for row in plain for k in row} - set(columns)
    if unknown:
        raise AssertionError(f"columns {sorted(unknown)} are none of {', '.join(columns)}")
    return pd.DataFrame([[row.get(c) for c in columns] for row in plain], columns=list(columns), dtype=object)


def _blank(value: object) -> object:
    return None if isinstance(value, float) and not math.isfinite(value) else value


@dataclass(frozen=True)
class Scores:
    """The tables of a set of trials; differences between filters and smoothers where there is truth, relations of laser
    logs.

    Numbers are float64 (unknown: NaN), counts `Int64` (unknown: `pd.NA`), words `str`; docs/results-folder.md says what
    every column holds.
    """

    metrics: pd.DataFrame
    association: pd.DataFrame
    timing: pd.DataFrame
    differences: pd.DataFrame
    relations: pd.DataFrame

    def _repr_html_(self) -> str:
        return scores_html({f.name: getattr(self, f.name) for f in fields(self)})


def score(trials: Sequence[Trial]) -> Scores:
    """Referee every run of every trial."""
    metrics, association, timing, differences, relations = [], [], [], [], []
    for trial in trials:
        reference = trial.find("batch") or trial.find("batch", SCAN)
        known: dict[tuple[int, str], Along] = {}
        for i, run in enumerate(trial.runs):
            for phase in run.phases:
                path = along(run, phase, log_of(run, trial.log))
                if path is not None:
                    known[i, phase] = path
                metrics.append(metrics_row(run, phase, trial.log, reference, path))
            if run.association != "none":
                for phase in ("online", "final"):
                    row = association_row(run, phase, trial.log)
                    if row is not None:
                        association.append(row)
            if log_of(run, trial.log) is trial.log:  # relations are between frames of the log
                relations += relation_rows(run, trial.log)
            if isinstance(run, GivenRun):
                continue
            frames = len(trial.log.recorded)
            timing.append({
                "log": trial.log.name, "task": run.task, "estimator": run.estimator, "association": run.association,
                "frames": frames, "seconds": run.seconds,
                "frames_per_second": frames / run.seconds if run.seconds > 0 else None,
            })  # fmt: skip
        differences += difference_rows(trial.log, trial.task, trial.runs, known)
    return Scores(
        result_files.METRICS.table(metrics),
        result_files.DECISION_COUNTS.table(association),
        result_files.TIMING.table(timing),
        result_files.DIFFERENCES.table(differences),
        result_files.RELATIONS.table(relations),
    )
