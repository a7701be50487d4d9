"""Appearance in a run: it helps where landmarks are dense, and can be left out."""

from __future__ import annotations

import numpy as np
import pytest

from data.worlds.registry import named_log
from eval.replay.run import compare
from eval.replay.settings import Setup
from eval.studies.twins import source_of, twin
from tests.quick import slow

DENSE = "arena:0:landmarks=70+frames=25"


def wrong(log, run):
    """Observations paired with a landmark that another one began."""
    true, number = log.truth.landmark_of, run.final_decisions
    begun = {int(n): int(true[i]) for i, n in enumerate(run.created) if n >= 0}
    known = log.recorded.map is not None and run.task == "localization"
    return sum(d >= 0 and (d if known else begun.get(int(d), -1)) != t for d, t in zip(number, true, strict=True))


@pytest.mark.parametrize("task", ["slam", "localization"])
@pytest.mark.parametrize("more", ["descriptor_sigma=0.1", "classes=4"])
def test_fewer_pairings_are_wrong_with_appearance(task, more):
    log = named_log(f"{DENSE}+{more}+sigma_bearing=0.08")
    runs = [compare(log.inputs(), task, ["ekf"], "nn", Setup(appearance=on))[0] for on in (False, True)]
    assert wrong(log, runs[1]) < 0.6 * wrong(log, runs[0])


@pytest.mark.parametrize("task", ["slam", "localization"])
@pytest.mark.parametrize("method", ["jcbb", slow("jcbb-hindsight")])
def test_left_out_it_is_as_if_there_were_none(task, method):
    plain, dressed = named_log("arena:1:frames=20"), named_log("arena:1:frames=20+descriptor_sigma=0.1+classes=3")
    one = compare(plain.inputs(), task, ["ekf"], method)[0]
    other = compare(dressed.inputs(), task, ["ekf"], method, Setup(appearance=False))[0]
    assert one.online.pose.tobytes() == other.online.pose.tobytes()
    assert one.final_decisions.tolist() == other.final_decisions.tolist()


@pytest.mark.parametrize("task", [slow("slam"), "localization"])
def test_hindsight_uses_it_in_every_decision(task):
    log = named_log(f"{DENSE}+descriptor_sigma=0.1")
    runs = [compare(log.inputs(), task, ["ekf"], "jcbb-hindsight", Setup(appearance=on))[0] for on in (False, True)]
    assert wrong(log, runs[1]) <= wrong(log, runs[0])
    assert wrong(log, runs[1]) <= 2


def test_smoothers_get_it_too():
    log = named_log(f"{DENSE}+descriptor_sigma=0.1+sigma_bearing=0.08")
    filtered, smoothed = compare(log.inputs(), "slam", ["ekf", "isam2"], "jcbb")
    assert max(wrong(log, filtered), wrong(log, smoothed)) <= 5


def test_twins_draw_readings_about_the_mean_of_each_landmark():
    log = named_log("arena:0:frames=30+descriptor_sigma=0.2+classes=3")
    runs = compare(log.inputs(labels=True), "slam", ["ekf", "batch"], "known")
    source = source_of(log, runs[1], ("ekf",), Setup())
    drawn, own = (each.recorded.observations.appearance for each in (twin(source, 0), log))
    true = log.truth.landmarks.appearance
    rows = log.truth.landmarks.rows(log.truth.landmark_of)
    assert not np.array_equal(drawn.descriptor, own.descriptor)
    off = drawn.descriptor - true.descriptor[rows]
    assert np.std(off) == pytest.approx(0.2, rel=0.2)
    assert np.mean(drawn.category == true.category[rows]) == pytest.approx(0.95, abs=0.04)
    assert twin(source, 0).recorded.observations.appearance.descriptor.tobytes() == drawn.descriptor.tobytes()
