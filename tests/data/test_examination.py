"""A log with one mistake is told which, by what its parts say of each other; a sound one is told nothing."""

from dataclasses import replace

import numpy as np
import pytest

import slamref
from data.notice import Code
from data.questions.asked import ask
from data.truth import Truth
from data.words import sentence
from tests.builders.logs import NOTHING
from tests.mistakes import MISTAKES, RATE, log_of, world
from tests.quick import slow
from tests.research.sound import of_tables, of_world

TRUE, FEW, BARE = {}, {"truth": False}, {"truth": False, "ids": False, "known": False}
"""Parts of a log: all; without truth; odometry and observations alone."""
NAMED = {
    "ranges in mm": ("unit", "range", "mm"), "ranges in cm": ("unit", "range", "cm"),
    "ranges in feet": ("unit", "range", "ft"), "ranges 1.7 times as large": ("scale", "range", 1.7),
    "v in mm/s": ("unit", "v", "mm/s"), "v in km/h": ("unit", "v", "km/h"), "v backward": ("side", "v", ""),
    "omega in deg/s": ("unit", "omega", "deg/s"), "bearings in degrees": ("unit", "bearing", "deg"),
    "v and omega swapped": ("exchanged", "v and omega", ""),
    "range and bearing swapped": ("exchanged", "range and bearing", ""),
    "v and omega of a row": ("summed", "v and omega", "row"), "v a distance": ("summed", "v", ""),
    "omega to the other side": ("side", "omega", ""), "bearings to the other side": ("side", "bearing", ""),
    "observations 0.3 s late": ("clock", "observations", 0.3), "observations 1 s late": ("clock", "observations", 1.0),
    "sensor turned by 90 deg": ("turned", "sensor", 90.0), "sensor turned by -90 deg": ("turned", "sensor", -90.0),
    "sensor turned by 180 deg": ("turned", "sensor", 180.0), "sensor turned by 40 deg": ("turned", "sensor", 40.0),
    "bearings in the world": ("world", "bearing", ""), "map in mm": ("unit", "map", "mm"),
    "map x and y swapped": ("exchanged", "x and y of the map", ""), "v in knots": ("unit", "v", "kn"),
    "ranges in yards": ("unit", "range", "yd"), "omega in rpm": ("unit", "omega", "rpm"),
    "observations 100 s late": ("clock", "observations", 100.0), "stamps in min": ("unit", "v and omega", "min"),
    "sensor 1.2 m ahead": ("placed", "place of the sensor", 1.2),
    "truth of an antenna": ("placed", "point of the truth", 0.8), "map x to the other side": ("side", "map.x", ""),
    "bearing and turn clockwise": ("side", "bearing and omega", ""),
    "ids of observations one more": ("shifted", "ids", -1.0), "ids of the map one less": ("shifted", "ids", -1.0),
    "truth in mm": ("unit", "truth", "mm"), "truth 0.5 s late": ("clock", "truth", 0.5),
    "truth x and y swapped": ("exchanged", "x and y of the truth", ""),
    "truth y to the other side": ("side", "truth.y", ""), "truth with compass headings": ("compass", "truth.theta", ""),
    "quaternions of the truth inverted": ("side", "truth.theta", ""),
}  # fmt: skip
"""Kind, quantity, and unit or number of the reading that mends each mistake."""
OF_TRUTH = ("ranges in yards", "sensor 1.2 m ahead",
            "bearing and turn clockwise", *(name for name in NAMED if "truth" in name))  # fmt: skip
OF_MAP = [name for name in NAMED if "map" in name or name.startswith("ids")]
QUICK = ("omega in rpm", "truth of an antenna", "omega to the other side", "v backward",
         "ranges in mm", "truth x and y swapped", "ids of the map one less")  # fmt: skip


def cases():
    for name in NAMED:
        bare = () if name in OF_TRUTH else (FEW,) if name in OF_MAP else (FEW, BARE)
        for parts in (TRUE, *bare):
            one = (name, parts) if name in QUICK and parts is not BARE else slow(name, parts)
            yield one


