"""The headline of a log and task, decided in one place from numbers: whom to trust, and what speaks against it.

No tick stands where a number of the same report objects: NEES, wrong pairings, a lost or implausible estimate. Ground
truth speaks before anything that is inferred without it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

NEES_LIMIT = 9.0
"""Mean pose NEES (expected 3) of one run that is overconfident, however its frames are correlated: a chi-square
variable of 3 degrees of freedom exceeds it in 3 % of logs."""
NEES_MARGIN = 1.25
"""Times the expectation, below which the lower bound of one log's interval is no objection: 95 % intervals of one log
cover 89 % (docs/verdicts.md)."""
NEES_EXPECTED = 3.0
WRONG_LIMIT = 0.05
"""Share of wrong pairings. `jcbb` has 3 % on worlds that are as stated, and one in ten ruins a path."""
FAR_NIS = 2.0
"""NIS of a smoother over its expectation, beside a lost filter: its pairings are those of the filter."""
CHANCE = 0.05
CLEAR = 1.1
"""Ratio of two RMSEs that is a difference where no interval can be formed."""


class Verdict(StrEnum):
    """The estimator to trust for the path, or why none is named."""

    SMOOTHER = "smoother"
    EITHER = "either"
    FILTER = "filter"
    NEITHER = "neither"
    ONLY = "only one ran"
    NOTHING = "nothing ran"
    CAUSE = "cause"
    UNKNOWN = "unknown"


class Objection(StrEnum):
    """What speaks against an estimate, the strongest first."""

    MAP = "map"
    CONVENTION = "convention"
    STOPPED = "stopped"
    IMPLAUSIBLE = "implausible"
    IDLE = "idle"
    LOST = "lost"
    NEES = "nees"
    ASSOCIATION = "association"
    NIS = "nis"
    CAUSE = "cause"


@dataclass(frozen=True)
class Objected:
    """An objection to an estimator with the number behind it (frame, NEES, share of wrong pairings, NIS per dof).

    `MAP`, `CONVENTION`, `CAUSE` are to the log: the estimator is blank, and the number of `CAUSE` the least family-wise
    p.
    """

    objection: Objection
    estimator: str
    value: float = math.nan


@dataclass(frozen=True)
class Claim:
    """What is known of an estimator on a log, as its tables show it; NaN: unknown.

    nees_lower: lower bound of the mean NEES, unknown in SLAM, where the error of the frame is one draw; wrong: share of
    wrong pairings; nis: over its expectation; overconfident: by the bounds of NIS.
    """

    estimator: str
    status: str = "ok"
    lost_frame: float = math.nan
    idle: bool = False
    nees: float = math.nan
    nees_lower: float = math.nan
    wrong: float = math.nan
    nis: float = math.nan
    overconfident: bool = False


@dataclass(frozen=True)
class Preference:
    """Which of two paths is nearer to the truth: errors of filter and smoother [m], p of no difference (NaN: none)."""

    filter: float = math.nan
    smoother: float = math.nan
    p: float = math.nan


@dataclass(frozen=True)
class Headline:
    """Whom to trust, and the objections to that, the strongest first."""

    verdict: Verdict
    objections: tuple[Objected, ...] = ()

    @property
    def sound(self) -> bool:
        """Whether a tick may stand there."""
        return self.verdict in (Verdict.SMOOTHER, Verdict.EITHER) and not self.objections


def overconfident(nees: float, lower: float = math.nan) -> bool:
    """Whether the mean pose NEES of one log is too large; `lower`: bound of its interval, unknown in SLAM."""
    return nees > NEES_LIMIT or lower > NEES_MARGIN * NEES_EXPECTED


def objections(claim: Claim, measured: bool) -> tuple[Objected, ...]:
    """What speaks against an estimate, the strongest first; `measured`: whether there is ground truth.

    With ground truth nobody is lost whose NEES says that it is where it claims to be, and NEES speaks before NIS.
    """
    known = measured and math.isfinite(claim.nees)
    found = []
    if claim.status not in ("ok", Objection.IMPLAUSIBLE.value):
        found.append(Objected(Objection.STOPPED, claim.estimator))
    if claim.status == Objection.IMPLAUSIBLE.value:
        found.append(Objected(Objection.IMPLAUSIBLE, claim.estimator))
    if math.isfinite(claim.lost_frame) and not (known and claim.nees <= NEES_LIMIT):
        found.append(Objected(Objection.LOST, claim.estimator, claim.lost_frame))
    elif claim.idle:
        found.append(Objected(Objection.IDLE, claim.estimator))
    if found:  # its numbers are of no use then
        return tuple(found)
    if known and overconfident(claim.nees, claim.nees_lower):
        found.append(Objected(Objection.NEES, claim.estimator, claim.nees))
    if claim.wrong > WRONG_LIMIT:
        found.append(Objected(Objection.ASSOCIATION, claim.estimator, claim.wrong))
    if not known and claim.overconfident:
        found.append(Objected(Objection.NIS, claim.estimator, claim.nis))
    return tuple(found)


UNUSABLE = (Objection.STOPPED, Objection.IMPLAUSIBLE, Objection.IDLE, Objection.LOST)


def usable(claim: Claim | None, measured: bool) -> bool:
    """Whether an estimate reached the end, is plausible, not lost, and more than dead reckoning."""
    return claim is not None and not any(o.objection in UNUSABLE for o in objections(claim, measured))


def nearer(of: Preference) -> Verdict:
    """The estimator whose path is nearer to the truth; either where the difference may be chance."""
    if not (math.isfinite(of.filter) and math.isfinite(of.smoother)):
        return Verdict.UNKNOWN
    apart = of.p <= CHANCE if math.isfinite(of.p) else max(of.filter, of.smoother) > CLEAR * min(of.filter, of.smoother)
    if not apart or of.filter == of.smoother:
        return Verdict.EITHER
    return Verdict.SMOOTHER if of.smoother < of.filter else Verdict.FILTER


def headline(
    filtered: Claim | None,
    smoothed: Claim | None,
    preference: Preference,
    *,
    measured: bool,
    caused: bool = False,
    rejected: float = math.nan,
) -> Headline:
    """Whom to trust on a log and task; `caused`: without ground truth, a diagnosis names a cause instead.

    `rejected`: the diagnosis found a violated assumption, with this family-wise p (NaN: none found).
    """
    both = [c for c in (filtered, smoothed) if c is not None]
    good = usable(filtered, measured), usable(smoothed, measured)
    if not both:
        return Headline(Verdict.NOTHING)
    if filtered is not None and smoothed is not None and good == (False, True) and _follows(smoothed, measured):
        good = (False, False)
    if good == (False, True):
        verdict = Verdict.SMOOTHER
    elif good == (True, False):
        verdict = Verdict.ONLY if smoothed is None else Verdict.FILTER
    elif good == (False, False):
        verdict = Verdict.NEITHER
    elif not measured:
        verdict = Verdict.CAUSE if caused else Verdict.UNKNOWN
    else:
        verdict = nearer(preference)
    about = {Verdict.SMOOTHER: [smoothed], Verdict.FILTER: [filtered], Verdict.ONLY: [filtered]}.get(verdict, both)
    found = [o for c in about if c is not None for o in objections(c, measured)]
    if verdict is Verdict.SMOOTHER and filtered is not None:  # a tick would stand for it, too
        found += [o for o in objections(filtered, measured) if o.objection is Objection.NEES]
    if measured and verdict in (Verdict.SMOOTHER, Verdict.EITHER, Verdict.FILTER) and math.isfinite(rejected):
        found.append(Objected(Objection.CAUSE, "", rejected))
    order = list(Objection)
    return Headline(verdict, tuple(sorted(found, key=lambda o: order.index(o.objection))))


def _follows(smoothed: Claim, measured: bool) -> bool:
    """Whether a smoother stands on the pairings of a lost filter: its own numbers are far out."""
    if measured and math.isfinite(smoothed.nees):
        return smoothed.nees > NEES_LIMIT
    return smoothed.nis > FAR_NIS
