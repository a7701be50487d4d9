"""`slamref tune LOG OUT`: fit noise, biases and odometry scales to the innovations of a labelled log."""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from data.command import Command
from data.errors import DataError, UsageError
from data.terminal import counted, ended, in_columns
from eval.plan.flags.table import KEEP_TRUTH
from eval.replay.flag import probability_or_auto
from eval.replay.settings import SENSED_GATE, Setup

if TYPE_CHECKING:
    from data.inputs import IntArray
    from data.log import Log
    from data.se2 import Array
    from eval.tuning import Fit, Model, Score

PROG = "python -m eval.tune"
TUNED = "tuned"  # title of the scores and errors after the fit
DOUBT = """\
innovations stay correlated (lag-1 {:+.2f} ± {:.2f}, expected 0), so the sigmas, fitted as if they were white, are not \
to be believed: NIS is right by construction, the covariance is not. Remove the cause first: a latency, a bias, slip \
(--fit {} fits no sigma)"""
MARK = "tuned"  # key of [source] in log.toml of a tuned log: the fitted values and their log
HELP = """\
Fit noise of motion and sensor, observation biases, odometry scales and, with odometry.csv, observation latency.
The fit maximizes the likelihood of the innovations of an EKF with labels (localization if LOG has a map, else SLAM).
OUT is a copy of LOG with the fitted values.

Do not report results on OUT, whose NIS is right by construction; apply its values to another log with --use.
The fit runs the filter about 800 times and does not use the ground truth. Fitted sigmas and standard errors hold for
white innovations. Where these stay correlated (lag-1), the first line of the report and a note in OUT warn.

A factor multiplies the value stated in LOG: a standard deviation, or odometry distance or rotation (a regression
coefficient, below 1 for noisy odometry). Bias: measured minus true. Latency: stamp minus time of observation."""
EXAMPLES = """\
examples:
  python -m eval.tune logs/nine logs/nine-tuned
  python -m eval.tune logs/nine logs/nine-noise --fit motion,sensor --gate 0.9999
  python -m eval.tune logs/six logs/six-with-nine --use logs/nine-tuned

exit status: 0 fine, 2 wrong usage or bad data"""


class Numbers(NamedTuple):
    """Fitted values by parameter name, and the log they were fitted to."""

    fitted_to: str
    values: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Tuning:
    """A tuned log, with scores (or the reason for none) and errors by title: RMSE of position [m] and heading [deg],
    mean pose NEES, without windows of bad ground truth.
    """

    log: Log
    model: Model
    fit: Fit | None
    theta: Array
    scores: Mapping[str, Score | str]
    errors: Mapping[str, tuple[float, float, float]]

    @property
    def doubtful(self) -> Score | None:
        """The score of sigmas fitted to innovations that stay correlated; None: no such."""
        return _doubtful(self.model, self.fit, self.scores.get(TUNED))


def main(argv: Sequence[str] | None = None, prog: str = PROG) -> int:
    """The command `prog`; returns its exit status."""
    parser = Command(prog, PROG, HELP, EXAMPLES)
    parser.add_argument("log", metavar="LOG", help="an open log folder with labels, or a name: arena:SEED, ...")
    parser.add_argument("out", metavar="OUT", type=Path, help="folder of the copy; replaces an earlier tuned log")
    groups = (
        "parameters to fit: of motion,sensor,bias,odometry,latency,growth, where growth is an exponent of range sigma "
        "over range (default: all but growth)"
    )
    gate = (
        "reject pairings beyond this chi-square probability under the stated noise, or none, or auto (default): "
        f"{SENSED_GATE} where a sensor read the labels, else none"
    )
    parser.add_argument("--fit", metavar="GROUPS", help=groups)
    parser.add_argument("--gate", default="auto", metavar="P", help=gate)
    parser.add_argument("--keep-truth", action="store_true", help=KEEP_TRUTH)
    parser.add_argument("--use", metavar="TUNED", type=Path, help="apply the values of this tuned log, without a fit")
    return ended(lambda: _run(parser.read(argv)), "interrupted; nothing was written")


def _run(options: argparse.Namespace) -> None:
    """Tune, write the copy and print the report."""
    from threadpoolctl import threadpool_limits

    from data.formats.open_log.writer import write_folder
    from data.logs import open_log
    from data.questions.asked import truth_windows
    from data.truth_windows import scored
    from eval.plan.warming import compile_if_needed
    from eval.report.words import asked

    compile_if_needed()
    log = open_log(options.log)
    folder = Path(options.log) if Path(options.log).is_dir() else None
    _require_free(options.out, folder)
    used = None if options.use is None else _numbers_of(options.use)
    if used is not None and options.fit is not None:
        raise UsageError("--fit, --use: exclude each other; --use fits nothing")
    gate = Setup(gate_known=probability_or_auto("--gate", options.gate)).settled(log.labels_are_sensed).label_gate
    with threadpool_limits(1):
        tuning = tune(log, folder, groups=options.fit, gate=gate, use=used, keep_truth=options.keep_truth)
    write_folder(tuning.log, options.out)
    questions = [asked(question) for question in truth_windows(scored(log, keep=options.keep_truth))]
    sys.stdout.write("\n".join([*_report(log, tuning), *questions, f"written: {options.out.absolute()}", ""]))


