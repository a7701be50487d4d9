"""The first screen: what was compared, what follows, and a row for each log and task that says whom to trust."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from data.log import folder_name
from data.se2 import Array
from eval.judgement.causes import of_trial, terms_of
from eval.judgement.judgement import Comparison, Judgement, conclusion
from eval.judgement.runs import Objection, RunJudgement
from eval.referee.consistency import FIT, LARGE, OVERCONFIDENT
from eval.referee.score import Trial
from eval.report.diagnosis import HEADING, first_words
from eval.report.page.blocks import Block, Cell, Mark, Overview, OverviewRow, Section, Sketch, Value, anchor, folded
from eval.report.page.files import number, stem
from eval.report.words import paragraph
from eval.studies.diagnosis import Trust

HEADS = (
    *("log, task", "use", "map", "filter", "smoother", "handed in", "ratio or distance", "the filter's claims"),
    *("association", "unusable runs"),
)
NOTHING_KNOWN = "–"
NAMED = 2  # failed runs that are named


def introduction(found: Sequence[Judgement]) -> str:
    """What was compared, and what to conclude."""
    return paragraph("overview#introduction", found=conclusion(found)) if found else paragraph("overview#nothing")


def in_short(j: Judgement) -> str:
    """Whom to trust on one log and task, in a few words."""
    return paragraph("overview#in_short", j=j, mark=trust_mark(j))


def gauge_statement(j: Judgement) -> str:
    """What of a SLAM error is the frame's; empty where nothing is known of that."""
    return paragraph("overview#gauge", c=j.compared) if j.compared.gauge is not None else ""


def trust_mark(j: Judgement) -> Mark:
    """The estimator to trust for the path; of a log without truth what is to blame."""
    return Mark(paragraph("overview#trust", j=j), j.tone.value, paragraph("overview#trust_note", j=j))


def claims(j: Judgement) -> Mark | None:
    """What NEES, else the innovations say of the filter's covariances; None where nothing is known."""
    row = j.compared.filtered or j.compared.smoothed
    if row is None or row.status not in ("ok", "implausible") or not row.nis_verdict:
        return None
    word = row.verdict if row.verdict == OVERCONFIDENT else row.nis_verdict
    tone = {FIT: "good", OVERCONFIDENT: "bad", LARGE: "bad"}.get(word, "fair")
    return Mark(word, tone, f"NEES {number(row.nees)}" if word == OVERCONFIDENT else f"NIS {number(row.nis)}")


def attribution_sections(trials: Sequence[tuple[Trial, Judgement]], diagnoses: Sequence[Trust]) -> list[Section]:
    """The diagnosis of each log without truth, one paragraph each; none where all have one."""
    blocks: list[Block] = []
    for trial, j in trials:
        for trust in of_trial(trial, diagnoses)[: not j.measured]:
            words = first_words(trust, terms=terms_of(trial.log.recorded), measured=False)
            text = paragraph("overview#attribution", j=j, mark=trust_mark(j), words=words)
            blocks += folded(text, f"More under “{HEADING}: {j.name}”", 900)
    return [Section(HEADING, tuple(blocks))] if blocks else []


def overview(trials: Sequence[tuple[Trial, Judgement]], folder: Path, *, drawn: bool = True) -> Overview:
    """The table, without columns that are blank; `drawn`: small pictures are also written into `figures/`."""
    rows = []
    for trial, j in trials:
        c = j.compared
        cells: tuple[Cell, ...] = (
            trust_mark(j), sketch(trial, j, folder if drawn else None), _error(c, c.filtered, c.errors[0]),
            _error(c, c.smoothed, c.errors[1]), _given(j), _ratio(j), claims(j), associations(j), _failed(j),
        )  # fmt: skip
        player = f"players/{folder_name(j.log)}.html"
        links: tuple[tuple[str, str], ...] = (("play", player),) if (folder / player).exists() else ()
        # where the strongest objection is shown, if not in the log's own section
        headings = {Objection.ASSOCIATION: f"Decisions: {j.name}", Objection.CAUSE: f"{HEADING}: {j.name}"}
        shown_at = [headings[o.objection] for o in j.objections[:1] if o.objection in headings]
        links += tuple(("evidence", f"details/{stem(trial)}.html#{anchor(heading)}") for heading in shown_at)
        rows.append(OverviewRow(j.name, j.name, cells, links))
    shown = [i for i in range(len(HEADS) - 1) if any(row.cells[i] is not None for row in rows)]
    kept = tuple(replace(row, cells=tuple(row.cells[i] for i in shown)) for row in rows)
    heads = (HEADS[0], *(HEADS[i + 1] for i in shown))
    return Overview(heads, kept, paragraph("overview#caption", heads=heads, measured=[j.measured for _, j in trials]))


def _error(c: Comparison, row: RunJudgement | None, error: float) -> Value | None:
    """The error of filter or smoother, or what stands in for it."""
    if row is None:
        return None
    if math.isfinite(error):
        related, flag = " (relations)" if c.related else "", "" if row.status == "ok" else f", {row.status}"
        return Value(f"{number(error)} m", f"{row.estimator}{related}{flag}")
    if row.status not in ("ok", "implausible"):
        return Value(row.status, row.estimator)
    return Value(f"NIS {number(row.nis)}" if math.isfinite(row.nis) else NOTHING_KNOWN, row.estimator)


