"""The facts of the corridor lab's six questions; words: `templates/labs/corridor`."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from eval.referee.score import Scores
from wings.labs.corridor import (
    BLIND,
    JCBB,
    METHODS,
    NAMES,
    ODOMETRY,
    PEOPLE,
    Judged,
    Lab,
    judged,
    maintained_pair,
    reach,
    true_against_stated,
)

WORSE = 1.5  # an error this many times another one is called worse, below it comparable


@dataclass(frozen=True)
class Answers:
    """Every run that was looked at, and the facts of each question by its name.

    Facts are runs by the part they play (None: it did not reach its end), what follows from them, and `lack`, whether
    a run that the question needs is missing; `lost`: names of others that are.
    """

    runs: tuple[Judged, ...]
    of: dict[str, dict[str, Any]]

    def rows(self, condition: tuple[bool, bool, bool], methods: Iterable[str]) -> list[Judged]:
        """The runs of a condition (people, odometry, maintained) with some methods, in their order."""
        of = {r.association: r for r in self.runs if (r.people, r.odometry, r.maintained) == condition}
        return [of[m] for m in methods if m in of]


def worse(a: Judged | None, b: Judged | None) -> bool:
    """Whether both reached their end, and the path of `a` is clearly the worse one."""
    return a is not None and b is not None and a.rmse > WORSE * b.rmse


def answers(lab: Lab, scores: Scores) -> Answers:
    """All that the lab's questions need."""

    def runs_of(switches: tuple[bool, bool], *, maintained: bool) -> dict[str, Judged]:
        found = [lab.find(switches, method, maintained=maintained) for method in METHODS]
        runs = {s.run.association: s.run for s in found if s is not None}
        return judged((lab.maintained if maintained else lab.trials)[switches], runs.values(), scores)

    plain = {c: runs_of(c, maintained=False) for c in lab.trials}
    kept = {c: runs_of(c, maintained=True) for c in lab.maintained}

    def of(switches: tuple[bool, bool], method: str) -> Judged | None:
        names, runs = JCBB if method == "jcbb" else (method,), plain.get(switches, {})
        return next((runs[name] for name in names if name in runs), None)

    three = {m: of(ODOMETRY, m) for m in ("nn", "singles", "jcbb")}
    busy = next((s for s in (PEOPLE, ODOMETRY) if of(s, "jcbb") is not None), PEOPLE)
    runs = tuple(r for by_method in (*plain.values(), *kept.values()) for r in by_method.values())
    return Answers(
        runs,
        {
            "nn": _nearest_neighbour(three["nn"], of(ODOMETRY, "known")),
            "singles": {**three, "lost": tuple(NAMES[m] for m, r in three.items() if r is None), "lack": False},
            "people": _people({m: (of(ODOMETRY, m), of(PEOPLE, m)) for m in ("nn", "singles")}),
            "jcbb": _joint(*(of(busy, m) for m in ("jcbb", "nn", "singles", "known"))),
            "blind": _blind(lab, of(BLIND, "known"), of(BLIND, "jcbb"), tuple(plain.get(BLIND, {}).values()), scores),
            "maintenance": _maintenance(lab, scores),
        },
    )


def _nearest_neighbour(nn: Judged | None, known: Judged | None) -> dict[str, Any]:
    """`explained`: whether the error of the pose is large enough to make another landmark the nearest one."""
    explained = nn is not None and nn.p.off >= 0.5 * nn.p.apart
    return {"nn": nn, "known": known, "explained": explained, "costly": worse(nn, known), "lack": None in (nn, known)}


def _people(both: dict[str, tuple[Judged | None, Judged | None]]) -> dict[str, Any]:
    """`broken`: names of those whose path is worse with people; of pairings of people those with `ghosts`, `points`."""
    pairs = tuple((a, b) for a, b in both.values() if a is not None and b is not None)
    ghosts = sum(b.p.clutter_again for _, b in pairs)
    return {
        "pairs": pairs,
        "lost": tuple(NAMES[m] for m, found in both.items() if None in found),
        "broken": tuple(b.name for a, b in pairs if worse(b, a)),
        "ghosts": ghosts,
        "points": sum(b.p.clutter_paired for _, b in pairs) - ghosts,
        "lack": not pairs,
    }


def _joint(jcbb: Judged | None, nn: Judged | None, singles: Judged | None, known: Judged | None) -> dict[str, Any]:
    """`better`: whether JCBB decides and estimates better than NN; `close`: about as well as with labels."""
    lack = jcbb is None or nn is None
    return {
        "jcbb": jcbb,
        "nn": nn,
        "singles": singles,
        "known": known,
        "runs": tuple(r for r in (jcbb, nn, singles, known) if r is not None),
        "better": jcbb is not None and nn is not None and jcbb.p.wrong < nn.p.wrong and jcbb.rmse < nn.rmse,
        "close": None not in (jcbb, known) and not worse(jcbb, known),
        "lack": lack,
    }


def _blind(
    lab: Lab, known: Judged | None, jcbb: Judged | None, runs: tuple[Judged, ...], scores: Scores
) -> dict[str, Any]:
    """`smoother`: batch with labels, if plausible; `suffices`: whether it is usable where the filter is worse."""
    trial = lab.trials.get(BLIND)
    batch = None if trial is None else trial.find("batch")
    smoother = judged(trial, [batch], scores)["known"] if trial and batch and batch.flaw is None else None
    return {
        "known": known,
        "jcbb": jcbb,
        "smoother": smoother,
        "motion": None if trial is None else true_against_stated(trial.log),
        "reach": math.nan if trial is None or trial.log.truth.pose is None else reach(trial.log.truth.pose),
        "runs": runs,
        "usable": tuple(r.association for r in runs if r.usable),
        "best": min(runs, key=lambda r: r.rmse, default=None),
        "others": tuple(r for r in runs if r.association in ("nn", "singles", "jcbb-hindsight")),
        "suffices": smoother is not None and smoother.usable and worse(known, smoother),
        "lack": known is None and jcbb is None,
    }


def _maintenance(lab: Lab, scores: Scores) -> dict[str, Any]:
    pair = maintained_pair(lab) or ()
    plain, kept = (judged(s.trial, [s.run], scores)[s.run.association] for s in pair) if pair else (None, None)
    return {"plain": plain, "kept": kept, "better": worse(plain, kept), "worse": worse(kept, plain), "lack": not pair}
