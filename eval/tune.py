"""`python -m eval.tune LOG OUT`: noise, biases and odometry scales that a labelled log's innovations ask for.

Only the parser is imported at once, so that `--help` does not wait for the numerical libraries.
"""

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
from eval.replay.flag import probability_or_auto
from eval.replay.settings import SENSED_GATE, Setup

if TYPE_CHECKING:
    from data.inputs import IntArray
    from data.log import Log
    from data.se2 import Array
    from eval.tuning.fit import Fit, Score
    from eval.tuning.model import Model

PROG = "python -m eval.tune"
MARK = "tuned"
"""Key of [source] in a tuned log's log.toml: what was changed, and by which log."""
HELP = """\
Fit the noise of motion and sensor, constant biases of the readings, scales of the odometry and, where the log has
odometry.csv, the latency of the readings: maximum likelihood of the innovations of an EKF that knows the labels
(localization where the log has a map, else SLAM). OUT becomes a copy of LOG with these numbers in it.

Never report results on OUT itself, whose NIS is right by construction: apply its numbers to another log with --use.
The fit takes some 800 runs of the filter; it does not look at the ground truth. Standard errors hold for white
innovations, so on a recording they are too small; the lag-1 correlation shows how far from white it is.

A factor multiplies what LOG states (noise: a standard deviation; odometry: distance or rotation, shrunk as the best
prediction from noisy odometry is); measured = true + bias; a reading was taken `latency` before its stamp."""
EXAMPLES = """\
examples:
  python -m eval.tune logs/nine logs/nine-tuned
  python -m eval.tune logs/nine logs/nine-noise --fit motion,sensor --gate 0.9999
  python -m eval.tune logs/six logs/six-with-nine --use logs/nine-tuned

exit status: 0 fine, 2 wrong usage or bad data"""


class Numbers(NamedTuple):
    """What was fitted to a log, by name, as a person reads it."""

    fitted_to: str
    values: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Tuning:
    """A tuned log; by title its innovations' scores (or why there is none) and RMSE, position [m] and heading [deg]."""

    log: Log
    model: Model
    fit: Fit | None
    theta: Array
    scores: Mapping[str, Score | str]
    errors: Mapping[str, tuple[float, float]]


def main(argv: Sequence[str] | None = None, prog: str = PROG) -> int:
    """The whole command, called `prog`; returns the exit status."""
    return ended(lambda: _tune_as_asked(argv, prog), "interrupted; nothing was written")


def _tune_as_asked(argv: Sequence[str] | None, prog: str) -> None:
    parser = Command(prog, PROG, HELP, EXAMPLES)
    parser.add_argument("log", metavar="LOG", help="an open log folder with labels, or a name: arena:SEED, ...")
    parser.add_argument("out", metavar="OUT", type=Path, help="folder of the copy; an earlier tuned log is replaced")
    parser.add_argument(
        "--fit",
        metavar="GROUPS",
        help="what may change, of motion,sensor,bias,odometry,latency,growth; default: all "
        "but growth (a range's sigma as a power of the range)",
    )
    parser.add_argument(
        "--gate",
        default="auto",
        metavar="P",
        help="leave out pairings beyond this chi-square probability under the "
        f"noise as stated, or none, or auto (default): {SENSED_GATE} where a sensor read the labels, else none",
    )
    parser.add_argument("--use", metavar="TUNED", type=Path, help="fit nothing: apply the numbers of this tuned log")
    options = parser.read(argv)
    from eval.plan.warming import compile_if_needed

    compile_if_needed()
    sys.stdout.write(_run(options))


