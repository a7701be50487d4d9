"""What a log says about itself in words: a few sentences for the first page, a list for its section."""

from __future__ import annotations

from collections.abc import Sequence

from eval.referee.attribution import NOTHING, Finding
from eval.report.trust.findings import advice, done_words, sentences
from eval.report.trust.phrases import Terms
from eval.report.trust.said import (
    HINT,
    apart,
    culprit,
    deciding_on_twins,
    length,
    median_before_and_after,
    nees_on_twins,
    online,
    outside,
    power,
    quadratic,
    standing_out,
)
from eval.studies.trusted import Blame, Trust

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
