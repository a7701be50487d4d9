"""The first table of the report: a row for each log and task, filter beside smoother, and whom to trust.

The two sentences at the top, what was compared and what to conclude, and the attribution of logs without truth.

What of a SLAM error is the frame's: one sentence with the aligned RMSE beside the plain one.

The small picture of a log and task: true path, filter and smoother from above, as SVG, the same bytes each time.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from data.log import folder_name
from data.result import Run
from data.se2 import Array
from data.terminal import counted
from eval.report.names import stem
from eval.report.overview_facts import CAUSE, EITHER, FILTER, NEITHER, SMOOTHER, Facts, claims, whom_to_trust
from eval.report.page.blocks import Block, Mark, Overview, OverviewRow, Section, Sketch, Value, folded
from eval.report.page.tables import number
from eval.report.rows import Row, value_of
from eval.report.trust import HEADING, first_words
from eval.report.trust_facts import terms_of

MOST = 4
"""Logs that are named in the conclusion."""
ATTRIBUTION = "Whose fault: logs without truth"


def compared(facts: Sequence[Facts]) -> str:
    """The first sentence: what was compared."""
    if not facts:
        return "No log was estimated: this report is about simulated runs alone."
    logs = len({f.trial.log.name for f in facts})
    names = {side: _names(facts, side) for side in ("filtered", "smoothed")}
    who = [f"{kind} ({', '.join(n)})" for kind, n in zip(("filter", "smoother"), names.values(), strict=True) if n]
    given = len({r.estimator for f in facts for r in f.trial.runs if r.handed_in})
    more = f", {counted(given, 'result')} handed in" if given else ""
    return (
        f"{' and '.join(who).capitalize() or 'Estimators'} on identical inputs from {counted(logs, 'log')}{more},"
        " scored by one referee."
    )


def _names(facts: Sequence[Facts], side: str) -> list[str]:
    rows = [getattr(f, side) for f in facts]
    return list(dict.fromkeys(str(r["estimator"]) for r in rows if r is not None))[:3]


def concluded(facts: Sequence[Facts]) -> str:
    """The second sentence: what to conclude."""
    words = [(f, whom_to_trust(f).word) for f in facts if f.measured]
    parts = []
    smoother = [f for f, word in words if word == SMOOTHER]
    if smoother:
        both = [f.errors for f in smoother if f.sound(f.filtered) and f.sound(f.smoothed)]
        ratios = [a / b for a, b in both if b > 0.0]
        size = f" (the filter's RMSE is {_range(ratios)} times as large)" if ratios else ""
        gone = counted(len(smoother) - len(both), "row")
        size += f", where the filter fails on {gone}" if len(both) < len(smoother) else ""
        where = "" if len(smoother) == len(facts) else f" on {_where(smoother, facts)}"
        parts.append(f"for the path after the fact trust the smoother{where}{size}")
    for word, said in (
        (EITHER, "trust either on {}"), (FILTER, "the filter is closer on {}"), (NEITHER, "trust neither on {}"),
    ):  # fmt: skip
        found = [f for f, w in words if w == word]
        parts += [said.format(_where(found, facts))] if found else []
    causes: dict[str, list[Facts]] = {}
    for f in facts:
        if not f.measured:
            causes.setdefault(whom_to_trust(f).word, []).append(f)
    parts += [f"no truth on {_where(found, facts)}, {word}" for word, found in causes.items()]
    text = "; ".join(parts)
    return f"{text[:1].upper()}{text[1:]}." if text else ""


def _range(ratios: Sequence[float]) -> str:
    low, high = number(min(ratios)), number(max(ratios))
    return low if low == high else f"{low} to {high}"


def _where(facts: Sequence[Facts], of: Sequence[Facts]) -> str:
    """Logs by name, with the task of those that have several rows."""
    rows = Counter(f.trial.log.name for f in of)
    names = [f"{f.trial.log.name}{f' ({f.trial.task})' if rows[f.trial.log.name] > 1 else ''}" for f in facts]
    if len(names) > MOST:
        return f"{len(names)} rows"
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def in_short(f: Facts) -> str:
    """Whom to trust on one log and task, in a few words."""
    mark = whom_to_trust(f)
    word = mark.word.capitalize() if mark.word.startswith(CAUSE) else f"Trust: {mark.word}"
    return f"{mark.symbol} **{word}**{f' ({mark.note})' if mark.note else ''}."


def attribution_sections(facts: Sequence[Facts]) -> list[Section]:
    """What the logs without truth say of themselves, one paragraph each; none where all have one."""
    blocks: list[Block] = []
    for f in facts:
        if f.measured or f.trust is None:
            continue
        mark, name = whom_to_trust(f), f"{f.trial.log.name}, {f.trial.task}"
        words = first_words(f.trust, terms=terms_of(f.trial.log.recorded), measured=False)
        blocks += folded(f"**{name}, {mark.word}** ({mark.note}). {words}", f"More under “{HEADING}: {name}”", 900)
    return [Section(ATTRIBUTION, tuple(blocks))] if blocks else []


MOSTLY = 1.5
"""So many times the aligned RMSE, the plain one is half due to the frame in variance (1.5 squared is 2.25)."""

DIFFERENT = 0.1
"""Relative change of the ratio of filter and smoother that is worth a word."""


def gauge_statement(f: Facts) -> str:
    """The sentence; empty in localization, where the map fixes the frame, and where no error is known."""
    if f.trial.task != "slam" or f.filtered is None or f.smoothed is None:
        return ""
    (a, a_fit), (b, b_fit) = _both(f.filtered), _both(f.smoothed)
    if not all(math.isfinite(v) and v > 0.0 for v in (a, a_fit, b, b_fit)):
        return ""
    first, second = f.filtered["estimator"], f.smoothed["estimator"]
    sizes = (
        f"aligned, `{first}` has {number(a_fit)} m instead of {number(a)} m and `{second}` {number(b_fit)} m instead of"
        f" {number(b)} m"
    )
    if a <= MOSTLY * a_fit and b <= MOSTLY * b_fit:
        return f"SLAM fixes its frame at the first pose; here that makes little difference: {sizes}."
    other = abs(a_fit / b_fit / (a / b) - 1.0) > DIFFERENT
    ratio = f" (the ratio is then {number(a_fit / b_fit)}, not {number(a / b)})" if other else ""
    return (
        "SLAM fixes its frame at the first pose, and the heading error of the first seconds turns the whole path:"
        f" {sizes}{ratio}."
    )


def _both(row: Row) -> tuple[float, float]:
    return value_of(row, "rmse_position_m"), value_of(row, "rmse_aligned_m")


WIDTH, HEIGHT, EDGE = 96.0, 60.0, 3.0
"""px of the page."""
POINTS = 90
"""Of a path, at most: more than so small a picture can show."""
TRUTH, ONLINE, SMOOTHED = ("#b8b8b8", 3.0), ("#d55e00", 1.1), ("#0064a8", 1.1)
"""Colour and width of truth, filter and smoother: filters are warm, smoothers cool, as in all figures."""


def sketch(f: Facts, stem: str | None = None) -> Sketch | None:
    """The picture; None where nothing is known of any path."""
    lines: list[tuple[Array, tuple[str, float]]] = []
    names = []
    truth = f.trial.log.truth.pose
    if truth is not None and f.trial.log.truth.known_poses:
        lines.append((truth[:, :2], TRUTH))
        names.append("the true path")
    for row, phase, look in ((f.filtered, "online", ONLINE), (f.smoothed, "final", SMOOTHED)):
        path = _path(f, row, phase)
        if row is not None and path is not None:
            lines.append((path, look))
            names.append(str(row["estimator"]))
    if not names:
        return None
    return Sketch(drawn(lines), f"Map of {f.trial.log.name}: {', '.join(names)}", stem)


def _path(f: Facts, row: Row | None, phase: str) -> Array | None:
    run: Run | None = None if row is None else f.trial.find(str(row["estimator"]), str(row["association"]))
    if run is None or run.failure is not None:
        return None
    trajectory = run.online if phase == "online" else run.final
    return None if trajectory is None else trajectory.pose[:, :2]


def drawn(lines: Sequence[tuple[Array, tuple[str, float]]]) -> str:
    """Paths (N, 2) in metres from above, north up; the first one decides what is seen, up to half its size around."""
    known = [xy[np.isfinite(xy).all(axis=1)] for xy, _ in lines]
    looks = [look for xy, (_, look) in zip(known, lines, strict=True) if len(xy)]
    known = [xy for xy in known if len(xy)]
    if not known:
        return ""
    low, high = known[0].min(axis=0), known[0].max(axis=0)
    reach = 0.5 * max(float((high - low).max()), 1.0)
    near = np.vstack([xy[np.all((xy > low - reach) & (xy < high + reach), axis=1)] for xy in known])
    low, high = near.min(axis=0), near.max(axis=0)
    if high[1] - low[1] > high[0] - low[0]:  # lying, as the picture is wide
        known = [np.column_stack([xy[:, 1], -xy[:, 0]]) for xy in known]
        low, high = np.array([low[1], -high[0]]), np.array([high[1], -low[0]])
    size = np.maximum(high - low, 1e-9)
    scale = float(min((WIDTH - 2.0 * EDGE) / size[0], (HEIGHT - 2.0 * EDGE) / size[1]))
    offset = 0.5 * (np.array([WIDTH, HEIGHT]) - scale * (high - low))
    parts = []
    for xy, (colour, width) in zip(known, looks, strict=True):
        kept = xy[np.unique(np.linspace(0, len(xy) - 1, POINTS).astype(int))]
        x, y = offset[0] + scale * (kept[:, 0] - low[0]), offset[1] + scale * (high[1] - kept[:, 1])
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x.tolist(), y.tolist(), strict=True))
        parts.append(f'<polyline points="{points}" stroke="{colour}" stroke-width="{width:g}"/>')
    box = f'width="{WIDTH:g}" height="{HEIGHT:g}" viewBox="0 0 {WIDTH:g} {HEIGHT:g}"'
    inside = f'<rect {box.split(" viewBox")[0]} fill="#ffffff"/><g fill="none" stroke-linejoin="round">'
    return f"<svg {box}>{inside}{''.join(parts)}</g></svg>"


def as_file(svg: str) -> str:
    """The picture as a file of its own, which needs the name of its language."""
    return svg.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1) + "\n"


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
    given = any(r.handed_in for f in facts for r in f.trial.runs)
    heads = (*HEADS[:5], GIVEN, *HEADS[5:]) if given else HEADS
    rows = []
    for f in facts:
        name = f"{f.trial.log.name}, {f.trial.task}"
        small, errors = _sketch(f, folder, drawn), _errors(f)
        cells: list[Mark | Sketch | str | None] = [
            whom_to_trust(f),
            small,
            *errors,
            _ratio(f),
            claims(f),
            *_associations(f),
            _failed(f),
        ]
        if given:
            cells.insert(4, _given(f))
        made = tuple(Value(*c.split("\n")) if isinstance(c, str) else c for c in cells)
        rows.append(OverviewRow(name, name, made, _links(f, folder)))
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
    names = {r.estimator for r in f.trial.runs if r.handed_in}
    rows = [r for r in f.rows if r["estimator"] in names]
    known = [r for r in rows if math.isfinite(value_of(r, "rmse_position_m"))]
    if not known:
        return "–\n" + ", ".join(sorted(names)) if names else ""
    best = min(known, key=lambda r: value_of(r, "rmse_position_m"))
    return f"{number(value_of(best, 'rmse_position_m'))}\n{best['estimator']}"
