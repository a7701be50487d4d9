"""Each question is asked for the log it is about, with its numbers, and for no world or recording as it should be."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from data.inputs import Increments, LandmarkMap, Observations, Prior
from data.log import Log, shortened
from data.logs import find_logs, open_log
from data.questions import CHECKS, ask, turn_rates
from data.worlds.arena import Arena, simulate

RECORDINGS = Path(__file__).parents[3] / "shared" / "data"
QUICK = [
    *(f"{world}:{seed}" for world in ("arena", "linear", "corridor") for seed in (0, 1)), "circle:0:frames=200",
    "corridor:0:people", "corridor:0:no-odometry", "corridor:0:people+no-odometry", "corridor:0:no-odometry+forward",
    "arena:0:sensor=relative_point", "arena:0:clutter=2+detection=0.7",
]  # fmt: skip
MORE = [
    *(f"{world}:{seed}" for world in ("arena", "linear", "corridor", "circle") for seed in range(2, 10)),
    *(f"floorplan:{seed}" for seed in range(4)), *(f"park:{seed}:frames=600" for seed in range(3)),
    *(f"corridor:{seed}:people" for seed in range(1, 6)), "visual:0:frames=40", "victoria-park",
]  # fmt: skip


@pytest.fixture
def arena() -> Log:
    return simulate(Arena(frames=60), 0)


def asked(log: Log) -> dict[str, str]:
    return {question.name: question.text for question in ask(log)}


def seen(log: Log, **changes: object) -> Log:
    """The log with its observations changed."""
    r = log.recorded
    return replace(log, recorded=replace(r, observations=replace(r.observations, **changes)))


def recorded(log: Log, **changes: object) -> Log:
    return replace(log, recorded=replace(log.recorded, **changes))


@pytest.mark.parametrize("name", QUICK)
def test_a_simulated_world_is_asked_nothing(name):
    assert asked(open_log(name)) == {}


@pytest.mark.slow
@pytest.mark.parametrize("name", MORE)
def test_no_seed_of_any_world_is_asked_anything(name):
    assert asked(open_log(name)) == {}


def recordings() -> Iterator[Log]:
    for folder in ("lab_corridor", "mrclam", "intel"):
        for load in find_logs(RECORDINGS / folder, lambda text: None):
            yield load()


@pytest.mark.slow
@pytest.mark.skipif(not RECORDINGS.is_dir(), reason="the recordings are not here")
def test_no_recording_is_asked_anything():
    asked_of = {log.name: asked(log) for log in recordings()}
    assert len(asked_of) >= 15
    assert {name: said for name, said in asked_of.items() if said} == {}


def test_bearings_in_degrees(arena):
    z = arena.recorded.observations.z * [1.0, np.degrees(1.0)]
    text = asked(seen(arena, z=z))["bearing unit"]
    assert "degrees" in text
    assert f"{np.abs(z[:, 1]).max():.4g}"[:3] in text.replace("-", "")


def test_bearings_counted_from_zero_to_two_pi_are_told_from_degrees(arena):
    z = arena.recorded.observations.z.copy()
    z[:, 1] %= 2.0 * np.pi
    text = asked(seen(arena, z=z))["bearing unit"]
    assert "from 0 to 2 pi" in text
    assert "degrees" not in text


def test_odometry_in_degrees_per_second(arena):
    mean = arena.recorded.increments.mean * [1.0, 1.0, np.degrees(1.0)]
    wrong = recorded(arena, increments=Increments(mean, arena.recorded.increments.covariance))
    assert "degrees" in asked(wrong)["odometry turn rate"]


def test_a_slow_robot_with_odometry_in_degrees_is_told_by_its_truth(arena):
    mean, pose = arena.recorded.increments.mean * [1.0, 1.0, np.degrees(0.05)], arena.truth.pose * [1.0, 1.0, 0.05]
    slow = replace(
        recorded(arena, increments=Increments(mean, arena.recorded.increments.covariance)),
        truth=replace(arena.truth, pose=pose),
    )
    assert "the truth by" in asked(slow)["odometry turn rate"]


def test_truth_in_degrees(arena):
    wrong = replace(arena, truth=replace(arena.truth, pose=np.degrees(arena.truth.pose) * [0.0, 0.0, 1.0]))
    assert "truth.csv" in asked(wrong)["truth turn rate"]


@pytest.mark.parametrize(("unit", "factor"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_stamps_in_smaller_units(arena, unit, factor):
    wrong = recorded(arena, time=factor * arena.recorded.time)
    assert f"are the stamps in {unit}?" in asked(wrong)["time unit"]
    assert "time unit" not in asked(recorded(wrong, time_is_index=True))


def test_stamps_in_larger_units(arena):
    assert "larger units" in asked(recorded(arena, time=1e-9 * arena.recorded.time))["time unit"]


def test_odometry_in_milliseconds_that_was_cut_at_loading_into_gaps(small_log_files, save, tmp_path):
    files = small_log_files("odometry", "range_bearing")
    rows = "".join(f"{100 * k},0.5,0.1\n" for k in range(20))
    seen_at = "".join(f"{100 * k + 30},2.5,0.25,3\n" for k in range(19))
    files |= {"odometry.csv": f"t,v,omega\n{rows}", "observations.csv": f"t,z1,z2,true_id\n{seen_at}"}
    del files["truth.csv"]
    assert "are the stamps in ms?" in asked(open_log(str(save(tmp_path / "ms", files))))["time unit"]


def test_a_prior_from_which_nothing_of_the_map_is_seen(arena):
    prior = Prior(arena.recorded.prior.mean + [300.0, 0.0, 0.0], arena.recorded.prior.covariance)
    text = asked(recorded(arena, prior=prior))["prior"]
    assert "0 of the first 50 readings" in text
    assert "the truth starts at" in text
    # without a map there is nothing to see, but the truth is still elsewhere
    assert set(asked(recorded(arena, prior=prior, map=None))) == {"truth frame"}


def test_a_wide_prior_is_asked_nothing(arena):
    wide = Prior(arena.recorded.prior.mean + [3.0, 0.0, 0.0], np.diag([4.0, 4.0, 0.1]))
    assert asked(recorded(arena, prior=wide)) == {}


def test_a_max_range_below_what_is_seen(arena):
    sensor = replace(arena.recorded.sensor, max_range=4.0)
    text = asked(recorded(arena, sensor=sensor))["max_range"]
    farther = int((arena.recorded.observations.z[:, 0] > 4.4).sum())
    assert f"{farther} of {len(arena.recorded.observations.z)}" in text
    assert "4 m" in text


def test_a_field_of_view_narrower_than_what_is_seen(arena):
    sensor = replace(arena.recorded.sensor, min_angle=-1.0, max_angle=1.0)
    assert "-57.3 to 57.3 deg" in asked(recorded(arena, sensor=sensor))["field of view"]


def test_truth_in_every_fifth_frame(arena):
    pose = np.full_like(arena.truth.pose, np.nan)
    pose[::5] = arena.truth.pose[::5]
    sparse = replace(arena, truth=replace(arena.truth, pose=pose))
    assert asked(sparse)["truth rate"].startswith("12 of 60 frames")


def test_labels_that_number_the_readings(arena):
    many = replace(arena, truth=replace(arena.truth, landmark_of=np.arange(len(arena.recorded.observations.z))))
    assert "number the readings" in asked(recorded(many, map=None))["labels"]


def test_labels_that_the_map_does_not_have(arena):
    renamed = LandmarkMap(arena.recorded.map.id + 100, arena.recorded.map.xy)
    assert "labels 0 to 23, map 100 to 124" in asked(recorded(arena, map=renamed))["label names"]


def test_a_log_without_observations_can_be_asked(arena):
    none = Observations(np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 2, 2)))
    empty = replace(recorded(arena, observations=none), truth=replace(arena.truth, landmark_of=None))
    assert asked(empty) == {}
    assert len(CHECKS) == 9


def test_of_a_single_frame_no_turn_is_asked():
    assert turn_rates(shortened(simulate(Arena(), 0), 1)) == []