def _given(j: Judgement) -> Value | None:
    if j.given_best is not None:
        return Value(f"{number(j.given_best.rmse)} m", j.given_best.estimator)
    return Value(NOTHING_KNOWN, ", ".join(j.given)) if j.given else None


def _ratio(j: Judgement) -> Value | None:
    """The filter's error over the smoother's; without truth how far they are apart."""
    c = j.compared
    if all(map(math.isfinite, c.errors)):
        return Value(number(j.ratio) if math.isfinite(j.ratio) else NOTHING_KNOWN)
    return None if len(c.pair) < 2 or not math.isfinite(c.apart) else Value(f"{number(c.apart)} m", "apart")


def associations(j: Judgement) -> Value | None:
    """The best association method without labels by decisions and path; None where nobody decided."""
    m = j.methods
    if m is None:
        return None
    if m.nearest is not None or not m.decides:
        return Value(*(paragraph(f"overview#{part}", m=m) for part in ("disputed", "disputes")))
    return Value(m.best.association, paragraph("overview#association", w=m.best))


def _failed(j: Judgement) -> Value:
    failed = j.unusable
    if not failed:
        return Value("0")
    named = ", ".join(f"{r.estimator} {r.association}" for r in failed[:NAMED])
    more = f" and {len(failed) - NAMED} more" if len(failed) > NAMED else ""
    return Value(f"{len(failed)} of {len(j.last)}", f"{named}{more}")


WIDTH, HEIGHT, EDGE = 96.0, 60.0, 3.0  # px of the page
POINTS = 90  # of a path, at most: more than so small a picture can show
TRUTH, ONLINE, SMOOTHED = ("#b8b8b8", 3.0), ("#d55e00", 1.1), ("#0064a8", 1.1)
"""Colour and width of truth, filter and smoother: filters are warm, smoothers cool, as in all figures."""


def sketch(trial: Trial, j: Judgement, folder: Path | None = None) -> Sketch | None:
    """The small picture of a log, also written below a folder; None where nothing is known of any path."""
    truth, known = trial.log.truth.pose, trial.log.truth.known_poses
    found = [] if truth is None or not known else [("the true path", (truth[:, :2], TRUTH))]
    for row, phase, look in ((j.compared.filtered, "online", ONLINE), (j.compared.smoothed, "final", SMOOTHED)):
        run = None if row is None else trial.find(row.estimator, row.association)
        if run is not None and run.failure is None and phase in run.phases:
            found.append((run.estimator, (run.trajectory(phase).pose[:, :2], look)))
    if not found:
        return None
    svg, name = drawn([line for _, line in found]), stem(trial, "small")
    if folder is not None:
        (folder / "figures").mkdir(exist_ok=True)
        # a file of its own needs the name of its language
        own = svg.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1)
        (folder / "figures" / f"{name}.svg").write_text(own + "\n", encoding="utf-8", newline="\n")
    alt = paragraph("overview#sketch", log=j.log, names=[what for what, _ in found])
    return Sketch(svg, alt, None if folder is None else name)


def drawn(lines: Sequence[tuple[Array, tuple[str, float]]]) -> str:
    """Paths (N, 2) in metres from above, y up as in the map figure; the first one and half its size around is shown."""
    known = [xy[np.isfinite(xy).all(axis=1)] for xy, _ in lines]
    styles = [style for xy, (_, style) in zip(known, lines, strict=True) if len(xy)]
    known = [xy for xy in known if len(xy)]
    if not known:
        return ""
    low, high = known[0].min(axis=0), known[0].max(axis=0)
    reach = 0.5 * max(float((high - low).max()), 1.0)
    near = np.vstack([xy[np.all((xy > low - reach) & (xy < high + reach), axis=1)] for xy in known])
    low, high = near.min(axis=0), near.max(axis=0)
    size = np.maximum(high - low, 1e-9)
    scale = float(min((WIDTH - 2.0 * EDGE) / size[0], (HEIGHT - 2.0 * EDGE) / size[1]))
    offset = 0.5 * (np.array([WIDTH, HEIGHT]) - scale * (high - low))
    parts = []
    for xy, (colour, width) in zip(known, styles, strict=True):
        kept = xy[np.unique(np.linspace(0, len(xy) - 1, POINTS).astype(int))]
        x, y = offset[0] + scale * (kept[:, 0] - low[0]), offset[1] + scale * (high[1] - kept[:, 1])
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x.tolist(), y.tolist(), strict=True))
        parts.append(f'<polyline points="{points}" stroke="{colour}" stroke-width="{width:g}"/>')
    box = f'width="{WIDTH:g}" height="{HEIGHT:g}" viewBox="0 0 {WIDTH:g} {HEIGHT:g}"'
    return f'<svg {box}><g fill="none" stroke-linejoin="round">{"".join(parts)}</g></svg>'
