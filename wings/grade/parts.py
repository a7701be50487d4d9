"""A part of an assignment: questions to a function of the student's, independent of each other, with right answers."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from data.se2 import wrap_angle
from eval.replay.external.adapter import ForeignError, Loaded, array, call, whole

CLOSE = 1e-8  # largest difference of a right number, over the largest number of its array
LOOKED_AT, EXPLAINED = 12, 0.8  # wrong answers, and the share of them that a known mistake must explain
Answer = tuple[Any, ...]  # arrays: numbers, or whole numbers of landmarks


class Seeds(NamedTuple):
    """What the questions are drawn from: seeds, and a folder of recordings instead of simulated ones, if any."""

    seeds: tuple[int, ...]
    data: Path | None = None


class Question(NamedTuple):
    """Arguments of the student's function and what it should return; `idle`: to do nothing would be right.

    A right answer to an idle one earns nothing, and a wrong one costs as much as any.
    """

    log: str
    frame: int
    given: tuple[Any, ...]
    expected: Answer
    idle: bool = False


class First(NamedTuple):
    """The first wrong answer; `got` is empty where there was none, for the reason `why`."""

    log: str
    frame: int
    what: str
    expected: Any
    got: Any
    why: str = ""


@dataclass(frozen=True)
class Outcome:
    """What became of a part: right answers of so many, the first wrong one, names of likely causes with details."""

    part: str
    right: int = 0
    of: int = 0
    first: First | None = None
    causes: dict[str, str] = field(default_factory=dict)
    stopped: str = ""

    @property
    def flawless(self) -> bool:
        """Whether nothing is wrong."""
        return 0 < self.of == self.right and not (self.causes or self.stopped)


class Part(NamedTuple):
    """A part by name: the student's function or class, its questions, and how answers become an outcome."""

    name: str
    attribute: str
    prepare: Callable[[Seeds], Any]
    grade: Callable[[Loaded, Any], Outcome]


def arrays(who: str, expected: Answer, value: Any) -> Answer:
    """What was returned, in the shapes of what is expected: one array, or a tuple of them."""
    parts, what = [value] if len(expected) == 1 else value, "what it returned"
    if not isinstance(parts, list | tuple) or len(parts) != len(expected):
        raise ForeignError(f"{who}: {len(expected)} arrays are needed")
    return tuple(
        array(who, v, e.shape, what) if e.dtype.kind == "f" else whole(who, np.atleast_1d(v), np.size(v), what)
        for v, e in zip(parts, expected, strict=True)
    )


def same(expected: Answer, got: Answer) -> bool:
    """Whether decisions are equal, and numbers but for rounding; the heading of a pose (3,) counts modulo 2 pi."""
    for ours, theirs in zip(expected, got, strict=True):
        if ours.shape != theirs.shape or (ours.dtype.kind != "f" and not np.array_equal(ours, theirs)):
            return False
        off = np.asarray(theirs - ours, float)
        if ours.shape == (3,):
            off[2] = wrap_angle(float(off[2]))
        if not np.abs(off).max(initial=0.0) <= CLOSE * np.abs(ours).max(initial=0.0):
            return False
    return True


Mistakes = Iterable[tuple[str, Callable[..., Answer]]]
"""Names of known mistakes, each with what a reference with it returns for the same arguments."""


def asked(
    name: str, questions: Callable[[Seeds, str], Iterable[Question]],
    mistakes: Callable[[str], Mistakes] = lambda _: (),
    checks: Callable[[Loaded], Iterable[tuple[str, str]]] = lambda _: (),
) -> Part:  # fmt: skip
    """A part whose function gets each question's arguments, copied; `checks`: names and words of failed ones."""

    def grade(loaded: Loaded, prepared: Sequence[Question]) -> Outcome:
        right, first, few, shares = 0, None, list[tuple[Question, Answer]](), dict[str, float]()
        for q in prepared:
            got: Answer = ()
            why = ""
            try:
                got = arrays(name, q.expected, call(name, loaded.thing, *_copied(q.given)))
            except ForeignError as stop:
                why = str(stop)
            if not why and same(q.expected, got):
                right += not q.idle
                continue
            right -= q.idle
            few += [] if why or len(few) == LOOKED_AT else [(q, got)]
            ours, theirs = ([np.round(a, 9).tolist() for a in answer] for answer in (q.expected, got))
            first = first or First(q.log, q.frame, name, ours, theirs, why)
        for known, answer in mistakes(name) if few else ():
            share = sum(same(answer(*_copied(q.given)), got) for q, got in few) / len(few)
            shares[known] = max(share, shares.get(known, 0.0))
        best = max(shares, key=lambda known: shares[known], default="")
        causes = dict.fromkeys([best] * (shares.get(best, 0.0) >= EXPLAINED), "")
        causes |= dict(checks(loaded) if right > 0 else ())
        return Outcome(name, max(right, 0), sum(not q.idle for q in prepared), first, causes)

    return Part(name, name, lambda seeds: list(questions(seeds, name)), grade)


def _copied(given: tuple[Any, ...]) -> list[Any]:
    return [value.copy() if isinstance(value, np.ndarray) else value for value in given]
