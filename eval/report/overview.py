"""The first table of the report: a row for each log and task, filter beside smoother, and whom to trust."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from data.log import folder_name
from eval.page.document import Overview, OverviewRow, Sketch
from eval.page.numbers import number
from eval.referee.paths.given import GivenRun
from eval.report.names import stem
from eval.report.overview.facts import Facts
from eval.report.overview.sketch import as_file, sketch
from eval.report.overview.verdict import claims, whom_to_trust
from eval.report.rows import Row, value_of

HEADS = (
    "log, task", "trust", "map", "filter [m]", "smoother [m]", "ratio", "filter's claims", "best association", "worst",
    "failed runs",
)  # fmt: skip
GIVEN = "handed in [m]"
CAPTION = (
    "Filter: online, smoother: final; position RMSE in metres, and the filter's over the smoother's. Without truth:"
    " NIS per dof, and the filter's RMS distance from the smoother. Association: FP / FN. Maps: truth grey, filter"
    " orange, smoother blue."
)
NAMED = 2
"""Failed runs that are named."""


def overview(facts: Sequence[Facts], folder: Path, *, drawn: bool = True) -> Overview:
    """The table; small pictures are also written into `figures/` where pictures are wanted (`drawn`)."""
    given = any(isinstance(r, GivenRun) for f in facts for r in f.trial.runs)
    heads = (*HEADS[:5], GIVEN, *HEADS[5:]) if given else HEADS
    rows = []
    for f in facts:
        name = f"{f.trial.log.name}, {f.trial.task}"
        small, errors = _sketch(f, folder, drawn), _errors(f)
        cells = [whom_to_trust(f), small, *errors, _ratio(f), claims(f), *_associations(f), _failed(f)]
        if given:
            cells.insert(4, _given(f))
        rows.append(OverviewRow(name, name, tuple(cells), _links(f, folder)))
    return Overview(heads, tuple(rows), CAPTION)


def _sketch(f: Facts, folder: Path, drawn: bool) -> Sketch | None:
    small = sketch(f, stem(f.trial, "small") if drawn else None)
    if small is not None and small.stem is not None:
        (folder / "figures").mkdir(exist_ok=True)
        (folder / "figures" / f"{small.stem}.svg").write_text(as_file(small.svg), encoding="utf-8", newline="\n")
    return small


def _links(f: Facts, folder: Path) -> tuple[tuple[str, str], ...]:
    """The player of the log, where one was written."""
    place = f"players/{folder_name(f.trial.log.name)}.html"
    return (("play", place),) if (folder / place).exists() else ()


def _errors(f: Facts) -> tuple[str, str]:
    """Errors of filter and smoother, or what stands in for them, with their names below."""
    made = []
    for row, error in zip((f.filtered, f.smoothed), f.errors, strict=True):
        if row is None:
            made.append("")
        elif math.isfinite(error):
            made.append(f"{number(error)}\n{row['estimator']}{' (relations)' if f.related else ''}{_flag(row)}")
        elif row["status"] not in ("ok", "implausible"):
            made.append(f"{row['status']}\n{row['estimator']}")
        else:
            nis = value_of(row, "nis")
            made.append(f"{f'NIS {number(nis)}' if math.isfinite(nis) else '–'}\n{row['estimator']}")
    return made[0], made[1]


def _flag(row: Row) -> str:
    return "" if row["status"] == "ok" else f", {row['status']}"


def _ratio(f: Facts) -> str:
    """The filter's error over the smoother's; without truth how far they are apart."""
    a, b = f.errors
    if math.isfinite(a) and math.isfinite(b):
        return number(a / b) if b > 0.0 and f.sound(f.filtered) and f.sound(f.smoothed) else "–"
    if f.filtered is None or f.smoothed is None:
        return ""
    apart = math.nan if f.trust is None else f.trust.real.apart.get(str(f.filtered["estimator"]), math.nan)
    if not math.isfinite(apart):
        apart = value_of(f.filtered, "rms_from_batch_m")
    return f"{number(apart)} m\napart" if math.isfinite(apart) else ""


def _associations(f: Facts) -> tuple[str, str]:
    if f.decided is None:
        return ("labels" if f.association == "known" else "", "")
    best, worst = f.decided
    return _outcome(best), "" if best is worst else _outcome(worst)


def _outcome(row: Row) -> str:
    return f"{row['association']}\n{value_of(row, 'fp'):.0f} FP / {value_of(row, 'fn'):.0f} FN ({row['estimator']})"


def _failed(f: Facts) -> str:
    """How many, and which."""
    failed = f.failed
    if not failed:
        return "0"
    named = [f"{r['estimator']} {r['association']}" for r in failed[:NAMED]]
    more = f" and {len(failed) - NAMED} more" if len(failed) > NAMED else ""
    return f"{len(failed)} of {f.runs}\n{', '.join(named)}{more}"


def _given(f: Facts) -> str:
    """The best of the results that were handed in."""
    names = {r.estimator for r in f.trial.runs if isinstance(r, GivenRun)}
    rows = [r for r in f.rows if r["estimator"] in names]
    known = [r for r in rows if math.isfinite(value_of(r, "rmse_position_m"))]
    if not known:
        return "–\n" + ", ".join(sorted(names)) if names else ""
    best = min(known, key=lambda r: value_of(r, "rmse_position_m"))
    return f"{number(value_of(best, 'rmse_position_m'))}\n{best['estimator']}"
