"""The report's sections "Trust without ground truth", one for each log and task, and what the first page says of it.

What a log says about itself in words: a few sentences for the first page, a list for its section.

What was found wrong with a log, a sentence each, and what to do about it.

The statistics of a log that matter, as a table: value, what is expected, what its twins show, p values.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from data.se2 import Array
from eval.plan.flags.options import Options
from eval.referee import battery
from eval.referee.attribution import NOTHING, Finding
from eval.referee.score import Trial
from eval.replay.settings import FILTERS
from eval.report.names import stem
from eval.report.page.document import Block, FinePrint, Picture, Section, folded, written_table
from eval.report.page.tables import drop_blank_columns, number
from eval.report.pictures import FILTER_SMOOTHER
from eval.report.shown_runs import associations
from eval.report.trust_facts import (
    HINT,
    STANDS_OUT,
    Terms,
    apart,
    component,
    culprit,
    deciding_on_twins,
    length,
    median_before_and_after,
    nees_on_twins,
    noise_words,
    online,
    outside,
    phrase,
    power,
    quadratic,
    standing_out,
    terms_of,
)
from eval.studies.trusted import Blame, Row, Trust

TWINS = "on the twins, where all is as stated"
SIGMA = "sigma_"
"""Prefix of a factor of a stated sigma among what a calibration did."""
FITTED = {
    "odometry_x_distance": "odometry", "odometry_theta_turn": "odometry", "z1_constant": "bias", "z2_constant": "bias",
}  # fmt: skip
"""Groups of `eval.tune` that have a parameter for a systematic error."""
LATE = ("speed", "turn_rate")
ORDER = ("motion", "sensor", "bias", "odometry")


def sentence(found: Finding, terms: Terms) -> str:
    """A finding with its size, without a full stop; empty where its size is not known."""
    if not math.isfinite(found.size):
        return ""
    if found.kind == "systematic":
        text = phrase(found.name, terms).sentence(found.size, found.error)
        if found.other:
            others = " or ".join(phrase(name, terms).noun for name in found.other)
            text += f" (or, which this log cannot tell apart, {others})"
        return text
    if found.kind == "sigma":
        return noise_words(found.name, found.size, terms)
    many = _count(found.size, "reading")
    one = round(found.size) == 1
    if found.kind == "tails":
        return f"{many} {'fits' if one else 'fit'} no landmark where the path puts them: outliers of the sensor"
    if found.kind == "pairings":
        return f"{many} {'fits' if one else 'fit'} another landmark than the one paired with: wrong pairings"
    if found.kind == "linearization":
        claims = "less" if found.size > 1.0 else "more"
        return (
            f"{TWINS}, {found.name}'s NEES is {number(found.size)} times what its"
            f" covariance claims: it claims {claims} error than it makes"
        )
    if found.kind == "innovations":
        return f"{TWINS}, {found.name}'s NIS is {number(found.size)} times what is expected"
    if found.kind == "decisions":
        return f"{TWINS}, {100.0 * found.size:.2g} % of the decisions of {found.name} are wrong pairings"
    return ""


def _count(value: float, what: str) -> str:
    return f"{value:.0f} {what}{'' if round(value) == 1 else 's'}"


def sentences(findings: Sequence[Finding], terms: Terms) -> list[str]:
    """A sentence for each finding, in their order; an estimator's phases share the one that is furthest off."""
    shown: list[Finding] = []
    for f in findings:
        same = [i for i, s in enumerate(shown) if (s.kind, s.name) == (f.kind, f.name)]
        if not same:
            shown.append(f)
        elif abs(math.log(f.size)) > abs(math.log(shown[same[0]].size)):
            shown[same[0]] = f
    return [text for text in (sentence(f, terms) for f in shown) if text]


def done_words(done: Mapping[str, float], terms: Terms) -> list[str]:
    """What a calibration changed: systematic errors taken out, and factors of stated sigmas."""
    taken = [
        phrase(name, terms).sentence(size, math.nan)
        for name, size in done.items()
        if not name.startswith(SIGMA) and math.isfinite(size) and size != 0.0
    ]
    noises = [
        noise_words(name.removeprefix(SIGMA), size, terms)
        for name, size in done.items()
        if name.startswith(SIGMA) and math.isfinite(size) and size > 0.0
    ]
    return [*taken, *noises]


