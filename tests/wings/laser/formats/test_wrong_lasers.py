"""Laser recordings wrong in one way: the fault is named with the flag that mends it; right ones ask nothing."""

import bz2
import math
from dataclasses import fields, replace

import numpy as np
import pytest

from data.convert.__main__ import main as convert, parser
from data.errors import DataError, UsageError
from data.formats.recordings.beams import on_one_set
from data.formats.recordings.laser import made_increasing, without_odometry
from data.formats.recordings.mending import Mending, range_noise, without_jumps
from data.inputs import Scanner
from data.logs import open_log
from data.notice import Code
from data.questions.asked import ask
from data.se2 import between, dead_reckoned
from data.words import sentence
from data.worlds.registry import named_log
from tests.wings.laser.formats.carmen_text import flaser, odom, robotlaser
from wings.laser import convert as conversions
from wings.laser.carmen import load_carmen

RAW = named_log("floorplan:2:frames=500")


@pytest.fixture(scope="module")
def driven():
    """Odometry (N, 3), stamps and ranges of a simulated robot."""
    inputs = RAW.recorded
    pose = dead_reckoned(inputs.prior.mean, inputs.increments.mean)
    return pose, 100.0 + inputs.time, np.where(inputs.scans.ranges > 0.0, inputs.scans.ranges, 81.83)


def text(pose, stamp, ranges):
    lines = []
    for p, t, r in zip(pose.tolist(), stamp.tolist(), ranges, strict=True):
        lines += [odom(*p, t), flaser([f"{x:.3f}" for x in r], tuple(p), t)]
    return lines


@pytest.fixture
def load(tmp_path):
    def run(lines, **mending):
        (tmp_path / "made.log").write_text("\n".join(lines))
        return load_carmen(tmp_path / "made.log", mending=Mending(**mending))

    return run


def asked(log):
    return {question.code for question in ask(log)}


def test_a_right_log_is_asked_nothing(driven, load):
    assert asked(load(text(*driven))) == set()


WRONG = {
    "odometry in mm": (lambda p, t, r: (p * [1e3, 1e3, 1], t, r), Code.ODOMETRY_UNIT, {"odometry_unit": "mm"}),
    "odometry in cm": (lambda p, t, r: (p * [1e2, 1e2, 1], t, r), Code.ODOMETRY_UNIT, {"odometry_unit": "cm"}),
    "headings in degrees": (lambda p, t, r: (p * [1, 1, math.degrees(1)], t, r), Code.HEADING_UNIT, {"angle": "deg"}),
    "stamps in ms": (lambda p, t, r: (p, 1e3 * t, r), Code.TIME_UNIT, {"time": "ms"}),
    "no odometry": (lambda p, t, r: (0.0 * p, t, r), Code.NO_ODOMETRY, {"odometry": False}),
    "beams from left to right": (lambda p, t, r: (p, t, r[:, ::-1]), Code.MOUNTING, {"clockwise": True}),
    "laser backward": (lambda p, t, r: (_turned(p), t, r), Code.MOUNTING, {"laser_turned": 180.0}),
    "one stamp of a broken clock": (lambda p, t, r: (p, _broken(t), r), Code.STAMPS_BROKEN, None),
    "interleaved stretches": (lambda p, t, r: _interleaved(p, t, r), Code.STAMPS_BACK, {"sort_stamps": True}),
}


def _turned(pose):
    """Odometry of a robot that drives the other way, with the laser at its back."""
    steps = np.zeros_like(pose)
    steps[1:] = between(pose[:-1], pose[1:]) * np.array([-1.0, -1.0, 1.0])
    return dead_reckoned(pose[0], steps)


def _broken(stamp):
    broken = stamp.copy()
    broken[100] = 2.0**32
    return broken


def _interleaved(pose, stamp, ranges):
    order = np.concatenate([np.arange(200), np.arange(200, 400).reshape(2, 100).T.ravel(), np.arange(400, 500)])
    return pose[order], stamp[order], ranges[order]


SLOWER = ("odometry in cm", "headings in degrees", "stamps in ms")


@pytest.mark.parametrize("fault", [pytest.param(f, marks=[pytest.mark.slow] * (f in SLOWER)) for f in WRONG])
def test_a_fault_is_asked_for_by_name_and_gone_with_its_flag(driven, load, fault):
    spoil, code, mending = WRONG[fault]
    lines = text(*spoil(*driven))
    wrong = load(lines)
    assert asked(wrong) == {code}
    (question,) = ask(wrong)
    assert "--" in sentence(question) or mending is None
    if mending is not None:
        assert asked(load(lines, **mending)) == set()