def _run(options: argparse.Namespace) -> str:
    """Tune, write the copy, and give the report."""
    from threadpoolctl import threadpool_limits

    from data.formats.open_log.writer import write_folder
    from data.logs import open_log

    log = open_log(options.log)
    folder = Path(options.log) if Path(options.log).is_dir() else None
    _require_free(options.out, folder)
    used = None if options.use is None else _numbers_of(options.use)
    if used is not None and options.fit is not None:
        raise UsageError("--fit and --use exclude each other: --use fits nothing")
    gate = Setup(gate_known=probability_or_auto("--gate", options.gate)).settled(log.labels_are_sensed).label_gate
    with threadpool_limits(1):
        tuning = tune(log, folder, groups=options.fit, gate=gate, use=used)
    write_folder(tuning.log, options.out)
    return "\n".join([*_report(log, tuning), f"written: {options.out.absolute()}", ""])


def tune(
    log: Log,
    folder: Path | None = None,
    *,
    groups: str | None = None,
    gate: float | None = None,
    use: Numbers | None = None,
) -> Tuning:
    """Fit a log's noise and biases (or take those of another tuned log), and judge them.

    Args:
        log: with labels.
        folder: where it was loaded from, for its odometry.csv.
        groups: comma list of `eval.tuning.model.GROUPS`; None: the default ones.
        gate: chi-square probability beyond which pairings are left out, under the noise as stated.
        use: of another log; then nothing is fitted.

    Raises:
        UsageError: no labels, a tuned copy, or options that make no sense.
        DataError: nothing to fit to, or the filter fails.
    """
    from association.expectation import gate_threshold
    from eval.tuning.fit import Fit, fit, pairings
    from eval.tuning.model import DEFAULT_GROUPS, GROUPS, make_model, read_odometry, vector

    if not log.has_labels:
        raise UsageError(f"log {log.name!r} has no labels; noise is fitted with known association only")
    if MARK in log.source:
        raise UsageError(f"log {log.name!r} is a tuned copy; tune the original")
    inputs = log.inputs(labels=True)
    decisions = pairings(inputs, gate_threshold(gate))
    wanted = DEFAULT_GROUPS if groups is None else tuple(groups.split(","))
    model = make_model(inputs, None if folder is None else read_odometry(folder), wanted if use is None else GROUPS)
    origin: Fit | Numbers = fit(model, decisions) if use is None else use
    found, theta = (origin, origin.theta) if isinstance(origin, Fit) else (None, vector(model, origin.values))
    tuned = _tuned(log, folder, model, theta, origin)
    scores, errors = _judge(log, tuned, model, decisions, found)
    return Tuning(tuned, model, found, theta, scores, errors)


def _tuned(log: Log, folder: Path | None, model: Model, theta: Array, origin: Fit | Numbers) -> Log:
    """The copy: new numbers, the truth at the same frames (where they moved, at the new instants), and its origin."""
    from eval.tuning.fit import HELD, Fit
    from eval.tuning.model import apply

    inputs = apply(model, theta, floor=True)
    truth = log.truth
    if folder is not None and truth.pose is not None and (inputs.time != log.recorded.time).any():
        truth = replace(truth, pose=_truth_at(folder, inputs.time))
    if isinstance(origin, Fit):
        kept = [i for i, word in enumerate(origin.status) if word != HELD]
        told: dict[str, object] = {
            "fitted_to": log.name,
            "values": {model.parameters[i].name: model.parameters[i].value(theta[i]) for i in kept},
            "standard_errors": {model.parameters[i].name: _spread(model, origin, i) for i in kept},
            "log_likelihood_gain": origin.gain,
        }
        note = (
            "Noise and biases were fitted to this very log by eval.tune, so its NIS is right by construction: do not "
            "report results on it; apply its numbers to another log with --use."
        )
    else:
        told = origin._asdict()
        note = f"Noise and biases that eval.tune fitted to log {origin.fitted_to!r} were put in."
    return replace(
        log,
        recorded=inputs.without_labels(),
        truth=truth,
        source={**log.source, MARK: told},
        notes=(*log.notes, note),
    )


