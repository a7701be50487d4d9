"""A front end has no log: it gets what is known before the first frame, then one frame after the other."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from data.inputs import Observations
from data.worlds.arena import Arena, simulate
from ekf import kernels, localizer, updates
from eval.replay.run import front_end, step_by_step
from eval.replay.settings import Beginning, Setup
from tests.quick import slow

MANAGED = Setup(maintain=True, forget_after=3.0, lag=2.0)


@pytest.fixture(scope="module")
def inputs():
    return simulate(Arena(frames=60, landmarks=20), 3).inputs(labels=True)


def alone(name, association, inputs, setup):
    """Decisions (M,) and poses (N, 3) by a front end that never sees more than a frame at a time."""
    frames = [inputs.frame(k) for k in range(len(inputs))]
    front = front_end(name, association, Beginning(inputs.prior, inputs.sensor, inputs.map), setup)
    decisions, poses = [], []
    while frames:
        frame = frames.pop(0)
        front.move(frame)
        if len(frame.observations.z):
            pairing = front.associate(frame)
            done = front.update(frame, pairing)
            decisions += np.where((pairing.decisions >= 0) & ~done.used, -2, pairing.decisions).tolist()
        front.tidy()
        poses.append(front.estimator.estimate().mean)
    front.close()
    return decisions, poses


@pytest.mark.parametrize("association", ["known", pytest.param("jcbb", marks=pytest.mark.slow), "jcbb-hindsight"])
@pytest.mark.parametrize("task", ["localization", "slam"])
@pytest.mark.parametrize("name", ["ekf", slow("isam2"), slow("fixed-lag")])
def test_a_run_needs_no_more_than_a_frame_at_a_time(inputs, name, task, association):
    given = inputs if task == "localization" else inputs.without_map()
    given = given if association == "known" else given.without_labels()
    run = step_by_step(name, given, task, association, MANAGED)
    decisions, poses = alone(name, association, given, MANAGED)
    assert run.decisions.tolist() == decisions
    assert np.array_equal(run.online.pose, poses)


def test_labels_that_were_not_granted_are_missed_at_the_first_sighting(inputs):
    o = inputs.observations
    front = front_end("ekf", "known", replace(inputs, observations=Observations(o.frame, o.z, o.R)), Setup())
    front.move(inputs.frame(0))
    with pytest.raises(ValueError, match="not granted"):
        front.associate(inputs.frame(0)._replace(label=None))


def test_a_frame_of_the_localizer_takes_a_call_to_predict_one_to_look_up_and_one_to_update(inputs, monkeypatch):
    calls = Counter()

    def counted(name, real):
        return lambda *given: calls.update([name]) or real(*given)

    kinds = kernels, localizer, updates
    functions = {(m, n): f for m in kinds for n, f in vars(m).items() if hasattr(f, "py_func") and f.py_func is not f}
    for (module, name), real in functions.items():
        monkeypatch.setattr(module, name, counted(name, real))
    step_by_step("ekf", inputs, "localization")
    seen = int((np.diff(inputs.start) > 0).sum())
    assert calls == {"predict": len(inputs) - 1, "look_up": seen, "of_frame": seen}
