"""The two sentences at the top, what was compared and what to conclude, and the attribution of logs without truth."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from data.terminal.words import counted
from eval.page.document import Block, Section, folded
from eval.page.numbers import number
from eval.referee.paths.given import GivenRun
from eval.report.overview.facts import Facts
from eval.report.overview.verdict import CAUSE, EITHER, FILTER, NEITHER, SMOOTHER, whom_to_trust
from eval.report.trust.phrases import terms_of
from eval.report.trust.sections import HEADING
from eval.report.trust.words import first_words

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
    given = len({r.estimator for f in facts for r in f.trial.runs if isinstance(r, GivenRun)})
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
