"""The facts of the corridor lab's six questions; words: `templates/labs/corridor`."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from eval.referee.score import Scores
from wings.labs.corridor import (
    BLIND,
    NAMES,
    ODOMETRY,
    PEOPLE,
    THE_LABS,
    Judge,
    Judged,
    Lab,
    Motion,
    maintained_pair,
    reach,
    true_against_stated,
)

WORSE = 1.5  # an error this many times another one is called worse, below it comparable


@dataclass(frozen=True)
class NearestNeighbour:
    """NN against known association, without people."""

    nn: Judged | None
    known: Judged | None

    @property
    def lack(self) -> bool:
        """Whether a run that it needs is missing."""
        return self.nn is None or self.known is None

    @property
    def explained(self) -> bool:
        """Whether the error of the pose is large enough to make another landmark the nearest one."""
        return self.nn is not None and self.nn.p.off >= 0.5 * self.nn.p.apart

    @property
    def costly(self) -> bool:
        """Whether its path is worse than with known association."""
        return self.nn is not None and self.known is not None and self.nn.rmse > WORSE * self.known.rmse


@dataclass(frozen=True)
class Singles:
    """NN, SINGLES and JCBB without people; `lost`: names of those that did not get to their end."""

    nn: Judged | None
    singles: Judged | None
    jcbb: Judged | None
    lost: tuple[str, ...]
    lack = False  # it is answered from what there is


@dataclass(frozen=True)
class People:
    """NN and SINGLES, each (without people, with them); `lost`: names of those that were not run on both logs."""

    pairs: tuple[tuple[Judged, Judged], ...]
    lost: tuple[str, ...]

    @property
    def lack(self) -> bool:
        """Whether a run that it needs is missing."""
        return not self.pairs

    @property
    def broken(self) -> tuple[str, ...]:
        """Names of those whose path is worse with people."""
        return tuple(b.name for a, b in self.pairs if b.rmse > WORSE * a.rmse)

    @property
    def ghosts(self) -> int:
        """Pairings of people with landmarks initialized on people."""
        return sum(b.p.clutter_again for _, b in self.pairs)

    @property
    def points(self) -> int:
        """Pairings of people with landmarks of points."""
        return sum(b.p.clutter_paired for _, b in self.pairs) - self.ghosts


@dataclass(frozen=True)
class Joint:
    """JCBB against NN, SINGLES and known association on the same log: with people, or else without."""

    jcbb: Judged | None
    nn: Judged | None
    singles: Judged | None
    known: Judged | None

    @property
    def lack(self) -> bool:
        """Whether a run that it needs is missing."""
        return self.jcbb is None or self.nn is None

    @property
    def runs(self) -> tuple[Judged, ...]:
        """Those that are there."""
        return tuple(r for r in (self.jcbb, self.nn, self.singles, self.known) if r is not None)

    @property
    def better(self) -> bool:
        """Whether JCBB decides and estimates better than NN."""
        a, b = self.jcbb, self.nn
        return a is not None and b is not None and a.p.wrong < b.p.wrong and a.rmse < b.rmse

    @property
    def close(self) -> bool:
        """Whether JCBB's path is about as good as with known association."""
        return self.jcbb is not None and self.known is not None and self.jcbb.rmse <= WORSE * self.known.rmse


@dataclass(frozen=True)
class Blind:
    """What happens when the wheels are not read."""

    known: Judged | None  # known, jcbb: filters with these
    jcbb: Judged | None
    smoother: Judged | None  # batch with known association, if its result is plausible
    motion: Motion | None  # true against stated motions
    reach: float  # m from the start in truth, at most
    runs: tuple[Judged, ...]  # with each of `METHODS` that reached its end

    @property
    def lack(self) -> bool:
        """Whether a run that it needs is missing."""
        return self.known is None and self.jcbb is None

    @property
    def usable(self) -> tuple[str, ...]:
        """Association methods with a usable path."""
        return tuple(r.association for r in self.runs if r.usable)

    @property
    def best(self) -> Judged | None:
        """The one with the least error."""
        return min(self.runs, key=lambda r: r.rmse, default=None)

    @property
    def others(self) -> tuple[Judged, ...]:
        """Those that the paragraph has not named yet."""
        return tuple(r for r in self.runs if r.association in ("nn", "singles", "jcbb-hindsight"))

    @property
    def suffices(self) -> bool:
        """Whether a smoother's path is usable where the filter with the same pairings is worse."""
        a, b = self.known, self.smoother
        return a is not None and b is not None and b.usable and b.errors["final"] < a.rmse / WORSE