def groups_of(findings: Iterable[Finding]) -> tuple[str, ...]:
    """Groups of `eval.tune --fit` that have parameters for what was found."""
    wanted = set()
    for f in findings:
        if f.kind == "sigma":
            wanted.add("motion" if f.name.startswith("odometry") else "sensor")
        elif f.kind == "systematic" and f.name in FITTED:
            wanted.add(FITTED[f.name])
    return tuple(name for name in ORDER if name in wanted)


def advice(findings: Sequence[Finding], terms: Terms, *, labels: bool) -> list[str]:
    """What to do about findings, a sentence each; `labels`: whether known association can be granted."""
    said = []
    groups = groups_of(findings)
    if groups and labels:
        said.append(f"Fit what is wrong: `python -m eval.tune LOG OUT --fit {','.join(groups)}`.")
    elif groups:
        said.append(
            f"Correct the noise and the scales that the log states; `python -m eval.tune LOG OUT --fit"
            f" {','.join(groups)}` would fit them if the log had labels."
        )
    systematic = [f for f in findings if f.kind == "systematic" and f.name not in FITTED]
    late = [f for f in systematic if f.name.split("_", 1)[1] in LATE]
    if late:
        said.append("Shift the readings' stamps; a log with odometry.csv can have it fitted (`--fit latency`).")
    by_hand = [phrase(f.name, terms).noun for f in systematic if f not in late]
    if by_hand:
        said.append(f"Correct in the log itself, as no parameter stands for it: {', '.join(by_hand)}.")
    kinds = {f.kind for f in findings}
    if "pairings" in kinds:
        gated = "Leave readings that fit badly out with `--gate-known 0.9999` or a narrower gate, or let"
        said.append(f"{gated if labels else 'Let'} later frames revise the pairings: `--association jcbb-hindsight`.")
    if "tails" in kinds:
        gate = " or a gate (`--gate-known 0.9999`)" if labels else ""
        said.append(f"Use a smoother that bears outliers, `batch-huber` or `gnc`,{gate}.".replace(",.", "."))
    if "decisions" in kinds:
        said.append("Take another way of deciding: `--association jcbb-hindsight`, or labels where the log has them.")
    off = [f.name for f in findings if f.kind in ("linearization", "innovations")]
    if any(name in FILTERS for name in off):
        said.append("Take `ekf-iterated`, which relinearizes each update, or for the path after the fact the smoother.")
    elif off:
        said.append(f"Do not take the covariances of {', '.join(dict.fromkeys(off))} at their word on this geometry.")
    return said


CAVEAT = (
    "What twins cannot see is an error that the batch solution took into its path and map, such as a scale that"
    " odometry and readings share, or a map that is wrong as a whole."
)
LINEAR = (
    "In a linear problem P_f − P_s is always semidefinite; in SLAM linearization alone can spoil it, which only twins"
    " can tell."
)


def first_words(trust: Trust, *, terms: Terms, measured: bool = False) -> str:
    """Two to four sentences, two beside errors against the truth (`measured`); empty where the log says nothing."""
    if trust.blame is None:
        return _without_twins(trust, terms)
    return " ".join(_said(s) for s in _verdict(trust, trust.blame, terms, measured) if s)


def _verdict(trust: Trust, blame: Blame, terms: Terms, measured: bool) -> list[str]:
    """Cause, how much is outside, filter and smoother, and the main findings or the power."""
    if blame.cause == NOTHING:
        said = [f"By its own data this log gives **nothing to object to**: {outside(blame, len(trust.twins))}"]
    else:
        where = "is not to be trusted" if blame.objected else "is off on the very geometry of this log"
        said = [f"By its own data **{culprit(blame.cause)}** {where}: {outside(blame, len(trust.twins))}"]
    said += [apart(trust, name) for name in online(trust)[:1] if not measured]
    if blame.cause == NOTHING:
        return [*said, power(blame, terms, brief=True)]
    return [*said, "; ".join(sentences(_main(blame.findings), terms))]


