"""Results that were handed in: what `eval.score` prints of one or of many, and the report's sentences on them."""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np
import pandas as pd

from data.command import stretch
from data.errors import DataError, UsageError
from data.formats.messages import parts_of
from data.formats.recordings.ros import file_and_topic, is_bag
from data.formats.results.lines import EUROC
from data.formats.results.reading import read_path
from data.formats.results.space import ignored
from data.formats.results.tables import Companions
from data.formats.wrapped import file_and_word
from data.log import Log
from data.logs import Reading, open_scored, unknown_world
from data.notice import Code, Notice, Severity, notice
from data.questions.asked import assumed_noise, truth_windows
from data.se2 import Array, wrap_angle
from data.truth_windows import scored as screened
from data.words import sentence
from data.worlds import registry
from eval.plan.flags.table import Output, Scoring
from eval.plan.results import TRUTH, Result, manner_of, offset_of, phase_of, runs_of, true_path, truth_of
from eval.referee import consistency, errors, result_files
from eval.referee.consistency import QUANTITIES
from eval.referee.given.pairing import FITS, OTHER_FRAME, PLENTY, POOR, inverted
from eval.referee.given.runs import GivenRun, TruePath, truth_log
from eval.referee.result_files import OF_ESTIMATES
from eval.referee.score import Trial, metrics_row
from eval.referee.space_scores import CONVENTIONS, ERRORS as NAMED, columns_in_space
from eval.report.page.blocks import Table
from eval.report.page.files import HEADS, drop_blank_columns, stem, written_table
from eval.report.words import paragraph, say
from eval.studies.montecarlo import Sample, verdicts

ESTIMATE = "estimate"
FIRST = tuple(f"{name}_position_m" for name in ("rmse", "mean", "median", "std", "min", "max"))
"""Absolute errors of the position stand in front."""
POOLED = ("rmse_position_3d_m", "rmse_rotation_3d_deg", *(f"nees_3d_{n}" for n in (*NAMED, "position", "rotation")))
LEFT_OUT = ("observations", "accepted", "rejected", "landmarks", "frames", "lost_frame", "iterations", "block_frames")


@dataclass(frozen=True, eq=False)
class Scored:
    """An estimate with its truth: the run, and notes for the person."""

    run: GivenRun
    log: Log
    phase: str
    notes: tuple[str, ...]
    projected: Mapping[str, str]  # what the projection to the plane ignores, by role of the file
    apart: bool = False  # one of the two is in metres about a latitude and longitude, the other in a frame of its own


def printed(files: Sequence[str], truths: Sequence[str], reading: Scoring, *, infer: bool) -> tuple[str, str]:
    """Lines of scores (name, value), of several with verdicts, and notes; `infer`: an alignment's RMSE is first."""
    found = [scored(file, truth, reading) for file, truth in zip(files, truths, strict=True)]
    if len(found) == 1:
        one, values = found[0], scores(found[0])
        first = aligned_first(one, values) if infer else None
        lead = {} if first is None else {name: values[name] for name in [str(first.named["column"])]}
        notes = "\n".join([*([] if first is None else [sentence(first)]), *one.notes])
        return say("results#one", scores=lead | values, projected=one.projected, space=bool(one.run.space)), notes
    p = _pooled(files, found)
    return say("results#many", p=p), say("results#notes", p=p)


def _pooled(files: Sequence[str], found: Sequence[Scored]) -> dict[str, object]:
    """Many runs, poses of equal weight within a run: RMSE [m, deg] over all, and verdicts by quantity."""
    samples = [_sample(s) for s in found]
    squares = {q: float(np.mean([s.squares[q] for s in samples])) for q in ("position", "heading")}
    matches = [s.run.match for s in found if s.run.match is not None]
    space = [columns_in_space(s.run.space[s.phase]) for s in found] if all(s.run.space for s in found) else [{}]
    shared = [name for name in space[0] if name in POOLED and all(name in each for each in space)]
    return {
        "runs": len(found),
        "least": consistency.MIN_RUNS,
        "position": math.sqrt(squares["position"]),
        "heading": math.degrees(math.sqrt(squares["heading"])),
        "verdicts": dict(verdicts(samples)),
        "matched": sum(m.matched for m in matches),
        "unmatched": sum(m.unmatched for m in matches),
        "projected": found[0].projected,  # files without a usable covariance
        "space": {name: float(np.mean([each[name] for each in space])) for name in shared},
        "bare": tuple(f for f, s in zip(files, samples, strict=True) if not math.isfinite(s.means["pose"])),
        "first": files[0],  # which the notes are about
        "notes": next((s.notes for s in found if s.notes), ()),
    }


