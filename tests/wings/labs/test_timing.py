"""Update times: what a frame's update takes and what maintenance takes after it, the fastest of several runs."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from data.inputs import Observations
from data.log import Log
from eval.replay.settings import Setup
from tests.eval.handmade_lab import FRAMES, lab_log
from wings.labs import pictures
from wings.labs.pictures import update_times

BLIND = 2
"""A frame in which nothing is seen."""


def log() -> Log:
    full = lab_log()
    seen = full.recorded.observations
    kept = seen.frame != BLIND
    recorded = replace(full.recorded, observations=Observations(seen.frame[kept], seen.z[kept], seen.R[kept]))
    return replace(full, recorded=recorded, truth=replace(full.truth, landmark_of=full.truth.landmark_of[kept]))


@pytest.mark.parametrize("association", ["known", "nn"])
def test_every_frame_has_its_times_and_one_without_readings_no_update(association):
    found = update_times(log(), "ekf", association, [Setup(), Setup(maintain=True)], repeats=1)
    assert len(found) == 2
    for times in found:
        assert times.update.shape == times.maintenance.shape == (FRAMES,)
        assert (times.update[np.arange(FRAMES) != BLIND] > 0.0).all()
        assert times.update[BLIND] == 0.0
        assert (times.maintenance > 0.0).all()
        assert max(times.update.max(), times.maintenance.max()) < 10.0


def test_of_each_setup_the_fastest_run_counts_and_setups_take_turns(monkeypatch):
    # by turn and setup: s that pass between two looks at the clock, four of them in a frame, two where nothing is seen
    paces = [3.0, 1.0, 2.0, 5.0]
    each = 4 * (FRAMES - 1) + 2
    stamps = iter(np.cumsum(np.repeat(paces, each)).tolist())
    monkeypatch.setattr(pictures, "time", SimpleNamespace(perf_counter=lambda: next(stamps)))
    found = update_times(log(), "ekf", "nn", [Setup(), Setup(maintain=True)], repeats=2)
    for times, pace in zip(found, (2.0, 1.0), strict=True):
        assert times.update.tolist() == [0.0 if k == BLIND else pace for k in range(FRAMES)]
        assert times.maintenance.tolist() == [pace] * FRAMES
    assert next(stamps, None) is None