def _main(findings: Sequence[Finding]) -> list[Finding]:
    """The weightiest finding, and the weightiest systematic error if that is another one."""
    first = list(findings[:1])
    return first + [f for f in findings[1:] if f.kind == "systematic" and first[0].kind != "systematic"][:1]


def _without_twins(trust: Trust, terms: Terms) -> str:
    names = online(trust)
    if not names:
        return ""
    said = ["; ".join(t for t in (apart(trust, names[0]), quadratic(trust, names[0])) if t)]
    found = standing_out(trust, terms, 1)
    said += [f"Of systematic errors the residuals ask most for this one: {text}" for text in found]
    return " ".join([*(_said(s) for s in said), HINT])


def _said(text: str) -> str:
    """A sentence: capital first, full stop last; a name in code stays as it is."""
    return f"{text[:1].upper()}{text[1:]}" + ("" if text.endswith(".") else ".")


def paragraphs(trust: Trust, *, terms: Terms, labels: bool) -> str:
    """Everything that is said of a log with one way of association, as a list in Markdown."""
    lines = _with_blame(trust, trust.blame, terms, labels) if trust.blame else _no_blame(trust, terms)
    return "\n".join(f"* {line}" for line in [*lines, *(_said(n) for n in trust.notes)])


def _no_blame(trust: Trust, terms: Terms) -> list[str]:
    lines = []
    for name in online(trust):
        more = quadratic(trust, name)
        lines.append(_said(apart(trust, name)) + (f" {_said(more)}" if more else ""))
    if lines:
        lines.append(LINEAR)
    found = standing_out(trust, terms, 3)
    if found:
        lines.append(_listed("Systematic errors that the residuals ask for, each as if it were the only one:", found))
    if not trust.twins:
        lines.append(HINT)
    return lines


def _with_blame(trust: Trust, blame: Blame, terms: Terms, labels: bool) -> list[str]:
    count = len(trust.twins)
    lines = [f"**Cause: {culprit(blame.cause)}.** {_said(outside(blame, count))}"]
    if blame.objected and not blame.findings:
        lines[0] += " None of the errors that have a name explains them; the table says which they are."
    lines += [_said(apart(trust, name)) for name in online(trust)]
    found = sentences(blame.findings, terms)
    if found:
        lines.append(_listed("Found, the weightiest first:", found))
    if blame.cause == NOTHING:
        lines += [f"{_said(text)} Each is taken alone." for text in [power(blame, terms)] if text]
    lines += [_said(text) for text in (nees_on_twins(trust), deciding_on_twins(trust)) if text]
    todo = advice(blame.findings, terms, labels=labels)
    if todo:
        lines.append(f"**What to do.** {' '.join(todo)}")
    lines += _afterwards(trust, terms)
    return [*lines, CAVEAT]


def _afterwards(trust: Trust, terms: Terms) -> list[str]:
    """A calibration tried at once: what was changed, and what is left."""
    if trust.after is None or not trust.done:
        return []
    after, before = trust.after, trust.blame
    if after.blame is None or before is None:
        left = ["what is left cannot be told", *after.notes]
    else:
        left = [f"{outside(after.blame, len(after.twins))}; before, {len(before.objected)} of {before.tested} did"]
        for name in [n for n in online(trust)[:1] if n in online(after)]:
            left.append(f"{apart(after, name)}; before, {length(trust.real.apart[name])}")
            left += [f"{text}; before, {was}" for text, was in [median_before_and_after(trust, after, name)] if text]
        left.append(f"cause now: {culprit(after.blame.cause)}")
        left[-1] += "".join(f"; weightiest: {text}" for text in sentences(after.blame.findings, terms)[:1])
    changed = _listed(
        "**Tried at once** (a quick correction of what was found, no fit). Put right:", done_words(trust.done, terms)
    )
    return [changed, _listed("**Afterwards:**", left)]


def _listed(text: str, items: Sequence[str]) -> str:
    """A point of the list with points of its own."""
    return "\n".join([text, *(f"  * {_said(item)}" for item in items)])


