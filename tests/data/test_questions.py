"""Each question is asked for the log it is about, with its numbers, and for no world or recording as it should be."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from data.inputs import Increments, LandmarkMap, Observations, Prior
from data.log import Log, shortened
from data.logs import find_logs, open_log
from data.notice import Code, Value
from data.questions.asked import ask, truth_start
from data.se2 import compose
from data.truth import Truth
from data.worlds.arena import Arena, simulate
from tests.quick import slow

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


def asked(log: Log) -> dict[Code, Mapping[str, Value]]:
    return {question.code: question.named for question in ask(log)}


def seen(log: Log, **changes: object) -> Log:
    r = log.recorded
    return replace(log, recorded=replace(r, observations=replace(r.observations, **changes)))


def recorded(log: Log, **changes: object) -> Log:
    return replace(log, recorded=replace(log.recorded, **changes))


@pytest.mark.parametrize("name", [*QUICK, *map(slow, MORE)])
def test_a_simulated_world_is_asked_nothing(name):
    assert asked(open_log(name)) == {}


def recordings() -> Iterator[Log]:
    for folder in ("lab_corridor", "mrclam", "intel"):
        for load in find_logs(RECORDINGS / folder, lambda text: None):
            yield load()


@pytest.mark.slow
@pytest.mark.skipif(not RECORDINGS.is_dir(), reason="the recordings are not here")
def test_a_recording_is_asked_only_about_its_bad_truth():
    asked_of = {log.name: asked(log) for log in recordings()}
    assert len(asked_of) >= 15
    assert {name: list(said) for name, said in asked_of.items() if said} == {"mrclam9-robot3": [Code.BAD_TRUTH]}


def test_bearings_counted_from_zero_to_two_pi_are_right(arena):
    z = arena.recorded.observations.z.copy()
    z[:, 1] %= 2.0 * np.pi
    assert asked(seen(arena, z=z)) == {}


@pytest.mark.parametrize("of", ["odometry", "truth", "odometry alone"])
def test_turns_in_degrees(arena, of):
    """Where nothing else tells, by their size."""
    u, per = arena.recorded.increments, [1.0, 1.0, np.degrees(1.0)]
    if of == "truth":
        wrong = replace(arena, truth=replace(arena.truth, pose=arena.truth.pose * per))
    else:
        wrong = recorded(arena, increments=Increments(u.mean * per, u.covariance))
    if of == "odometry alone":
        o = wrong.recorded.observations
        wrong = replace(seen(wrong, frame=o.frame[:0], z=o.z[:0], R=o.R[:0]), truth=Truth())
    assert asked(wrong)[Code.CONTRADICTION]["units"][0] in ("deg", "deg/s")


@pytest.mark.parametrize(("unit", "factor"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_stamps_in_smaller_units(arena, unit, factor):
    wrong = recorded(arena, time=factor * arena.recorded.time)
    assert asked(wrong)[Code.TIME_UNIT]["unit"] == unit
    assert Code.TIME_UNIT not in asked(recorded(wrong, time_is_index=True))


def test_odometry_in_milliseconds_that_was_cut_at_loading_into_gaps(small_log_files, save, tmp_path):
    files = small_log_files("odometry", "range_bearing")
    rows = "".join(f"{100 * k},0.5,0.1\n" for k in range(20))
    seen_at = "".join(f"{100 * k + 30},2.5,0.25,3\n" for k in range(19))
    files |= {"odometry.csv": f"t,v,omega\n{rows}", "observations.csv": f"t,z1,z2,true_id\n{seen_at}"}
    del files["truth.csv"]
    found = asked(open_log(str(save(tmp_path / "ms", files))))[Code.TIME_UNIT]
    assert found["unit"] == "ms"
    assert found["blind"] > 0.5


def test_a_prior_from_which_nothing_of_the_map_is_seen(arena):
    prior = Prior(arena.recorded.prior.mean + [300.0, 0.0, 0.0], arena.recorded.prior.covariance)
    found = asked(recorded(arena, prior=prior))[Code.PRIOR]
    assert (found["fitting"], found["readings"]) == (0, 50)
    assert found["truth"] == tuple(arena.truth.pose[0])
    # without a map there is nothing to see, but the truth is still elsewhere
    assert set(asked(recorded(arena, prior=prior, map=None))) == {Code.TRUTH_FRAME}


def test_a_max_range_below_what_is_seen(arena):
    found = asked(recorded(arena, sensor=replace(arena.recorded.sensor, max_range=4.0)))[Code.MAX_RANGE]
    z = arena.recorded.observations.z
    assert (found["past"], found["readings"], found["stated"]) == ((z[:, 0] > 4.4).sum(), len(z), 4.0)


def test_a_field_of_view_narrower_than_what_is_seen(arena):
    sensor = replace(arena.recorded.sensor, min_angle=-1.0, max_angle=1.0)
    found = asked(recorded(arena, sensor=sensor))[Code.FIELD_OF_VIEW]
    assert (found["low"], found["high"]) == (-1.0, 1.0)
    assert found["aside"] > 0


def test_labels_that_number_the_readings(arena):
    many = replace(arena, truth=replace(arena.truth, landmark_of=np.arange(len(arena.recorded.observations.z))))
    found = asked(recorded(many, map=None))[Code.LABELS]
    assert found["readings"] == found["landmarks"] == len(arena.recorded.observations.z)


def test_observations_that_are_written_twice(arena):
    o = arena.recorded.observations
    again = Observations(*(np.repeat(v, 2, axis=0) for v in (o.frame, o.z, o.R)))
    truth = replace(arena.truth, landmark_of=np.repeat(arena.truth.landmark_of, 2))
    (found,) = ask(replace(recorded(arena, observations=again), truth=truth))
    assert (found.named["kinds"], found.named["stated"]) == (("doubled",), 0.5)


def test_labels_that_the_map_does_not_have(arena):
    renamed = LandmarkMap(arena.recorded.map.id + 100, arena.recorded.map.xy)
    found = asked(recorded(arena, map=renamed))[Code.CONTRADICTION]
    assert (found["kinds"], found["numbers"]) == (("shifted",), (100.0,))
    numbered = LandmarkMap(np.sort(np.random.default_rng(0).choice(10**6, 25, replace=False)), arena.recorded.map.xy)
    assert asked(recorded(arena, map=numbered))[Code.CONTRADICTION]["of"] == ("ids of the map",)


def test_of_a_single_frame_nothing_is_asked():
    assert asked(shortened(simulate(Arena(), 0), 1)) == {}


def flags(log: Log) -> list[str]:
    return [str(flag) for question in ask(log) for flag in question.named.get("flags", ())]


def test_each_question_has_the_flag_that_mends_it(arena):
    """With the value: whoever pastes it has the answer."""
    z, sensor = arena.recorded.observations.z, arena.recorded.sensor
    assert flags(seen(arena, z=z * [1.0, np.degrees(1.0)]))[0] == "--unit observations.bearing=deg"
    assert flags(recorded(arena, time=arena.recorded.time * 1e3))[0] == "--unit time=ms"
    short = recorded(arena, sensor=replace(sensor, max_range=0.5 * z[:, 0].max()))
    (flag,) = [f for f in flags(short) if f.startswith("--max-range ")]
    assert z[:, 0].max() <= float(flag.split()[1]) < 1.02 * z[:, 0].max()
    narrow = recorded(arena, sensor=replace(sensor, min_angle=-0.1, max_angle=0.1))
    (flag,) = [f for f in flags(narrow) if f.startswith("--view=")]
    low, high = (float(text.removesuffix("deg")) for text in flag.removeprefix("--view=").split(","))
    assert np.isclose([low, high], np.degrees([z[:, 1].min(), z[:, 1].max()]), atol=1.0).all()


@pytest.mark.parametrize(("kind", "flag"), [
    ("velocities", "--unit odometry.omega=deg/s"), ("poses", "--unit odometry.theta=deg"),
    ("steps", "--unit odometry.dtheta=deg"),
])  # fmt: skip
def test_the_unit_of_turning_is_that_of_the_column(arena, kind, flag):
    u = arena.recorded.increments
    fast = recorded(arena, increments=Increments(u.mean * [1.0, 1.0, np.degrees(1.0)], u.covariance))
    assert flag in flags(replace(fast, source={"odometry_kind": kind}))


def test_a_transform_of_the_truth_carries_its_first_pose_into_the_prior(arena):
    away = np.array([30.0, -4.0, 1.2])
    pose = np.array([compose(away, p) for p in arena.truth.pose])
    r = arena.recorded
    log = replace(arena, truth=replace(arena.truth, pose=pose), recorded=replace(r, map=None))
    (flag,) = [f for f in flags(log) if f.startswith("--truth-transform=")]
    x, y, theta = flag.removeprefix("--truth-transform=").removesuffix("deg").split(",")
    carried = compose(np.array([float(x), float(y), np.radians(float(theta))]), pose[0])
    assert (np.abs(carried - r.prior.mean) < 3.0 * np.sqrt(np.diag(r.prior.covariance))).all()
    begun = np.array([5.0, 2.0, 0.7])
    (asked,) = truth_start(replace(log, recorded=replace(log.recorded, prior=replace(r.prior, mean=begun))))
    (flag,) = asked.named["flags"]
    x, y, theta = flag.removeprefix("--truth-transform=").removesuffix("deg").split(",")
    assert compose(np.array([float(x), float(y), np.radians(float(theta))]), pose[0]) == pytest.approx(begun, abs=0.1)