@pytest.mark.parametrize(("mistake", "parts"), [*cases()])
def test_a_mistake_is_named_first_with_its_value(mistake, parts, tmp_path):
    first = ask(log_of(tmp_path, MISTAKES[mistake](world(0)), **parts))[0]
    assert first.code is Code.CONTRADICTION
    said = first.named
    kind, of, value = NAMED[mistake]
    assert (kind, of) in zip(said["kinds"], said["of"])
    k = said["of"].index(of)
    if isinstance(value, str):  # observations alone may not tell it from another that is a tenth larger
        alike = [unit for unit, what in zip(said["units"], said["of"], strict=True) if what == of]
        assert value in alike[: 1 if parts is TRUE else None]
    else:
        assert said["numbers"][k] == pytest.approx(value, abs={"clock": 0.06, "scale": 0.1}.get(kind, 1.0))
    assert sentence(first)


@pytest.mark.parametrize("noise", [1.0, slow(0.3), slow(3.0)])
@pytest.mark.parametrize("parts", [TRUE, FEW, BARE, slow({"known": False}), slow({"ids": False})])
def test_a_sound_log_is_not_accused(noise, parts, tmp_path):
    assert ask(log_of(tmp_path, world(1, noise), **parts)) == ()


@pytest.mark.parametrize("name", ["corridor:31", "corridor:55"])
def test_a_robot_that_hardly_turns_is_not_accused_of_the_noise_of_its_headings(name):
    assert ask(slamref.open_log(name)) == ()


def test_a_sound_corridor_without_ids_is_not_accused_of_two_clocks(tmp_path):
    """Seen: an offset of 2 ms gained by leaving out rows, and with it "0.8 s late" was named."""
    assert not ask(of_world(tmp_path, "corridor", "open", 540, 0.3, truth=True, ids=False, known=True))


def test_bearings_in_the_world_of_a_noisy_robot_are_named_alone(tmp_path):
    """Seen: and v and omega exchanged, which makes all motions larger and so their relative errors smaller."""
    t, rng = world(1), np.random.default_rng(1)
    noise = 10.0 * np.array(t.sigmas[:2])
    rough = t.odometry + rng.normal(0.0, 1.0, t.odometry.shape) * [0.0, *(noise * RATE**0.5)]
    rough_world = replace(t, odometry=rough, sigmas=(*noise, *t.sigmas[2:]))
    (asked,) = ask(log_of(tmp_path, MISTAKES["bearings in the world"](rough_world), **FEW))
    assert (asked.named["kinds"], asked.named["of"]) == (("world",), ("bearing",))


@pytest.mark.parametrize("parts", [slow(TRUE), slow(FEW), BARE])
@pytest.mark.parametrize(("mistake", "kind"), [("from 60 s on 20 s late", "clock"),
                                               ("from 60 s on to the other side", "side")])  # fmt: skip
def test_a_mistake_in_one_half_is_named_with_its_span_and_without_flags_that_change_all(mistake, kind, parts, tmp_path):
    """Seen: nothing, true headings in degrees, ids of other landmarks."""
    (asked,) = ask(log_of(tmp_path, MISTAKES[mistake](world(0)), **parts))
    assert (asked.named["kinds"][0], asked.named["flags"]) == (kind, ())
    assert asked.named["only"] == pytest.approx((60.0, 119.9), abs=0.1)


def test_a_stretch_that_was_recorded_twice_is_named_by_its_equal_numbers(tmp_path):
    t = world(0)
    again = {p: np.vstack([a[a[:, 0] < 60.0], a[a[:, 0] >= 30.0] + 30.0 * np.eye(a.shape[1])[0]])
             for p in ("odometry", "seen", "truth") for a in [getattr(t, p)]}  # fmt: skip
    (asked,) = ask(log_of(tmp_path, replace(t, **again)))
    assert (asked.named["kinds"], asked.named["numbers"]) == (("doubled",), (30.0,))