MOST = 18
"""Rows of a table; trust.csv has all."""
D = "dᵀ(P_f − P_s)⁻¹d"
NAMES: Mapping[str, str] = {
    "nis": "NIS per degree of freedom",
    "innovation_lag1": "correlation of innovations at lag 1",
    "filter_smoother_median": f"median of {D}",
    "filter_smoother_semidefinite": "P_f − P_s semidefinite [% of frames]",
    "filter_smoother_rms_x": "RMS of d in x [σ]",
    "filter_smoother_rms_y": "RMS of d in y [σ]",
    "filter_smoother_rms_theta": "RMS of d in heading [σ]",
    "filter_smoother_largest": "largest d of all [σ]",
    "filter_smoother_mean": f"mean of {D}",
    "filter_smoother_inside_x": "d inside ±3σ in x [% of frames]",
    "filter_smoother_inside_y": "d inside ±3σ in y [% of frames]",
    "filter_smoother_inside_theta": "d inside ±3σ in heading [% of frames]",
}
HEADLINE = 8
"""So many of `NAMES` are shown whatever they say."""
OWN = "own_smoother"
SUMMARIES = {"mean": "mean [σ]", "spread": "spread [σ]", "lag1": "correlation at lag 1", "largest": "largest [σ]"}


def statistic_words(name: str, terms: Terms) -> tuple[str, float]:
    """A statistic of trust.csv as a person reads it, with its unit, and the factor from what trust.csv has."""
    own = name.startswith(OWN)
    shared = name.replace(OWN, "filter_smoother", 1)
    if shared in NAMES:
        text = NAMES[shared]
        return (f"{text}, own final path" if own else text), (100.0 if "%" in text else 1.0)
    kind, _, rest = name.partition("_")
    if kind == "slope":
        said = phrase(rest, terms)
        return f"{said.noun} [{said.unit[0]}]", said.unit[1]
    which, _, summary = rest.rpartition("_")
    return f"residual of the {component(which, terms)}, {SUMMARIES[summary]}", 1.0


def shown(trust: Trust) -> list[Row]:
    """The rows that matter: those objected to, furthest from their twins first, then the rest of the headline ones."""
    objected = () if trust.blame is None else trust.blame.objected
    order = {key: i for i, key in enumerate(_by_distance(trust))}
    outside = sorted((r for r in trust.rows if _key(r) in objected), key=lambda r: order[_key(r)])
    rest = [r for r in trust.rows if _key(r) not in objected and (r.twins or not trust.twins)]
    always = list(NAMES)[:HEADLINE]
    if not any(r.statistic.startswith("filter_smoother") for r in trust.rows):
        always += [name.replace("filter_smoother", OWN) for name in always]
    headline = [r for r in rest if r.statistic in always]
    room = MOST - len(headline) - sum(r.statistic in always for r in outside)
    more = [r for r in outside if r.statistic not in always][: max(room, 0)]
    telling = [] if trust.twins else [r for r in rest if r not in headline and _stands_out(r)]
    kept = [r for r in outside if r.statistic in always or r in more]
    return [*kept, *headline, *telling][:MOST]


def _key(row: Row) -> tuple[str, str]:
    return row.estimator, row.statistic


def _stands_out(row: Row) -> bool:
    """Without twins: means of residuals, and slopes beyond their standard error."""
    m = row.measured
    if row.statistic.startswith("slope_"):
        return bool(m.se > 0.0 and abs(m.value) > STANDS_OUT * m.se)
    return row.statistic.startswith("residual_") and row.statistic.endswith("_mean")


def _drawn(trust: Trust, row: Row) -> Array:
    """The statistic in the twins (N,), those that have it."""
    values = [s.measured[_key(row)].value for s in trust.twins if _key(row) in s.measured]
    found = np.array([v for v in values if math.isfinite(v)], float)
    return found


def _by_distance(trust: Trust) -> list[tuple[str, str]]:
    """All statistics, furthest from their twins' median (in their spread on that side) first."""
    far = {}
    for row in trust.rows:
        drawn = _drawn(trust, row)
        own = battery.standardized(np.array([row.measured.value]), drawn[:, None])[0] if len(drawn) else np.zeros(1)
        far[_key(row)] = abs(float(own[0]))
    return sorted(far, key=lambda key: -far[key])