def scored(file: str, truth: str, reading: Scoring) -> Scored:
    """An estimate, read and matched; of a truth that is a log, the run has its frames if they are the same. Where
    quaternions of a TUM file fit only with w first, or poses if inverted, they are read so, which is said.
    """
    found, told = _scored(file, truth, reading), tuple[str, ...]()
    doubted = any(n.code in (Code.PATH_TILT, Code.PATH_QUATERNIONS) for n in found.run.notes) and not reading.columns
    for who, name in ((ESTIMATE, file), (TRUTH, truth)) if doubted and found.run.space else ():
        w_first = replace(reading, columns=(",".join(f"{who}.{role}={k}" for k, role in enumerate(EUROC, 1)),))
        with suppress(DataError, UsageError):  # a flag of covariances, which are not read then
            both = found, _scored(file, truth, w_first)
            each = [columns_in_space(s.run.space[s.phase]) for s in both]
            off = [columns.get("rmse_rotation_3d_se3_deg", math.nan) for columns in each]
            if off[1] < off[0] / OTHER_FRAME and each[1]["rmse_position_3d_m"] == each[0]["rmse_position_3d_m"]:
                told = (sentence(notice(Code.QUATERNION_ORDER, file=name, stated=off[0], fits=off[1])),)
                found, reading = both[1], w_first
                break
    back = inverted(found.run.space[found.phase]) if found.run.space else None
    if back is not None and not any("inverse" in value for value in reading.axes):
        k, how, stated, fits = back
        axes = manner_of((ESTIMATE, TRUTH)[k], [ESTIMATE], reading).axes
        flag = f"{(ESTIMATE, TRUTH)[k]}={how}{f'-{axes}' * bool(axes)}"
        sure = not axes and (k == 1 or found.run.space[found.phase].original.covariance is None)
        told += (sentence(notice(
            Code.INVERSE_POSES, file=(file, truth)[k], how=how, stated=stated, fits=fits, flag=flag, inferred=sure,
        )),)  # fmt: skip
        found = _scored(file, truth, replace(reading, axes=(*reading.axes, flag))) if sure else found
    return replace(found, notes=(*told, *found.notes))


def _scored(file: str, truth: str, reading: Scoring) -> Scored:
    path, given = Path(truth), None
    excluded = tuple(stretch(text) for text in reading.exclude_truth)
    files, asked = all(file_and_word(part)[0].is_file() for part in parts_of(path)), None
    if is_bag(file_and_topic(truth)[0]) or (files and not path.is_dir()):
        given = true_path(truth, [ESTIMATE], reading, rows=truth == file)
        log, asked = screened(truth_log(path.stem, given), excluded, keep=True), TruePath.of(given)
    elif path.exists() or truth == "victoria-park" or registry.is_simulated(truth):
        log = open_scored(truth, Reading(exclude_truth=excluded, keep_truth=reading.keep_truth))
        asked = truth_of(log, None)
    else:
        right = "a truth is a trajectory file, a log folder, or a world such as arena:0"
        raise DataError.at(truth, f"no such file{unknown_world(truth)}; {right}")
    if asked is None:
        raise DataError.at(truth, "has no true poses (truth.csv)")
    phase = phase_of(Path(file))
    datum = tuple(cast("Sequence[float]", (log.source or {}).get("datum", ()))) if given is None else given.datum
    estimate = read_path(file, replace(manner_of(ESTIMATE, [ESTIMATE], reading), datum=datum, rows=truth == file))
    result = Result(ESTIMATE, {phase: estimate}, Companions(), offset_of(ESTIMATE, [ESTIMATE], reading))
    (run,) = runs_of(result, log, "slam", asked, reading)
    said = [] if given is None else [f"truth {truth}: {n}" for n in (f"read as {given.kind}", *given.notes) if n]
    both = {ESTIMATE: estimate} | ({} if given is None else {TRUTH: given})
    projected = {name: what for name, p in both.items() if (what := ignored(p))}
    questions = (f"question: {sentence(n)}" if n.severity is Severity.WARNING else sentence(n) for n in run.notes)
    of_log = [*truth_windows(log), *([] if estimate.covariance is None else assumed_noise(log))]
    apart = bool(datum) != bool(estimate.datum)
    return Scored(run, log, phase, (*said, *map(sentence, of_log), *questions), projected, apart)


def scores(s: Scored) -> dict[str, float]:
    """Every number by its name: those of metrics.csv, and more on the position's errors."""
    row = metrics_row(s.run, s.phase, s.log, None)
    assert s.run.match is not None  # `runs_of` matched it
    pose, truth = s.run.trajectory(s.phase).pose, s.run.match.truth
    d = (each := errors.position_distance(pose, truth))[np.isfinite(each)]
    row |= {"mean_position_m": float(d.mean()), "median_position_m": float(np.median(d))}
    row |= {"std_position_m": float(d.std()), "min_position_m": float(d.min())}
    row["rmse_heading_rad"] = math.radians(errors.heading_rmse_deg(pose, truth))
    rest = [m.column for m in OF_ESTIMATES if m.column not in (*FIRST, *LEFT_OUT)]
    rest.insert(rest.index("rmse_heading_deg") + 1, "rmse_heading_rad")
    values = {name: row.get(name) for name in (*FIRST, *rest)}
    found = {name: float(v) for name, v in values.items() if isinstance(v, (int, float)) and math.isfinite(v)}
    in_space = columns_in_space(s.run.space[s.phase]) if s.phase in s.run.space else {}
    return found | {"end_position_m": float(d[-1])} | in_space


