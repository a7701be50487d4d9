"""Assignment `corridor`: association methods and map maintenance, in frames of the corridor lab and drawn ones."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache

import numpy as np

from association import methods
from association.expectation import Expectation
from association.jcbb import jcbb, jcbb_first
from data.inputs import IntArray
from data.logs import open_log
from eval.checks import associations
from eval.checks.exactness import blocks_alone
from eval.replay.external.adapter import Loaded, Method, locked, text_of
from eval.replay.map_management import MAINTENANCE_FRAMES, Landmarks
from eval.replay.run import front_end
from eval.replay.settings import Setup
from wings.grade.parts import Mistakes, Part, Question, Seeds, asked

GATE = 0.99
SETUP = Setup(gate=GATE, new_gate=GATE, in_view=True)  # the lab has one gate
DRAWN = 10  # problems of a seed, of candidates so near to each other that methods differ
METHODS = {"nearest_neighbour": methods.nn, "singles": methods.singles, "joint_compatibility": jcbb}
OTHERS = {"jcbb": jcbb} | {name: getattr(methods, name) for name in ("nn", "ml", "singles", "gnn")}


@lru_cache(maxsize=2)
def driven(seeds: Seeds) -> tuple[list[tuple[str, int, Expectation]], list[Question]]:
    """Expectations of a filter's drives with people, decided by JCBB, and drawn ones; what the lab's rule was asked."""
    expected, leaving = list[tuple[str, int, Expectation]](), list[Question]()
    for seed in seeds.seeds:
        log = open_log(f"corridor:{seed}:people")

        def rule(frame: int, m: Landmarks, log_name: str = log.name) -> IntArray:
            leave: IntArray = m.number[(m.times == 1) & (frame - m.first > MAINTENANCE_FRAMES)]
            leaving.append(Question(log_name, frame, (frame, m), (leave,), idle=not len(leave)))
            return leave

        inputs = log.inputs(labels=False).without_map()
        front = front_end("ekf", "jcbb", inputs, replace(SETUP, maintain_by=text_of(rule, "maintenance")))
        for k in range(len(inputs)):
            frame = inputs.frame(k)
            front.move(frame)
            pairing = front.associate(frame)
            if (e := pairing.expectation) is not None:
                joint = e.joint(np.arange(len(e.number)))  # in numbers: the update changes the state
                kept = Expectation.from_arrays(e.z, e.z_hat, joint, e.R, e.residual, number=e.number)
                expected.append((log.name, k, locked(kept)))
            front.update(frame, pairing)
            front.tidy()
        drawn = (associations.problem(1000 * seed + k, spread=0.5 + 0.3 * k) for k in range(DRAWN))
        expected += [(f"drawn:{seed}", k, e) for k, e in enumerate(map(locked, drawn))]
    return expected, leaving


def _decisions(name: str) -> Part:
    method: Callable[[Expectation, float | None], IntArray] = METHODS[name]

    def questions(seeds: Seeds, _: str) -> Iterator[Question]:
        for log, k, e in driven(seeds)[0]:
            found = method(e, GATE)
            # a set whose first pairs alone are incompatible is left out by the classic search, and not by ours
            if method is not jcbb or (found >= 0).sum() == (jcbb_first(e, GATE) >= 0).sum():
                yield Question(log, k, (e, GATE), (found,), idle=bool((found < 0).all()))

    def mistakes(_: str) -> Mistakes:
        for other, f in OTHERS.items():
            yield other, lambda e, gate, f=f: (f(e, gate),)
        yield "joint_uncorrelated", lambda e, p: (method(replace(e, joint=lambda j: blocks_alone(e.joint(j))), p),)

    def checks(loaded: Loaded) -> Iterator[tuple[str, str]]:
        yield from ((f.check, f.sentence) for f in associations.run(Method(loaded), method) if not f.passed)

    return asked(name, questions, mistakes, checks)


def _rules(_: str) -> Mistakes:
    most = MAINTENANCE_FRAMES
    yield "seen_twice_too", lambda k, m: (m.number[k - m.first > most],)
    yield "too_early", lambda k, m: (m.number[(m.times == 1) & (k - m.first >= most)],)
    yield "too_late", lambda k, m: (m.number[(m.times == 1) & (k - m.first > most + 1)],)
    yield "age_ignored", lambda k, m: (m.number[m.times == 1],)
    yield "unseen_for_long", lambda k, m: (m.number[k - m.last > most],)


PARTS = (*map(_decisions, METHODS), asked("maintain", lambda seeds, _: driven(seeds)[1], _rules))