def trust_frame(trust: Trust, *, terms: Terms) -> pd.DataFrame:
    """The rows of `shown` to read; numbers to three digits each, as their units differ."""
    made = []
    for row in shown(trust):
        text, factor = statistic_words(row.statistic, terms)
        drawn = factor * _drawn(trust, row)
        low, middle, high = np.quantile(drawn, [0.05, 0.5, 0.95]).tolist() if len(drawn) else (math.nan,) * 3
        made.append({
            "estimator": row.estimator,
            "statistic": text,
            "value": _value(factor * row.measured.value, factor * row.measured.se),
            "expected": _text(factor * row.measured.expected),
            "twins' median": _text(middle),
            "twins, 5 to 95 %": f"{_text(low)} to {_text(high)}" if len(drawn) else None,
            "p": _text(row.p, 2),
            "family-wise p": _text(row.p_family, 2),
        })  # fmt: skip
    return drop_blank_columns(pd.DataFrame(made, dtype=object))


def _value(value: float, error: float) -> str | None:
    """A number, with its standard error to two digits and the same decimals where it has one."""
    if not (math.isfinite(value) and math.isfinite(error) and error > 0.0):
        return _text(value)
    places = max(1 - math.floor(math.log10(error)), 0)
    return f"{value:.{places}f} ± {error:.{places}f}".replace("-", "−")


def _text(value: float, digits: int = 3) -> str | None:
    return number(value, digits).replace("-", "−") if math.isfinite(value) else None


HEADING = "Trust without ground truth"
CAPTION = "What the log says of itself, no truth used."
FINE = FinePrint(
    "What a log says of itself",
    "P_f and P_s are the covariances of the online and of the smoothed pose, d is their difference. All statistics:"
    " trust.csv; definitions: docs/verdicts.md.",
)
MORE = "More of what the log says of itself"
WITH_TWINS = " First what lies outside what the twins show (family-wise p at most 0.05)."
WITHOUT = " Standard errors are those of the noise as stated; without twins there is no p value."


def of_trial(trial: Trial, said: Sequence[Trust]) -> list[Trust]:
    """What is told of a log and task: all ways of association that have twins, else the first one alone."""
    own = [t for t in said if (t.log, t.task) == (trial.log.name, trial.task) and trial.beside is None]
    order = associations(trial.runs)
    own.sort(key=lambda t: order.index(t.association) if t.association in order else len(order))
    asked = [t for t in own if t.twins or any(n.startswith("no twins") for n in t.notes)]
    return asked or [t for t in own if online(t)][:1]


def first_said(trial: Trial, said: Sequence[Trust]) -> str:
    """For the first page: the first way of association; with truth only what twins say."""
    for trust in of_trial(trial, said)[:1]:
        measured = trial.log.truth.known_poses > 0
        if trust.blame is not None or not measured:
            return first_words(trust, terms=terms_of(trial.log.recorded), measured=measured)
    return ""


def trust_section(
    folder: Path, options: Options, trial: Trial, pictures: Sequence[Picture], said: Sequence[Trust]
) -> list[Section]:
    """The words, the table and the figure of a log and task; none where nothing is known."""
    told = of_trial(trial, said)
    terms, labels = terms_of(trial.log.recorded), trial.log.has_labels
    blocks: list[Block] = []
    for trust in told:
        if len(told) > 1 or len(associations(trial.runs)) > 1:
            blocks.append(f"With association `{trust.association}`:")
        front, *more = folded(paragraphs(trust, terms=terms, labels=labels), MORE) or ("",)
        blocks += [front] if front else []
        if shown(trust):
            caption = f"{trial.log.name}, {trial.task}, association {trust.association}. {CAPTION}"
            caption += WITH_TWINS if trust.twins else WITHOUT
            name, frame = stem(trial, f"trust-{trust.association}"), trust_frame(trust, terms=terms)
            blocks.append(written_table(frame, folder, name, caption, options, fine=FINE))
        blocks += more
    blocks += [p for p in pictures if p.stem == stem(trial, FILTER_SMOOTHER)]
    return [Section(f"{HEADING}: {trial.log.name}, {trial.task}", tuple(blocks), 3)] if blocks else []