TILTED, SCALED = 2.0, 0.2
"""Least ratio of RMS errors as read and after a fit where verticals or scales differ; least logarithm of a scale."""


def aligned_first(s: Scored, values: Mapping[str, float]) -> Notice | None:
    """What is said of a path that only an alignment brings to its truth: the column of the RMSE after it."""
    doubted = any(n.code in (Code.PATH_CLOCK, Code.PATH_LEAP) for n in s.run.notes)
    if (doubted and not s.apart) or s.run.match is None:
        return None
    truth = s.run.space[s.phase].truth.position if s.phase in s.run.space else s.run.match.truth[:, :2]
    known = truth[np.isfinite(truth).all(axis=1)]
    size, mean = math.sqrt(float(np.var(known, axis=0).sum())), values.get("nees_pose", math.inf)
    if s.phase in s.run.space:
        direct, rigid, scaled = (values.get(f"rmse_position_3d{how}_m", math.nan) for how in ("", "_se3", "_sim3"))
    else:
        direct, rigid, scaled = values["rmse_position_m"], values.get("rmse_aligned_m", math.nan), math.nan
    how, column, fits = ("se3", "rmse_position_3d_se3_m", rigid) if s.run.space else ("se2", "rmse_aligned_m", rigid)
    if abs(math.log(values.get("scale_sim3", 1.0))) > SCALED and TILTED * scaled < min(rigid, 0.5 * size):
        how, column, fits = "sim3", "rmse_position_3d_sim3_m", scaled
    off = s.run.trajectory(s.phase).pose - s.run.match.truth
    off = off[np.isfinite(off[:, :2]).all(axis=1)]
    begun = len(off) > 0 and math.hypot(*off[0, :2]) < fits and abs(wrap_angle(off[0, 2])) < SAME_START
    tilted = any(n.code == Code.PATH_TILT and n.named["which"] == "world" for n in s.run.notes)
    known_frame = len(known) < PLENTY or size < STANDING or begun or mean < POOR
    stays = known_frame or not direct > max((TILTED if tilted else OTHER_FRAME) * fits, FITS * size)
    if not math.isfinite(fits) or (stays and not s.apart):
        return None
    return notice(Code.ALIGNED_FIRST, column=column, direct=direct, how=how)


SAME_START = math.radians(10.0)  # Heading between first poses, in one place, of a path that drifts from its truth's
STANDING = 0.01  # m, extent of a robot that stands or turns in place, whose positions tell no frame


def _sample(s: Scored) -> Sample:
    """What one run gives to the verdicts."""
    assert s.run.match is not None  # as above
    t, truth = s.run.trajectory(s.phase), s.run.match.truth
    each: dict[str, Array] = {q: consistency.nees(t.pose, t.covariance, truth, q) for q in QUANTITIES}
    ends = {q: v[np.isfinite(v)] for q, v in each.items()}
    position = errors.rms(errors.position_distance(t.pose, truth)) ** 2
    heading = math.radians(errors.heading_rmse_deg(t.pose, truth)) ** 2
    last = {q: float(v[-1]) if len(v) else math.nan for q, v in ends.items()}
    means = {q: consistency.mean_or_nan(v) for q, v in each.items()}
    return Sample(means, last, {"position": position, "heading": heading})


def space_rows(trials: Sequence[Trial]) -> list[dict[str, object]]:
    """The rows of space.csv."""
    return [
        dict(zip(result_files.SPACE.names, (t.log.name, r.task, r.estimator, r.association, *row), strict=True))
        for t, r, phase in _in_space(trials) for row in ((phase, *v) for v in columns_in_space(r.space[phase]).items())
    ]  # fmt: skip


def _in_space(trials: Sequence[Trial]) -> Iterator[tuple[Trial, GivenRun, str]]:
    return ((t, r, p) for t in trials for r in t.runs if isinstance(r, GivenRun) for p in r.phases if p in r.space)


SPACE_HEADS: dict[str, str] = HEADS["space"]


def space_tables(folder: Path, output: Output, trial: Trial) -> list[Table]:
    """Scores in 3-D of the results of a trial: none, or a table."""
    rows = []
    for _, run, phase in _in_space([trial]):
        values, stated = columns_in_space(run.space[phase]), run.space[phase].estimate
        convention = CONVENTIONS.get(stated.frame, "") if stated.covariance is not None else ""
        row: dict[str, object] = {"estimator": run.estimator, "phase": phase, "stated error": convention or None}
        rows.append(row | {head: values.get(name) for name, head in SPACE_HEADS.items()})
    if not rows:
        return []
    frame = drop_blank_columns(pd.DataFrame(rows, dtype=object))
    caption = paragraph("results#space", where=f"{trial.log.name}, {trial.task}")
    return [written_table(frame, folder, stem(trial, "space"), caption, output)]