def _truth_at(folder: Path, time: Array) -> Array:
    """truth.csv beside odometry.csv at other instants (N,)."""
    from data.formats.csv_table import read_table
    from data.formats.open_log.reader import POSE, TRUTH
    from data.timeline import truth_at

    table = read_table(folder / TRUTH, ("t", *POSE), may_be_blank=POSE)
    return truth_at(table.columns["t"], table.stack(POSE), time)


def _judge(
    log: Log, tuned: Log, model: Model, decisions: IntArray, found: Fit | None
) -> tuple[dict[str, Score | str], dict[str, tuple[float, float]]]:
    """Innovations and errors before and after; where something was fitted, its first half's numbers on the second."""
    from ekf.whole_run import run_filter
    from eval.referee.errors import heading_rmse_deg, position_distance, rms
    from eval.tuning.fit import fit, middle, score
    from eval.tuning.model import apply

    after = tuned.inputs(labels=True)
    scores: dict[str, Score | str] = {"as stated": score(model.inputs, decisions)}
    try:
        scores["tuned"] = score(after, decisions)
    except DataError as fault:
        scores["tuned"] = str(fault)
    if found is not None:
        half = middle(model.inputs, decisions)
        scores["second half, as stated"] = score(model.inputs, decisions, half)
        try:
            first = fit(model, decisions, half)
            scores["second half, tuned on the first"] = score(apply(model, first.theta), decisions, half)
        except DataError as fault:
            scores["second half, tuned on the first"] = str(fault)
    errors = {}
    for title, inputs, pose in (("as stated", model.inputs, log.truth.pose), ("tuned", after, tuned.truth.pose)):
        if pose is not None:
            estimate = run_filter(inputs, decisions).pose
            errors[title] = rms(position_distance(estimate, pose)), heading_rmse_deg(estimate, pose)
    return scores, errors


def _require_free(out: Path, folder: Path | None) -> None:
    """Raise unless OUT is free, empty, or an earlier tuned log."""
    from data.formats.open_log.header import read_header
    from data.formats.open_log.reader import HEADER

    if folder is not None and os.path.realpath(out) == os.path.realpath(folder):
        raise UsageError(f"OUT {out}: that is LOG itself; choose another name")
    if not out.exists() or (out.is_dir() and not any(out.iterdir())):
        return
    if not (out / HEADER).is_file() or MARK not in read_header(out / HEADER).source:
        raise DataError.at(out, "exists and is not a tuned log; choose another name")


def _numbers_of(folder: Path) -> Numbers:
    """What a tuned log's [source] says about it, checked: a person may have edited it."""
    from data.formats.open_log.reader import load_folder

    told = load_folder(folder).source.get(MARK)
    if not isinstance(told, Mapping):
        raise UsageError(f"--use {folder}: not a tuned log; it has no {MARK!r} in [source]")
    values = told.get("values")
    if not isinstance(values, Mapping) or not all(isinstance(v, int | float) for v in values.values()):
        raise DataError(f"--use {folder}: [source] {MARK}: a table `values` of numbers is needed")
    return Numbers(str(told.get("fitted_to", "?")), {str(name): float(v) for name, v in values.items()})


def _spread(model: Model, found: Fit, i: int) -> float:
    """Standard error of a parameter as a person reads it, to first order."""
    p = model.parameters[i]
    return float(found.error[i]) * (p.value(found.theta[i]) if p.is_factor else 1.0)


def _report(log: Log, tuning: Tuning) -> list[str]:
    """What was found, in lines."""
    task = "SLAM" if tuning.model.inputs.map is None else "localization"
    lines = [f"{log.name}: {counted(len(tuning.model.inputs), 'frame')}, {task}, known association", ""]
    rows = [("parameter", "value", "s.e.", "", "what it is")]
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
    for title, (position, heading) in tuning.errors.items():
        lines.append(f"RMSE {title}: position {position:.4g} m, heading {heading:.3g} deg")
    return [*lines, *(f"- {note}" for note in tuning.log.notes[len(log.notes) :])]


if __name__ == "__main__":
    sys.exit(main())
