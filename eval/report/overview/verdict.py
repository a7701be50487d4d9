"""Which estimator to trust on a log, and what its claims are worth: a word each, with a symbol and a colour."""

from __future__ import annotations

import math

from eval.page.document import Mark
from eval.page.numbers import number
from eval.referee.attribution import NOTHING
from eval.referee.consistency import CONSISTENT, OVERCONFIDENT
from eval.report.answer import LINEARIZATION
from eval.report.deciding import SAME
from eval.report.overview.cause import cause_word
from eval.report.overview.facts import Facts
from eval.report.rows import Row, value_of
from eval.report.statements import nis_verdict
from eval.studies.trusted import Trust

CAUSE = "cause: "
"""Before the word that a log without truth gets."""
SMOOTHER, EITHER, FILTER, NEITHER = "smoother", "either", "filter", "neither"


def whom_to_trust(f: Facts) -> Mark:
    """The estimator to trust for the path; of a log without truth what is to blame."""
    if f.filtered is None and f.smoothed is None:
        return Mark("nothing ran", "none")
    if not f.sound(f.filtered) or not f.sound(f.smoothed):
        return _one_left(f)
    if not f.measured:
        return cause_mark(f)
    a, b = f.errors
    if not (math.isfinite(a) and math.isfinite(b)):
        return Mark("unknown", "none", "no errors to compare")
    if b < a * (1.0 - SAME):
        return Mark(SMOOTHER, "good", _online(f, a))
    if b <= a * (1.0 + SAME):
        return Mark(EITHER, "good", "equal in accuracy")
    return Mark(FILTER, "fair", "closer on this log: chance, or a noise model that does not fit")


def _online(f: Facts, rmse: float) -> str:
    """What the fair comparison at the same instants says."""
    online = math.nan if f.newest is None else value_of(f.newest, "rmse_position_m")
    if f.newest is None or not math.isfinite(online) or f.related:
        return "for the path after the fact"
    if abs(online - rmse) <= SAME * rmse:
        return "later data; online both are equal"
    if rmse > LINEARIZATION * online:
        return f"also online ({f.newest['estimator']} {number(online)} m)"
    return f"online {f.newest['estimator']} {number(online)} m"


def _one_left(f: Facts) -> Mark:
    """Where one of the two did not run, or is not to be believed."""
    gone = [r for r in (f.filtered, f.smoothed) if r is not None and not f.sound(r)]
    why = "; ".join(f"{r['estimator']} {_fate(r)}" for r in gone)
    if f.sound(f.smoothed):
        return Mark(SMOOTHER, "fair", why or f"only {f.smoothed['estimator']} ran" if f.smoothed else why)
    if f.sound(f.filtered) and f.filtered is not None:
        if not gone:
            return Mark(f"only {f.filtered['estimator']}", "none", "no smoother ran")
        return Mark(FILTER, "fair", why)
    return Mark(NEITHER, "bad", why)


def _fate(row: Row) -> str:
    if row["status"] != "ok":
        return str(row["status"])
    frame = value_of(row, "lost_frame")
    return f"lost from frame {frame:.0f}" if math.isfinite(frame) else "used next to no reading"


def cause_mark(f: Facts) -> Mark:
    """Of a log without truth: the cause, from its twins or as a hint."""
    if f.trust is None:
        return Mark("unknown", "none", "no truth, and no smoother to compare with")
    word = cause_word(f.trust)
    if word == NOTHING:
        return Mark(f"{CAUSE}{word}", "good", f"{_basis(f.trust)}: trust the smoother")
    return Mark(f"{CAUSE}{word}", "fair", f"{_basis(f.trust)}: mind all sigmas; the smoother's path")


def _basis(trust: Trust) -> str:
    return "a hint, without twins" if trust.blame is None else f"from {len(trust.twins)} twins"


def claims(f: Facts) -> Mark | None:
    """Whether the filter's innovations are as large as it claims; None where none were formed."""
    row = f.filtered if f.filtered is not None else f.smoothed
    if row is None or row["status"] not in ("ok", "implausible"):
        return None
    nis, lower, upper = (value_of(row, c) for c in ("nis", "nis_lower", "nis_upper"))
    if not all(map(math.isfinite, (nis, lower, upper))):
        return None
    word = nis_verdict(nis, lower, upper)
    tone = "good" if word == CONSISTENT else "bad" if word == OVERCONFIDENT else "fair"
    return Mark(word, tone, f"NIS {number(nis)}")