@dataclass(frozen=True)
class Maintenance:
    """A run without and with map maintenance."""

    plain: Judged | None
    kept: Judged | None

    @property
    def lack(self) -> bool:
        """Whether a run that it needs is missing."""
        return self.plain is None or self.kept is None

    @property
    def better(self) -> bool:
        """Whether the path with it is clearly better."""
        return self.plain is not None and self.kept is not None and self.kept.rmse * WORSE < self.plain.rmse

    @property
    def worse(self) -> bool:
        """Whether it is clearly worse."""
        return self.plain is not None and self.kept is not None and self.kept.rmse > WORSE * self.plain.rmse


@dataclass(frozen=True)
class Answers:
    """The facts of all six questions, and every run that was looked at."""

    runs: tuple[Judged, ...]
    nn: NearestNeighbour
    singles: Singles
    people: People
    jcbb: Joint
    blind: Blind
    maintenance: Maintenance

    def rows(self, condition: tuple[bool, bool, bool], methods: Iterable[str]) -> list[Judged]:
        """The runs of a condition (people, odometry, maintained) with some methods, in their order."""
        of = {r.association: r for r in self.runs if (r.people, r.odometry, r.maintained) == condition}
        return [of[m] for m in methods if m in of]


def answers(lab: Lab, scores: Scores) -> Answers:
    """All that the lab's questions need."""
    judge = Judge(scores)
    plain = {c: judge.runs(t) for c, t in lab.trials.items()}
    kept = {c: judge.runs(t) for c, t in lab.maintained.items()}

    def of(switches: tuple[bool, bool], method: str) -> Judged | None:
        runs = plain.get(switches, {})
        return next((runs[name] for name in THE_LABS.get(method, (method,)) if name in runs), None)

    three = {m: of(ODOMETRY, m) for m in ("nn", "singles", "jcbb")}
    both = {m: (of(ODOMETRY, m), of(PEOPLE, m)) for m in ("nn", "singles")}
    busy = next((s for s in (PEOPLE, ODOMETRY) if of(s, "jcbb") is not None), PEOPLE)
    blind, pair = lab.trials.get(BLIND), maintained_pair(lab)
    truth, smoother = (None, None) if blind is None else (blind.log.truth.pose, blind.find("batch"))
    return Answers(
        tuple(r for runs in (*plain.values(), *kept.values()) for r in runs.values()),
        NearestNeighbour(of(ODOMETRY, "nn"), of(ODOMETRY, "known")),
        Singles(**three, lost=tuple(NAMES[m] for m, r in three.items() if r is None)),
        People(
            tuple((a, b) for a, b in both.values() if a is not None and b is not None),
            tuple(NAMES[m] for m, found in both.items() if None in found),
        ),
        Joint(of(busy, "jcbb"), of(busy, "nn"), of(busy, "singles"), of(busy, "known")),
        Blind(
            of(BLIND, "known"),
            of(BLIND, "jcbb"),
            smoother=judge.look(blind, smoother) if blind and smoother and smoother.flaw is None else None,
            motion=None if blind is None else true_against_stated(blind.log),
            reach=math.nan if truth is None else reach(truth),
            runs=tuple(plain.get(BLIND, {}).values()),
        ),
        Maintenance(*((None, None) if pair is None else (judge.look(*shown) for shown in pair))),
    )
