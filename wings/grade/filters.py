"""Assignment `filter`: an EKF as a class, for localization and SLAM, against the exact one frame by frame."""

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from association.decide import known_decisions
from data.inputs import FrameObservations, Inputs
from data.worlds.arena import Arena, simulate
from eval.checks import exactness as exact, worlds
from eval.replay.external.adapter import Loaded
from wings.grade.parts import First, Outcome, Part

Q = exact.Quantity
DRIVING = Arena(frames=25, landmarks=12, side=16.0)
STANDING = replace(DRIVING, frames=8, speed=0.0, swing=0.0, landmarks=30, sigma_bearing=0.2)  # some straight behind
NOTHING = FrameObservations(np.empty((0, 2)), np.empty((0, 2, 2)))
POSE = (Q.POSE, Q.COVARIANCE)
EXPECTED = {Q.EXPECTED: "z_hat", Q.JOINT: "joint", Q.MARGINALS: "blocks", Q.CANDIDATES: "number", Q.NOISE: "R",
            Q.INNOVATIONS: "innovations"}  # fmt: skip
MAP = {Q.LANDMARKS: "xy", Q.LANDMARK_COVARIANCE: "blocks"}
Drive = tuple[str, Inputs, exact.Frames, list[exact.State]]  # name, inputs, frames with decisions, the exact filter


def drive(seed: int, what: str) -> Drive:
    """An arena: without observations (`prediction`), of a standing robot, or as it is."""
    standing = what in ("expectation", "correction")
    inputs = simulate(STANDING if standing else DRIVING, seed).inputs(labels=True)
    inputs = inputs.without_map() if what == "slam" else inputs
    decisions, frames = known_decisions(inputs)[0], []
    for k in range(len(inputs)):
        frame, decided = inputs.frame(k), decisions[inputs.start[k] : inputs.start[k + 1]]
        if what == "prediction":
            frame, decided = frame._replace(observations=NOTHING), decided[:0]
        frames.append((frame._replace(increment=None) if standing else frame, decided))
    return f"arena:{seed}, {what}", inputs, frames, exact.states_of(frames, inputs, exact.Rules())


def _part(name: str, attribute: str, quantities: tuple[exact.Quantity, ...]) -> Part:
    def grade(loaded: Loaded, drives: list[Drive]) -> Outcome:
        right, first, allowed = 0, None, {q: 0.0 if q in exact.COUNTED else exact.NEARLY for q in quantities}
        for log, inputs, frames, states in drives:
            given, _, stop = exact.recorded(loaded.text, inputs, frames)
            for k, (theirs, ours) in enumerate(zip(given, states, strict=False)):
                off = exact.differences(theirs, ours)
                unsaid = ours.expected is not None and theirs.expected is None and Q.EXPECTED in quantities
                wrong = [q for q, most in allowed.items() if off.get(q, 0.0) > most] or [Q.EXPECTED] * unsaid
                right += not wrong
                if wrong and first is None:
                    first = First(log, k, wrong[0], _shown(ours, wrong[0]), _shown(theirs, wrong[0]))
            if stop is not None and first is None:
                first = First(log, len(given), attribute, [], [], str(stop))
        causes = _bugs(loaded.text, "slam" if name == "slam" else "localization") if first else ()
        return Outcome(name, right, sum(len(frames) for _, _, frames, _ in drives), first, dict.fromkeys(causes, ""))

    return Part(name, attribute, lambda seeds: [drive(seed, name) for seed in seeds.seeds], grade)


def _shown(state: exact.State, quantity: exact.Quantity) -> list[Any]:
    holder = state.expected if quantity in EXPECTED else state
    found = getattr(holder, (EXPECTED | MAP).get(quantity, str(quantity)), None)
    return [] if found is None else list(np.round(found, 9).tolist())


@lru_cache(maxsize=8)
def _bugs(text: str, task: str) -> tuple[str, ...]:
    """Mistakes that `slamref check` names in its two small worlds."""
    facts = [f for world in (worlds.LINEAR, worlds.MILD) for f in exact.compared(text, task, world, exact=True)]
    return tuple(dict.fromkeys(bug for f in facts for bug in getattr(f, "bugs", ())))


LOCALIZING = {"prediction": POSE, "expectation": tuple(EXPECTED), "correction": POSE, "run": POSE}
PARTS = (*(_part(name, "Localizer", of) for name, of in LOCALIZING.items()), _part("slam", "Slam", (*POSE, *MAP)))