@pytest.mark.parametrize(("form", "unit"), [("velocities", "cm"), ("steps", "min")])
def test_lengths_and_stamps_of_two_parts_alone_are_told_by_acceleration_to_the_side(form, unit, tmp_path):
    t = world(0, speed=1.6)
    if unit == "cm":
        log = log_of(tmp_path, MISTAKES["everything in cm"](t), **BARE)
    else:
        log = of_tables(tmp_path, t, form, **BARE)
        log = replace(log, recorded=replace(log.recorded, time=log.recorded.time / 60.0))
    assert unit in ask(log)[0].named["units"]


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_truth_without_headings_may_be_mirrored(side):
    log = slamref.open_log("arena:0")
    bare = replace(log.recorded, observations=NOTHING, map=None)
    asked = ask(replace(log, recorded=bare, truth=Truth(log.truth.pose * [1.0, side, np.nan])))
    assert [n.named["of"] for n in asked if n.code == Code.CONTRADICTION] == [("truth's mirror",)] * (side < 0.0)


def test_of_two_parts_alone_either_may_turn_to_the_other_side(tmp_path):
    (asked,) = ask(log_of(tmp_path, MISTAKES["omega to the other side"](world(0)), **BARE))
    assert set(asked.named["of"]) == {"omega", "bearing"}
    assert not asked.named["together"]


@pytest.mark.parametrize(("mistake", "kind", "of", "parts"), [
    slow("random ids", "strange", "ids", TRUE), ("everything in mm", "unit", "everything", TRUE),
    ("random ids of the map", "strange", "ids of the map", FEW),
    ("map y to the other side", "side", "map.y", TRUE), ("map y to the other side", "side", "map.y", FEW),
    ("sensor turned by 180 deg", "turned", "sensor", FEW), slow("truth in another frame", "frame", "truth", TRUE),
    slow("quaternions of the truth wxyz", "still", "truth.theta", TRUE),
])  # fmt: skip
def test_other_mistakes_are_named_first(mistake, kind, of, parts, tmp_path):
    """Without truth the prior decides."""
    first = ask(log_of(tmp_path, MISTAKES[mistake](world(0)), **parts))[0]
    assert (first.named["kinds"], first.named["of"]) == ((kind,), (of,))
    assert sentence(first)


@pytest.mark.parametrize(("mistake", "unit"), [("everything in cm", "cm"), ("everything in mm", "mm")])
def test_all_lengths_of_a_slow_robot_are_told_by_their_noise_which_its_flag_leaves_in_metres(mistake, unit, tmp_path):
    """Seen: 20 m/s of a robot in cm were asked nothing, and `length=mm` made the noise 1000 times too small."""
    slowly = world(0, speed=0.15)
    (asked,) = ask(log_of(tmp_path, MISTAKES[mistake](slowly)))
    flag = f"--unit v={unit}/s,range={unit},x={unit},y={unit}"
    assert (asked.named["units"], asked.named["flags"]) == ((unit,), (flag,))
    mended = log_of(tmp_path, MISTAKES[mistake](slowly), *flag.split())
    right = log_of(tmp_path, slowly)
    assert mended.truth.pose == pytest.approx(right.truth.pose, abs=1e-6)
    np.testing.assert_allclose(mended.recorded.observations.R, right.recorded.observations.R)
    assert not ask(mended)


@pytest.mark.parametrize(("parts", "most"), [slow(TRUE, 1000), (FEW, 1000), (TRUE, 6), (FEW, 6)])
def test_two_exchanged_ids_are_found_with_truth_and_without(parts, most, tmp_path):
    t = MISTAKES["two ids exchanged"](world(0))
    few = [row for i in np.unique(t.seen[:, 3]) for row in t.seen[t.seen[:, 3] == i][: most if i in (5, 9) else None]]
    (asked,) = ask(log_of(tmp_path, replace(t, seen=np.array(sorted(few, key=lambda row: row[0]))), **parts))
    assert (asked.code, asked.named["swapped"]) == (Code.MAP_ROWS, (5, 9))