def test_a_log_of_a_table_is_told_flags_of_tables(driven, load):
    pose, stamp, ranges = driven
    (question,) = ask(replace(load(text(_turned(pose), stamp, ranges[:, ::-1])), source={"kind": "table"}))
    assert [flag.partition("=")[0] for flag in question.named["flags"]] == ["--scanner", "--sensor-pose"]
    assert "`slamref convert table`" in sentence(question)


@pytest.mark.parametrize(("unit", "times"), [("cm", 100.0), ("mm", 1000.0)])
def test_ranges_in_another_unit_are_an_error_that_names_the_flag(driven, load, unit, times):
    pose, stamp, ranges = driven
    lines = text(pose[:50], stamp[:50], times * ranges[:50])
    with pytest.raises(DataError, match=f"--range-unit {unit}"):
        load(lines)
    right = load(text(pose[:50], stamp[:50], ranges[:50]))
    assert load(lines, range_unit=unit).recorded.scans.ranges == pytest.approx(right.recorded.scans.ranges, abs=1e-3)


def test_half_the_angle_between_beams_is_asked_for(load):
    here = (0.0, 0.0, 0.0)
    lines = [robotlaser([1.0] * 181, here, here, 1.0, head=f"0 {-0.5 * math.pi} {math.pi} {math.pi / 360} 80 0.01 0")]
    (question,) = load(lines).asked
    assert question.code == Code.BEAM_ANGLES
    assert question.named["mended"] == pytest.approx(1.0)
    assert load(lines, beam_step=1.0).recorded.scans.scanner.angle_step == pytest.approx(math.pi / 180)


def test_the_pose_of_a_scan_line_is_the_frames(load):
    lines = [odom(0.0, 0.0, 0.0, 1.0), odom(1.0, 0.0, 0.0, 2.0), flaser([1.0], (1.5, 0.1, 0.2), 2.1)]
    lines += [odom(2.0, 0.0, 0.0, 3.0), flaser([1.0], (2.0, 0.0, 0.0), 3.1)]
    assert load(lines).recorded.increments.mean[1].tolist() == [1.5, 0.1, 0.2]


def test_scans_without_odometry_between_are_frames_and_correction_is_not_undone(load, tmp_path):
    lines = [odom(0.0, 0.0, 0.0, 1.0), *(flaser([1.0 + k], (0.1 * k, 0.0, 0.0), 1.0 + k) for k in range(10))]
    log = load(lines)
    assert log.recorded.scans.frame.tolist() == list(range(10))
    assert log.recorded.increments.mean[1:, 0] == pytest.approx(0.1)
    with pytest.raises(DataError, match="--undo-correction keeps 1 of 10 scans"):
        load_carmen(tmp_path / "made.log", undo_correction=True)


def test_numbers_of_beams_that_vary_are_brought_to_the_most_frequent(load):
    wide, narrow = [0.1 * i for i in range(1, 182)], [0.1 * i for i in range(1, 181)]
    lines = []
    for k, ranges in enumerate([wide, narrow, wide]):
        lines += [odom(0.1 * k, 0.0, 0.0, 1.0 + k), flaser(ranges, (0.1 * k, 0.0, 0.0), 1.0 + k)]
    scans = load(lines).recorded.scans
    assert scans.ranges.shape == (3, 181)
    assert scans.ranges[1] == pytest.approx([*narrow, 0.0])


def test_beams_between_two_are_interpolated_on_one_surface_and_not_across_an_edge():
    fine, coarse = np.full(9, 2.0), np.array([2.0, 2.1, 8.0])
    found, low, step, resampled = on_one_set([fine, fine, coarse], np.zeros(3), np.array([0.25, 0.25, 1.0]))
    assert (low, step, resampled) == (0.0, 0.25, 1)
    assert found[2] == pytest.approx([2.0, 2.025, 2.05, 2.075, 2.1, 2.1, 8.0, 8.0, 8.0])


def test_a_bzip2_file_is_read(tmp_path, driven):
    pose, stamp, ranges = driven
    content = "\n".join(text(pose[:5], stamp[:5], ranges[:5])).encode()
    (tmp_path / "made.log.bz2").write_bytes(bz2.compress(content))
    assert len(load_carmen(tmp_path / "made.log.bz2").recorded) == 5
    for broken, fault in ((content, "not a bzip2 file"), (bz2.compress(content)[:-40], "broken or cut off")):
        (tmp_path / "made.log.bz2").write_bytes(broken)
        with pytest.raises(DataError, match=fault):
            load_carmen(tmp_path / "made.log.bz2")


def test_the_noise_of_ranges_is_that_of_walls():
    scans = RAW.recorded.scans
    assert range_noise(scans.ranges, scans.scanner.angle_step, 30.0) == pytest.approx(0.015, rel=0.15)