def tune(
    log: Log,
    folder: Path | None = None,
    *,
    groups: str | None = None,
    gate: float | None = None,
    use: Numbers | None = None,
    keep_truth: bool = False,
) -> Tuning:
    """Fit noise and biases of a log, or apply those of another tuned log, and score both.

    Args:
        log: with labels.
        folder: of the log, for its odometry.csv.
        groups: comma list of `eval.tuning.GROUPS`; None: the default ones.
        gate: chi-square probability beyond which pairings are rejected, under the stated noise.
        use: values of another tuned log, instead of a fit.
        keep_truth: score windows of bad ground truth, too.

    Raises:
        UsageError: no labels, several sensors, a tuned copy, or invalid options.
        DataError: no observations to fit to, or the filter fails.
    """
    from association.expectation import gate_threshold
    from data.truth_windows import scored
    from eval.tuning import DEFAULT_GROUPS, GROUPS, Fit, fit, make_model, pairings, read_odometry, stated_groups, vector

    if not log.has_labels:
        raise UsageError(f"log {log.name!r} has no labels; a fit needs them (label in observations.csv)")
    if log.recorded.several_or_partial:
        what = f"log {log.name!r} has several sensors, or one of bearings or ranges alone"
        raise UsageError(f"{what}; a fit needs one that measures two numbers")
    if MARK in log.source:
        raise UsageError(f"log {log.name!r} is a tuned copy; tune the original")
    inputs = log.inputs(labels=True)
    odometry = None if folder is None else read_odometry(folder)
    wanted = DEFAULT_GROUPS if groups is None else stated_groups(groups, inputs, odometry)
    decisions = pairings(inputs, gate_threshold(gate))
    model = make_model(inputs, odometry, wanted if use is None else GROUPS)
    origin: Fit | Numbers = fit(model, decisions) if use is None else use
    found, theta = (origin, origin.theta) if isinstance(origin, Fit) else (None, vector(model, origin.values))
    tuned = _tuned(log, folder, model, theta, origin)
    scores, errors = _judge(scored(log, keep=keep_truth), tuned, model, decisions, found)
    if (s := _doubtful(model, found, scores[TUNED])) is not None:
        tuned = replace(tuned, notes=(*tuned.notes, f"In this fit, {_doubt(model, s)}."))
    return Tuning(tuned, model, found, theta, scores, errors)


def _doubt(model: Model, s: Score) -> str:
    causes = "bias,odometry" if model.odometry is None else "bias,odometry,latency"
    return DOUBT.format(s.lag1, s.lag1_error, causes)


def _doubtful(model: Model, found: Fit | None, after: Score | str | None) -> Score | None:
    from eval.referee.consistency import correlated
    from eval.tuning import HELD

    if found is None or after is None or isinstance(after, str):
        return None
    fitted = (p.name for p, word in zip(model.parameters, found.status, strict=True) if word != HELD)
    noise = any(name.startswith(("motion_", "sigma_")) for name in fitted)
    return after if noise and correlated(after.lag1, after.lag1_error) else None


def _tuned(log: Log, folder: Path | None, model: Model, theta: Array, origin: Fit | Numbers) -> Log:
    """The copy: fitted values, truth at the (perhaps shifted) frames, and a record of the fit."""
    from eval.tuning import HELD, Fit, apply

    inputs = apply(model, theta, floor=True)
    truth = log.truth
    if folder is not None and truth.pose is not None and (inputs.time != log.recorded.time).any():
        truth = replace(truth, pose=_truth_at(folder, inputs.time))
    if isinstance(origin, Fit):
        kept = [i for i, word in enumerate(origin.status) if word != HELD]
        record: dict[str, object] = {
            "fitted_to": log.name,
            "values": {model.parameters[i].name: model.parameters[i].value(theta[i]) for i in kept},
            "standard_errors": {model.parameters[i].name: _spread(model, origin, i) for i in kept},
            "log_likelihood_gain": origin.gain,
        }
        note = (
            "Noise and biases were fitted to this log by `slamref tune`, so its NIS is right by construction: do not "
            "report results on it; apply its values to another log with --use."
        )
    else:
        record = origin._asdict()
        note = f"Noise and biases are those that `slamref tune` fitted to log {origin.fitted_to!r}."
    if inputs.fixes is not None or inputs.closures is not None:
        note += " Fixes and closures took no part in the fit."
    return replace(
        log,
        recorded=inputs.without_labels(),
        truth=truth,
        source={**log.source, MARK: record},
        notes=(*log.notes, note),
    )


def _truth_at(folder: Path, time: Array) -> Array:
    """Poses (N, 3) of truth.csv at other times (N,) [s]."""
    from data.columns.parts import TRUTH
    from data.columns.poses import POSE
    from data.csv_table import read_table
    from data.timeline import truth_at

    table = read_table(folder / TRUTH, ("t", *POSE), may_be_blank=POSE)
    return truth_at(table.columns["t"], table.stack(POSE), time)


