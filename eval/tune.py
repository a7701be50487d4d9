"""`slamref tune LOG OUT`: fit noise, biases and odometry scales to the innovations of a labelled log."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from data.errors import DataError, UsageError
from data.terminal import counted, ending, in_columns
from eval.plan.flags import command_of
from eval.replay.flag import probability_or_auto
from eval.replay.settings import Setup

if TYPE_CHECKING:
    from data.log import Log
    from eval.tuning import Numbers, Tuning

PROG = "python -m eval.tune"


@ending("interrupted; nothing was written")
def main(argv: Sequence[str] | None = None, prog: str = PROG) -> None:
    """The command `prog`; returns its exit status."""
    options = command_of(prog, PROG, "tune").read(argv)
    from threadpoolctl import threadpool_limits

    from data.formats.open_log import write_folder
    from data.logs import open_log
    from data.questions.asked import truth_windows
    from data.truth_windows import scored
    from eval.plan.warming import compile_if_needed
    from eval.report.words import asked
    from eval.tuning import tune

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


def _require_free(out: Path, folder: Path | None) -> None:
    """Raise unless OUT is missing, empty, or an earlier tuned log."""
    from data.columns.header import HEADER, read_header
    from eval.tuning import TUNED

    if folder is not None and os.path.realpath(out) == os.path.realpath(folder):
        raise UsageError(f"OUT {out}: is LOG itself; choose another name")
    if not out.exists() or (out.is_dir() and not any(out.iterdir())):
        return
    if not (out / HEADER).is_file() or TUNED not in read_header(out / HEADER).source:
        raise DataError.at(out, "exists and is not a tuned log; choose another name")


def _numbers_of(folder: Path) -> Numbers:
    """The checked record of a tuned log, which may have been edited."""
    from data.formats.open_log import load_folder
    from eval.tuning import TUNED, Numbers

    record = load_folder(folder).source.get(TUNED)
    if not isinstance(record, Mapping):
        raise UsageError(f"--use {folder}: not a tuned log; name a folder that `slamref tune` wrote")
    values = record.get("values")
    if not isinstance(values, Mapping) or not all(isinstance(v, int | float) for v in values.values()):
        raise DataError(f"--use {folder}: [source] {TUNED}: a table `values` of numbers is needed")
    return Numbers(str(record.get("fitted_to", "?")), {str(name): float(v) for name, v in values.items()})


def _report(log: Log, tuning: Tuning) -> list[str]:
    task = "SLAM" if tuning.model.inputs.map is None else "localization"
    lines = [] if tuning.doubtful is None else [f"warning: {tuning.doubtful}", ""]
    lines += [f"{log.name}: {counted(len(tuning.model.inputs), 'frame')}, {task}, known association", ""]
    rows = [("parameter", "value", "s.e.", "", "meaning")]
    for i, p in enumerate(tuning.model.parameters):
        value = p.value(tuning.theta[i])
        if tuning.fit is not None:
            error, word = tuning.fit.spread(tuning.model, i), tuning.fit.status[i]
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
        placed = math.isnan(heading)
        errors = f"position {position:.4g} m" + f", heading {heading:.3g} deg" * (not placed)
        of, expected = ("position", 2) if placed else ("pose", 3)
        lines.append(f"RMSE {title}: {errors}; {of} NEES {mean:.3g} (expected {expected})")
    return [*lines, *(f"- {note}" for note in tuning.log.notes[len(log.notes) :])]


if __name__ == "__main__":
    sys.exit(main())