def test_a_stated_resolution_is_not_the_noise(driven, load):
    pose, stamp, ranges = driven
    head = f"0 {-0.5 * math.pi} {math.pi} {math.pi / 180} 80 0.1 0"
    lines = []
    for p, t, r in zip(pose[:200].tolist(), stamp[:200].tolist(), ranges[:200], strict=True):
        place = tuple(p)
        lines += [odom(*p, t), robotlaser([f"{x:.3f}" for x in r], place, place, t, head=head)]
    log = load(lines)
    assert log.recorded.scans.scanner.sigma == pytest.approx(0.015, rel=0.2)
    assert any("0.1 m is taken as a resolution" in note for note in log.notes)


def test_a_stamp_far_above_those_that_follow_does_not_stop_the_clock():
    stamp = np.arange(20.0)
    stamp[5] = 2.0**32
    mended, *broken = without_jumps(stamp)
    assert broken == [1, 0]
    assert made_increasing(mended).tolist() == list(range(20))


def test_a_clock_that_is_set_back_goes_on_a_lost_stamp_is_interpolated_and_one_that_does_not_run_is_none(driven, load):
    pose, stamp, ranges = (a[:60] for a in driven)
    right = load(text(pose, stamp, ranges)).recorded.time
    for wrong in (np.where(np.arange(60) < 30, stamp, stamp - 80.0), np.where(np.arange(60) % 20 == 7, 0.0, stamp)):
        log = load(text(pose, wrong, ranges))
        assert asked(log) == set()
        assert log.recorded.time == pytest.approx(right, abs=1e-3)
        assert any("clock was set back at frame 30" in n or "far below" in n for n in log.notes)
    log = load(text(pose, 0.0 * stamp, ranges))
    assert log.recorded.time_is_index
    assert asked(log) == set()


@pytest.mark.parametrize("flags", [["--unit", "angle=grad"], ["--unit", "length=mm"], ["--unit", "deg"]])
def test_a_unit_that_is_none_is_refused_with_those_that_are(flags, refused):
    assert "as in angle=deg,time=ms" in refused(convert, ["carmen", "made.log", "out", *flags])


PAIRS = [
    *(("beams from left to right", fault) for fault in ("odometry in mm", "odometry in cm", "interleaved stretches")),
    *(("laser backward", fault) for fault in ("odometry in mm", "stamps in ms", "beams from left to right")),
    *(("no odometry", fault) for fault in ("interleaved stretches", "stamps in ms")),
]


@pytest.mark.slow
@pytest.mark.parametrize("faults", PAIRS)
def test_two_faults_at_once_are_both_mended_by_the_flags_that_are_named(driven, load, faults):
    given, names = driven, {}
    for fault in faults:
        spoil, _, mending = WRONG[fault]
        given, names = spoil(*given), names | mending
    lines, found = text(*given), list[str]()
    for _ in range(4):
        asked = ask(load(lines, **mending_of(found)))
        found += [word for question in asked for flag in question.named.get("flags", ()) for word in flag.split()]
    assert mending_of(found) == names


def mending_of(flags):
    """What the flags of a command ask for, besides the defaults."""
    mending = conversions._mending(parser(simulators=False).parse_args(["carmen", "a", "b", *flags]))
    return {f.name: v for f in fields(Mending) if (v := getattr(mending, f.name)) != f.default}


def test_a_laser_turned_on_the_robot_stays_in_its_place():
    scanner = Scanner(-1.0, 0.1, 30.0, 0.01, 0.0, (-0.2, 0.0))
    turned = Mending(laser_turned=90.0).scanner(scanner)
    assert turned.rotation == pytest.approx(-0.5 * math.pi)
    # p_scanner = R p_body + T: the laser itself, at (0.2, 0) on the robot, is its own origin
    c, s = math.cos(turned.rotation), math.sin(turned.rotation)
    assert np.array([c * 0.2, s * 0.2]) + turned.translation == pytest.approx([0.0, 0.0], abs=1e-12)


@pytest.mark.parametrize(("name", "kind"), [("a.g2o", "g2o"), ("b.bag", "rosbag"), ("c.mcap", "rosbag")])
def test_a_file_of_another_kind_is_answered_with_the_command_that_converts_it(tmp_path, name, kind):
    (tmp_path / name).write_text("x")
    with pytest.raises(UsageError, match=f"slamref convert {kind} .*{name}"):
        open_log(tmp_path / name)


def test_unknown_odometry_is_not_asked_for_again():
    assert Code.NO_ODOMETRY not in asked(replace(RAW, recorded=without_odometry(RAW.recorded)))