def _judge(
    log: Log, tuned: Log, model: Model, decisions: IntArray, found: Fit | None
) -> tuple[dict[str, Score | str], dict[str, tuple[float, float, float]]]:
    """Scores and errors before and after; after a fit a cross-check, too, fitted to one half, scored on the other."""
    import numpy as np

    from data.truth_windows import unscored
    from ekf.whole_run import run_filter
    from eval.referee.consistency import mean_or_nan, nees
    from eval.referee.errors import heading_rmse_deg, position_distance, rms
    from eval.tuning import apply, fit, middle, score

    after = tuned.inputs(labels=True)
    scores: dict[str, Score | str] = {"as stated": score(model.inputs, decisions)}
    try:
        scores[TUNED] = score(after, decisions)
    except DataError as fault:
        scores[TUNED] = str(fault)
    if found is not None:
        half = middle(model.inputs, decisions)
        scores["second half, as stated"] = score(model.inputs, decisions, half)
        try:
            first = fit(model, decisions, half)
            scores["second half, tuned on the first"] = score(apply(model, first.theta), decisions, half)
        except DataError as fault:
            scores["second half, tuned on the first"] = str(fault)
    errors = {}
    for title, inputs, truth in (("as stated", model.inputs, log.truth), (TUNED, after, tuned.truth)):
        if truth.pose is not None:
            pose = np.where(unscored(log, inputs.time)[:, None], np.nan, truth.pose)
            run = run_filter(inputs, decisions)
            mean = mean_or_nan(nees(run.pose, run.covariance, pose, "pose"))
            errors[title] = rms(position_distance(run.pose, pose)), heading_rmse_deg(run.pose, pose), mean
    return scores, errors


def _require_free(out: Path, folder: Path | None) -> None:
    """Raise unless OUT is missing, empty, or an earlier tuned log."""
    from data.columns.header import HEADER, read_header

    if folder is not None and os.path.realpath(out) == os.path.realpath(folder):
        raise UsageError(f"OUT {out}: is LOG itself; choose another name")
    if not out.exists() or (out.is_dir() and not any(out.iterdir())):
        return
    if not (out / HEADER).is_file() or MARK not in read_header(out / HEADER).source:
        raise DataError.at(out, "exists and is not a tuned log; choose another name")


def _numbers_of(folder: Path) -> Numbers:
    """The checked record of a tuned log, which may have been edited."""
    from data.formats.open_log.reader import load_folder

    record = load_folder(folder).source.get(MARK)
    if not isinstance(record, Mapping):
        raise UsageError(f"--use {folder}: not a tuned log; name a folder that `slamref tune` wrote")
    values = record.get("values")
    if not isinstance(values, Mapping) or not all(isinstance(v, int | float) for v in values.values()):
        raise DataError(f"--use {folder}: [source] {MARK}: a table `values` of numbers is needed")
    return Numbers(str(record.get("fitted_to", "?")), {str(name): float(v) for name, v in values.items()})


def _spread(model: Model, found: Fit, i: int) -> float:
    """Standard error of a parameter in its printed unit, to first order."""
    p = model.parameters[i]
    return float(found.error[i]) * (p.value(found.theta[i]) if p.is_factor else 1.0)


def _report(log: Log, tuning: Tuning) -> list[str]:
    """The lines of the printed report."""
    task = "SLAM" if tuning.model.inputs.map is None else "localization"
    doubt = tuning.doubtful
    lines = [] if doubt is None else [f"warning: {_doubt(tuning.model, doubt)}", ""]
    lines += [f"{log.name}: {counted(len(tuning.model.inputs), 'frame')}, {task}, known association", ""]
    rows = [("parameter", "value", "s.e.", "", "meaning")]
    for i, p in enumerate(tuning.model.parameters):
        value = p.value(tuning.theta[i])
        if tuning.fit is not None:
            error, word = _spread(tuning.model, tuning.fit, i), tuning.fit.status[i]
            rows.append((p.name, f"{value:.4g}", f"{error:.2g}" if math.isfinite(error) else word, p.unit, p.about))
        elif tuning.theta[i]:
            rows.append((p.name, f"{value:.4g}", "", p.unit, p.about))
    lines += [*in_columns(rows), ""]
    body = [("", "log-likelihood", "dof", "NIS/dof", "95 % bounds", "lag-1 correlation")]
    for title, s in tuning.scores.items():
        if isinstance(s, str):
            body.append((title, s, "", "", "", ""))
            continue
        bounds, r = f"{s.lower:.3f} to {s.upper:.3f}", f"{s.lag1:+.3f} ± {s.lag1_error:.3f}"
        body.append((title, f"{s.log_likelihood:.1f}", str(s.dof), f"{s.nis:.3f}", bounds, r))
    lines += [*in_columns(body), ""]
    for title, (position, heading, mean) in tuning.errors.items():
        lines.append(
            f"RMSE {title}: position {position:.4g} m, heading {heading:.3g} deg; pose NEES {mean:.3g} (expected 3)"
        )
    return [*lines, *(f"- {note}" for note in tuning.log.notes[len(log.notes) :])]


if __name__ == "__main__":
    sys.exit(main())
