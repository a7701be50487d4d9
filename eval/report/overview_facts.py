"""What the first screen knows of a log and task: the filter and the smoother compared, and what failed.

Which estimator to trust on a log, and what its claims are worth: a word each, with a symbol and a colour.

Whose fault, in a word: odometry, sensor, estimator, associations, or nothing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from eval.referee.attribution import ASSOCIATIONS, ESTIMATOR, LEAST_FACTOR, NOTHING, Finding, component_of
from eval.referee.consistency import CONSISTENT, OVERCONFIDENT
from eval.referee.diagnostics import unused
from eval.referee.score import Scores, Trial
from eval.replay.settings import INCREMENTAL
from eval.report.answer import LINEARIZATION, chosen_association, nis_verdict, pick
from eval.report.deciding import SAME, extremes
from eval.report.page.document import Mark
from eval.report.page.tables import is_blank, number
from eval.report.rows import Row, filters_in, rows_of, smoothers_in, value_of
from eval.report.trust import of_trial
from eval.report.trust_facts import STANDS_OUT
from eval.studies.trusted import Blame, Trust


@dataclass(frozen=True)
class Facts:
    """Of one log and task.

    Attributes:
        trial: whose.
        rows: of metrics.csv.
        association: under which filter and smoother are compared, None: nothing decides.
        filtered, smoothed: their rows; None: none ran.
        newest: the online row of a smoother that steps, plausible.
        errors: position error [m] of both: RMSE, or with reference relations alone the mean of theirs; NaN: unknown.
        related: whether the errors are those of relations.
        decided: best and worst way of deciding, rows of association.csv.
        trust: what the log says of itself; None: nothing.
        unused: runs that paired next to nothing, (estimator, association).
    """

    trial: Trial
    rows: tuple[Row, ...]
    association: str | None
    filtered: Row | None
    smoothed: Row | None
    newest: Row | None
    errors: tuple[float, float]
    related: bool
    decided: tuple[Row, Row] | None
    trust: Trust | None
    unused: frozenset[tuple[str, str]] = frozenset()

    def sound(self, row: Row | None) -> bool:
        """Whether a row is there, got to the end, is plausible and not lost, and more than dead reckoning."""
        return row is not None and sound(row) and (row["estimator"], row["association"]) not in self.unused

    @property
    def measured(self) -> bool:
        """Whether errors are known at all."""
        return self.trial.log.truth.known_poses > 0 or self.trial.log.truth.relations is not None

    @property
    def failed(self) -> list[Row]:
        """Rows of runs that did not get to the end, are implausible, lost or dead reckoning, at the last phase."""
        last = {(r["estimator"], r["association"]): r for r in self.rows}
        return [r for r in last.values() if not self.sound(r)]

    @property
    def runs(self) -> int:
        """How many there were."""
        return len({(r["estimator"], r["association"]) for r in self.rows})


def sound(row: Row) -> bool:
    """Whether a run got to the end, is plausible and not lost."""
    return row["status"] == "ok" and is_blank(row.get("lost_why"))


def facts_of(trial: Trial, scores: Scores, trust: Sequence[Trust]) -> Facts:
    """Everything the first screen needs of a log and task."""
    rows = [r for r in rows_of(scores.metrics) if (r["log"], r["task"]) == (trial.log.name, trial.task)]
    outcomes = [r for r in rows_of(scores.association) if (r["log"], r["task"]) == (trial.log.name, trial.task)]
    chosen = chosen_association(rows)
    own = [r for r in rows if r["association"] == chosen]
    filtered, smoothed = pick(own, filters_in(own), "online"), pick(own, smoothers_in(own), "final")
    newest = pick([r for r in own if sound(r)], INCREMENTAL, "online")
    errors = (_error(filtered), _error(smoothed))
    related = not any(map(math.isfinite, errors)) and trial.log.truth.relations is not None
    if related:
        errors = (_relation(filtered, scores), _relation(smoothed, scores))
    said = of_trial(trial, trust)[:1]
    return Facts(
        trial, tuple(rows), chosen, filtered, smoothed, newest, errors, related, extremes(rows, outcomes),
        said[0] if said else None, frozenset((r.estimator, r.association) for r in trial.runs if unused(r) is not None),
    )  # fmt: skip


def _error(row: Row | None) -> float:
    return math.nan if row is None else value_of(row, "rmse_position_m")


def _relation(row: Row | None, scores: Scores) -> float:
    """Mean error against the reference relations, all of them tied by row."""
    if row is None:
        return math.nan
    keys = ("log", "estimator", "association", "phase")
    for r in rows_of(scores.relations):
        if (r["tie"], r["subset"]) == ("row", "all") and all(r[k] == row[k] for k in keys):
            return value_of(r, "trans_mean_m")
    return math.nan


ODOMETRY, SENSOR = "odometry", "sensor"


def cause_word(trust: Trust) -> str:
    """What is to blame for what a log says of itself; without twins the largest residual effect hints at it."""
    return _judged(trust, trust.blame) if trust.blame is not None else _hinted(trust)


def _judged(trust: Trust, blame: Blame) -> str:
    """The cause of the verdict; of a noise, the side whose component it is of."""
    if blame.cause in (NOTHING, ASSOCIATIONS, ESTIMATOR):
        return blame.cause
    for found in blame.findings:
        if found.cause == blame.cause:
            return side(_component(found))
    # no finding has a name: the side of the residuals that lie furthest outside their twins
    sides = [side(name.split("_", 1)[1]) for _, name in blame.objected if name.startswith(("slope_", "residual_"))]
    return max(dict.fromkeys(sides), key=sides.count) if sides else _largest(_spreads(trust)) or SENSOR


def _component(found: Finding) -> str:
    return component_of(found.name) if found.kind == "systematic" else found.name


def side(component: str) -> str:
    """Which of the robot's two sources a component of increments or readings belongs to."""
    return ODOMETRY if component.startswith("odometry") else SENSOR


def _hinted(trust: Trust) -> str:
    """Without twins: the systematic error beyond `STANDS_OUT` standard errors, else a noise larger than stated."""
    slopes = {
        name.removeprefix("slope_"): abs(m.value) / m.se
        for (_, name), m in trust.real.measured.items()
        if name.startswith("slope_") and math.isfinite(m.value) and math.isfinite(m.se) and m.se > 0.0
    }
    if max(slopes.values(), default=0.0) > STANDS_OUT:
        return _largest(slopes)
    larger = {name: value for name, value in _spreads(trust).items() if value > LEAST_FACTOR}
    return _largest(larger) or NOTHING


def _spreads(trust: Trust) -> dict[str, float]:
    """Spread of the smoother's residuals in stated sigmas, by component."""
    return {
        name.removeprefix("residual_").removesuffix("_spread"): m.value
        for (_, name), m in trust.real.measured.items()
        if name.startswith("residual_") and name.endswith("_spread") and math.isfinite(m.value)
    }


def _largest(sizes: Mapping[str, float]) -> str:
    return side(max(sizes, key=lambda name: sizes[name])) if sizes else ""


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