def test_lengths_of_two_units_are_asked_where_an_overstated_noise_hides_which(tmp_path):
    """Seen: mm of a robot of 0.1 m/s were cm, and obeying asked nothing more."""
    t = MISTAKES["everything in mm"](world(0, speed=0.15))
    (asked,) = ask(log_of(tmp_path, replace(t, sigmas=tuple(6.0 * np.array(t.sigmas)))))
    assert (asked.named["units"], asked.named["others"]) == (("cm", "mm"), ("--unit v=mm/s,range=mm,x=mm,y=mm",))
    (asked,) = ask(log_of(tmp_path, MISTAKES["ranges in mm"](world(7, speed=0.25)), **BARE))
    assert asked.named["flags"] == ("--unit observations.range=mm",)


def test_a_robot_that_turns_steadily_is_read_by_its_clock_and_by_the_size_of_its_turns():
    """Seen: true headings in degrees for a truth 4 s late; bearings in the world, or nothing, for turns in degrees."""
    log = slamref.open_log("mixed:5")
    r, truth = log.recorded, log.truth
    late = np.vstack([np.full((8, 3), np.nan), truth.pose[:-8]])
    first = ask(replace(log, truth=replace(truth, pose=late)))[0].named
    assert (first["kinds"], first["of"], first["numbers"]) == (("clock",), ("truth",), pytest.approx((4.0,), abs=0.06))
    degrees = r.increments.mean * [1.0, 1.0, 180.0 / np.pi]
    turned = replace(r, increments=replace(r.increments, mean=degrees))
    for known in (truth.landmark_of, None):
        first = ask(replace(log, recorded=turned, truth=replace(truth, pose=None, landmark_of=known)))[0].named
        assert (first["kinds"], first["of"]) == (("unit",), ("omega",))


@pytest.mark.parametrize(("mistake", "flag"), [
    ("quaternions of the truth inverted", "--unit truth.theta=-rad"), ("v backward", "--unit odometry.v=-m/s"),
])  # fmt: skip
def test_another_side_is_mended_by_a_unit(mistake, flag, tmp_path):
    mended, right = log_of(tmp_path, MISTAKES[mistake](world(0)), *flag.split()), log_of(tmp_path, world(0))
    assert mended.truth.pose == pytest.approx(right.truth.pose, abs=1e-6)
    assert mended.recorded.increments.mean == pytest.approx(right.recorded.increments.mean, abs=1e-6)


def test_velocities_since_the_row_before_are_an_offset_of_their_period(tmp_path):
    """Of odometry at 1 Hz both explain it."""
    t = world(0)
    means = t.odometry[: len(t.odometry) // 10 * 10].reshape(-1, 10, 3).mean(axis=1)
    slow_odometry = replace(t, odometry=np.column_stack([t.odometry[10::10, 0], means[: len(t.odometry[10::10]), 1:]]))
    (asked,) = ask(log_of(tmp_path, slow_odometry))
    assert asked.named["kinds"] == ("clock", "hold")
    assert asked.named["others"] == ("--hold backward",)
    assert not ask(log_of(tmp_path, slow_odometry, "--hold", "backward"))


@pytest.mark.parametrize(("part", "factor", "flag"), [
    ("odometry", 1e6, "time=us"), ("seen", 1e3, "observations.t=ms"), ("truth", 1e3, "truth.t=ms"),
])  # fmt: skip
def test_the_unit_of_stamps_that_is_advised_is_the_one_that_fits(part, factor, flag, tmp_path, capsys):
    t = world(0)
    parts = ("odometry", "seen", "truth") if part == "odometry" else (part,)
    late = {
        p: np.column_stack([factor * (getattr(t, p)[:, 0] - getattr(t, p)[0, 0]), getattr(t, p)[:, 1:]]) for p in parts
    }
    with pytest.raises(AssertionError):
        log_of(tmp_path, replace(t, **late))
    assert f"--unit {flag}" in capsys.readouterr().err


def test_stamps_in_ms_are_refused_by_a_run(tmp_path, refused):
    """Seen: named, and then 79 951 frames were run."""
    t = world(0)
    short = replace(t, **{n: getattr(t, n)[getattr(t, n)[:, 0] < 3.0] for n in ("odometry", "seen", "truth")})
    log_of(tmp_path, MISTAKES["stamps in ms"](short))
    assert "--unit time=ms" in refused(slamref.main, ["run", str(tmp_path / "log"), "--out", str(tmp_path / "out")])
