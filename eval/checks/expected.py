"""Checks of what an estimator expects to see, and of landmarks that leave its map."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from eval.checks import worlds
from eval.checks.estimators import driven, inputs_for
from eval.checks.finding import Finding
from eval.replay.foreign.adapter import Adapter
from eval.replay.foreign.guard import ForeignError
from eval.replay.run import step_by_step

HALF = worlds.FRAMES // 2
ROUNDING = 1e-6


def expectation(text: str, task: str) -> Iterator[Finding]:
    """With it, nearest neighbour decides as with our EKF; and `joint` has on its diagonal what `HPHt` says."""
    name = "expectation"
    inputs = inputs_for(worlds.noise_free(worlds.arena_log()), task)
    front = driven(text, inputs, task, HALF)
    if isinstance(front.estimator, Adapter) and not front.estimator.has("expect"):
        yield Finding(name, True, "it has no `expect`, so it works with --association known alone")
        return
    frame = inputs.frame(HALF)
    front.move(frame)
    try:
        e = front.estimator.expect(frame.sightings)
        rows = np.arange(min(len(e.number), 4))
        joint = e.joint(rows)
    except ForeignError as stop:
        yield Finding(name, False, str(stop))
        return
    blocks = joint.reshape(len(rows), 2, len(rows), 2)[rows, :, rows, :]
    apart = float(np.abs(blocks - e.HPHt[rows]).max(initial=0.0)) / max(float(np.abs(joint).max(initial=0.0)), 1e-300)
    if apart > ROUNDING:
        yield Finding(name, False, f"joint() and HPHt differ by {100 * apart:.2g} % of the largest covariance")
        return
    asked = inputs.without_labels()
    theirs, ours = (step_by_step(n, asked, task, "nn") for n in (text, "ekf"))
    if theirs.failure is not None:
        yield Finding(name, False, f"with nearest neighbour: stopped at {theirs.failure.text}")
        return
    other = int((theirs.decisions != ours.decisions).sum())
    said = f"{other} of {len(ours.decisions)} decisions of nearest neighbour on exact readings are not those of our EKF"
    wrong = other > 0.05 * len(ours.decisions)
    yield Finding(name, not wrong, f"{said}: look at z_hat, HPHt and number" if wrong else said)


def removal(text: str, task: str) -> Iterator[Finding]:
    """A landmark that was removed is in no map, and its number is not given again."""
    if task != "slam":
        return
    name, inputs = "removal", inputs_for(worlds.noise_free(worlds.arena_log()), task)
    front = driven(text, inputs, task, HALF)
    if isinstance(front.estimator, Adapter) and not front.estimator.has("remove"):
        yield Finding(name, True, "it has no `remove`, so it works without --maintain and jcbb-hindsight")
        return
    gone = np.array([0])
    try:
        front.estimator.remove(gone)
        assert front.known is not None
        front.known.removed(gone)
        made = []
        for k in range(HALF, worlds.FRAMES):
            frame = inputs.frame(k)
            front.move(frame)
            made += [n for n in front.update(frame, front.associate(frame)).created.tolist() if n >= 0]
        held = front.estimator.landmarks().number.tolist()
    except ForeignError as stop:
        yield Finding(name, False, f"landmark 0 removed: {stop}")
        return
    if 0 in held or 0 in made:
        yield Finding(name, False, "landmark 0 was removed and is in the map again: numbers are not given twice")
    else:
        yield Finding(name, True, f"landmark 0 left the map, seen again it is number {made[0] if made else 'none'}")
