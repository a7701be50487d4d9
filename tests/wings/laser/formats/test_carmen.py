"""A CARMEN log is read line by line as its text says, corrected ones made raw; what is wrong is one line.

Laser logs where a person meets them: found in folders, converted, inspected, and told apart by their digest.
"""

import dataclasses
import gzip
import math
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from data.convert.__main__ import main as convert
from data.errors import DataError, UsageError
from data.formats.open_log import load_folder
from data.formats.recordings.laser import increments_of, made_increasing
from data.formats.recordings.mending import Mending
from data.log import Log
from data.logs import Reading, find_logs, open_log
from data.questions.summary import summarize
from data.se2 import Array, compose
from eval.plan.experiments import make_plan
from eval.plan.flags.options import read_options
from tests.data.formats.open_log.same_log import assert_same_log
from tests.wings.laser.formats.carmen_text import SMALL, flaser, odom, robotlaser
from wings.laser.carmen import beams_of, largest_range, load_carmen

HERE = (0.0, 0.0, 0.0)
RELATIONS = "row2,y,row1,x,theta,why\n2,0.1,0,0.2,0.3,9\n0,0,3,1,-0.5,9\n"


@pytest.fixture
def load(tmp_path: Path) -> Callable[..., Log]:
    def run(text: str, name: str = "small.log") -> Log:
        content = text.encode()
        (tmp_path / name).write_bytes(gzip.compress(content) if name.lower().endswith(".gz") else content)
        return load_carmen(tmp_path / name)

    return run


@pytest.mark.parametrize("name", ["small.log", "small.clf", "small.log.gz", "small.gz", "small.CLF.GZ"])
def test_plain_and_packed_files_give_the_same_log_of_the_same_name(load, name):
    log = load(SMALL, name)
    assert log.name == "small"
    assert len(log.recorded) == 4
    assert log.recorded.scans.frame.tolist() == [0, 2]


def test_every_odom_line_is_a_frame_with_its_increment_in_the_body_of_the_one_before_and_times_increase(load):
    log = load(SMALL)
    recorded, scanner = log.recorded, log.recorded.scans.scanner
    assert recorded.prior.mean.tolist() == [1.0, 2.0, 0.5]
    assert not recorded.prior.covariance.any()
    c, s = math.cos(0.5), math.sin(0.5)
    assert recorded.increments.mean[1] == pytest.approx([0.1 * c, -0.1 * s, 0.1])
    assert recorded.increments.mean[2].tolist() == [0.0, 0.0, 0.0]
    assert len(recorded.observations.z) == 0
    assert recorded.floored == 1
    assert np.diagonal(recorded.increments.covariance[2]).tolist() == [1e-10] * 3
    # a reading of the reach or more and a zero are no return
    assert recorded.scans.ranges.tolist() == [[1.0, 2.5, 0.0], [0.0, 3.0, 0.0]]
    assert scanner.translation == (-0.25, 0.0)  # p_scanner = p_body + T: the laser itself is its own origin
    assert scanner.rotation == 0.0
    assert "Lines left out: 1 NEFF, 1 SYNC." in log.notes
    assert "1 of 4 stamps do not increase; line order is used." in log.notes
    assert recorded.time.tolist() == [10.0, 10.5, 10.5 + 1e-6, 11.0]
    assert made_increasing(np.array([5.0, 5.0, 4.0, 5.0000015])).tolist() == [5.0, 5.000001, 5.000002, 5.000003]
    assert (np.diff(made_increasing(np.array([1e12, 1e12, 3.0]))) > 0.0).all()  # a microsecond is lost to rounding


def test_of_two_scans_without_odometry_between_the_first_stays_and_early_ones_go(load):
    lines = [flaser([9.0], HERE, 0.0), odom(0, 0, 0, 1.0), flaser([1.0], HERE, 1.0), flaser([2.0], HERE, 1.1)]
    log = load("\n".join(lines))
    assert log.recorded.scans.ranges.tolist() == [[1.0]]
    assert "1 of 3 scans before the first ODOM line: left out." in log.notes
    assert "1 of 3 scans after another without an ODOM line between: left out." in log.notes


def test_without_odom_lines_every_scan_is_a_frame_at_the_pose_of_its_line(load):
    log = load("\n".join(flaser([1.0 + k], (float(k), 0.0, 0.0), 3.0 - k) for k in range(3)))
    assert log.recorded.scans.frame.tolist() == [0, 1, 2]
    assert log.recorded.increments.mean[1:].tolist() == [[1.0, 0.0, 0.0]] * 2
    assert log.recorded.time[0] == 3.0


@pytest.mark.parametrize(("beams", "first", "last", "step"), [
    (180, -90, 89, 1), (181, -90, 90, 1), (360, -90, 89.5, 0.5), (361, -90, 90, 0.5), (401, -50, 50, 0.25),
])  # fmt: skip
def test_the_number_of_beams_says_where_they_point(beams, first, last, step):
    low, between = np.degrees(beams_of(beams))
    assert [low, low + (beams - 1) * between, between] == pytest.approx([first, last, step])


def test_robotlaser_lines_state_their_own_geometry_and_place(load):
    # the laser 0.3 m ahead and 0.1 m to the left of the robot, looking back
    laser, robot = (2.0 - 0.1, 5.0 + 0.3, -0.5 * math.pi), (2.0, 5.0, 0.5 * math.pi)
    log = load(robotlaser([1.0, 5.6, 2.0], laser, robot, 4.0, remissions=[7, 8]))
    scans = log.recorded.scans
    s = scans.scanner
    assert (s.angle_min, s.angle_step, s.max_range, s.sigma) == (-2.0, 0.5, 5.6, 0.03)
    assert scans.ranges.tolist() == [[1.0, 0.0, 2.0]]
    assert log.recorded.prior.mean.tolist() == list(robot)
    c, r = math.cos(s.rotation), math.sin(s.rotation)
    seen = np.array([[c, -r], [r, c]]) @ [0.3, 0.1] + s.translation
    assert seen == pytest.approx([0.0, 0.0], abs=1e-12)
    assert abs(s.rotation) == pytest.approx(math.pi)


def test_where_each_scan_is_written_twice_the_line_that_states_more_is_taken(load):
    log = load("\n".join([odom(0, 0, 0, 1.0), flaser([1.0], HERE, 1.0), robotlaser([2.0], HERE, HERE, 1.0)]))
    assert log.recorded.scans.ranges.tolist() == [[2.0]]
    assert "Lines left out: 1 FLASER." in log.notes


def test_the_reach_is_where_readings_pile_up():
    ranges = np.random.default_rng(1).uniform(1.0, 12.0, (50, 40))
    assert largest_range(ranges, None)[0] == 80.0
    ranges[:, 3] = 40.0
    assert largest_range(ranges, None)[0] == largest_range(ranges, 80.0)[0] == 40.0
    ranges[:, 4] = np.linspace(39.7, 39.9, 50)  # a wall just below: the largest is a reading like others
    assert largest_range(ranges, None)[0] == 80.0
    assert largest_range(ranges, 15.0)[0] == 15.0


def test_noise_of_wheels_does_not_depend_on_how_often_odometry_is_logged():
    # straight ahead, where covariances of parts add up coordinate by coordinate but for the lever of the heading
    once, _ = increments_of(np.array([[0.0, 0, 0], [2.0, 0, 0]]))
    often, _ = increments_of(np.linspace([0.0, 0, 0], [2.0, 0, 0], 101))
    assert often.covariance.sum(axis=0) == pytest.approx(once.covariance.sum(axis=0))
    assert np.diagonal(once.covariance[1]) == pytest.approx([0.05**2 * 2, 0.05**2 * 2, 0.075**2 * 2])


def test_relations_beside_the_log_are_read_by_name_with_the_stamps_as_recorded(load, tmp_path):
    (tmp_path / "small.relations.csv").write_text(RELATIONS)
    relations = load(SMALL, "small.log.gz").truth.relations
    assert relations.row1.tolist() == [0, 3]
    assert relations.row2.tolist() == [2, 0]
    assert relations.relative.tolist() == [[0.2, 0.1, 0.3], [1.0, 0.0, -0.5]]
    assert relations.exact is None
    assert relations.stamp is None
    # a frame with a scan has the scan's stamp, to which references tie relations
    assert relations.frame_stamp.tolist() == [10.02, 10.5, 10.3, 11.0]


def corrected(raw: Array, every: int, rng: np.random.Generator) -> tuple[str, Array]:
    """Text of a log in which a filter corrects the pose at every few frames and goes on from there with the raw
    increments, and its poses: in the loop, so one pose after the other.
    """
    lines, poses, pose = [], [], raw[0]
    for k in range(len(raw)):
        if k:
            pose = compose(pose, compose_inverse(raw[k - 1], raw[k]))
        poses.append(pose)
        lines.append(odom(*pose.tolist(), 10.0 + k))
        if k % every == 0:
            pose = pose + rng.normal(0.0, 0.2, 3)
            place = tuple(pose.tolist())
            lines += [flaser([1.0 + k], place, 10.0 + k), odom(*place, 1e-40 if k % 2 else 0.0), "NEFF 7.5"]
    return "\n".join(lines), np.array(poses)


def compose_inverse(a: Array, b: Array) -> Array:
    """b in the frame of a, by complex numbers."""
    moved = complex(b[0] - a[0], b[1] - a[1]) * np.exp(-1j * a[2])
    return np.array([moved.real, moved.imag, b[2] - a[2]])


def steps(poses: Array) -> Array:
    return np.array([compose_inverse(a, b) for a, b in pairwise(poses)])


def test_the_raw_increments_come_back_and_no_frame_is_invented(tmp_path):
    rng = np.random.default_rng(4)
    raw = np.cumsum(rng.normal(0.0, 0.1, (30, 3)), axis=0)
    text, poses = corrected(raw, 4, rng)
    (tmp_path / "made.log").write_text(text)
    log = load_carmen(tmp_path / "made.log", undo_correction=True)
    assert log.recorded.increments.mean[1:] == pytest.approx(steps(raw), abs=1e-12)
    assert log.recorded.prior.mean.tolist() == raw[0].tolist()
    assert log.recorded.time.tolist() == [10.0 + k for k in range(30)]
    assert log.recorded.scans.frame.tolist() == list(range(0, 30, 4))
    assert log.notes[0].startswith("Raw odometry recovered: 8 corrections undone")
    assert "8 ODOM lines that repeat a corrected pose" in log.notes[0]
    # without the option the poses are those of the file, corrections and all, and a note says what can be done
    plain = load_carmen(tmp_path / "made.log")
    assert len(plain.recorded) == 38
    assert any("--undo-correction" in note for note in plain.notes)
    assert not np.allclose(steps(poses), steps(raw))
    (tmp_path / "scans.log").write_text(flaser([1.0], (0.0, 0.0, 0.0), 1.0))
    with pytest.raises(DataError, match=r"scans.log: no ODOM line"):
        load_carmen(tmp_path / "scans.log", undo_correction=True)


@pytest.fixture(scope="module")
def intel(shared_data) -> tuple[Log, Log]:
    """The corrected log of the Intel lab undone, and its raw odometry as others kept it."""
    folder = shared_data / "intel"
    if not (folder / "intel_raw_full.log.gz").exists():
        pytest.skip("no Intel log in ../shared/data/intel")
    return load_carmen(folder / "intel.gfs.log", undo_correction=True), load_carmen(folder / "intel_raw_full.log.gz")


@pytest.mark.slow
def test_the_raw_odometry_of_the_intel_log_comes_back(intel):
    undone, raw = intel
    assert len(undone.recorded) == len(raw.recorded) == 13631
    difference = np.abs(undone.recorded.increments.mean - raw.recorded.increments.mean).max(axis=0)
    assert difference[:2].max() < 2e-4  # six significant digits of metres up to 50 from the origin, and of radians
    assert difference[2] < 1.6e-5
    frames, one, two = np.intersect1d(undone.recorded.scans.frame, raw.recorded.scans.frame, return_indices=True)
    assert len(frames) == 910
    assert np.array_equal(undone.recorded.scans.ranges[one], raw.recorded.scans.ranges[two])


def test_the_intel_log_is_read_as_its_description_counts_it(intel):
    _, raw = intel
    scans, relations = raw.recorded.scans, raw.truth.relations
    assert scans.ranges.shape == (7584, 180)
    assert not (scans.ranges > 80.0).any()
    assert (len(relations), int(relations.exact.sum())) == (2984, 1190)
    exact = relations.exact == 1
    stamps = np.column_stack([relations.frame_stamp[relations.row1], relations.frame_stamp[relations.row2]])
    assert np.abs(stamps - relations.stamp)[exact].max() < 1e-4
    assert raw.source["sha256"] == "af8a71b99c4d585c84a65d361755a8fccc366e9209348874bfeb3d3a7f29c31f"


FIRST, SECOND = flaser([1, 2, 3], HERE, 1.0), flaser([1, 2, 3], HERE, 2.0)
LASER = robotlaser([1, 2, 3], HERE, HERE, 2.0)


@pytest.mark.parametrize(("line", "message"), [
    (SECOND.rsplit(" ", 1)[0], r":2: FLASER with 13 fields; 3 beams, two poses and stamps take 14 .*cut off"),
    ("FLASER 3 1 2", r":2: FLASER with 4 fields; 3 beams, .* take 14 .*cut off"),
    ("FLASER", ":2: FLASER line ends before its number of beams"),
    (SECOND.replace("FLASER 3", "FLASER 4"), ":2: FLASER with 14 fields; 4 beams, .* take 15"),
    (SECOND.replace("FLASER 3", "FLASER 2"), ":2: FLASER with 14 fields; 2 beams, .* take 13"),
    (SECOND.replace("FLASER 3", "FLASER three"), ":2: FLASER with 'three' beams; a whole number"),
    (SECOND.replace("FLASER 3", "FLASER -3"), ":2: FLASER with '-3' beams; a whole number"),
    (flaser([], HERE, 2.0), ":2: FLASER without beams"),
    (flaser([1, "nan", 3], HERE, 2.0), ":2: column range 2: nan is not a range; a number from 0 up"),
    (flaser([1, 2, -3.5], HERE, 2.0), ":2: column range 3: -3.5 is not a range"),
    (flaser([1, "2;0", 3], HERE, 2.0), ":2: column range 2: '2;0' is not a number"),
    (flaser([1, "2_0", 3], HERE, 2.0), ":2: column range 2: '2_0' is not a number"),
    (SECOND.replace("2.0 host", "noon host"), ":2: column stamp: 'noon' is not a number"),
    (SECOND.replace("2.0 host", "nan host"), ":2: column stamp: nan"),
    (SECOND.replace("0.0", "inf", 1), ":2: column x: inf"),
    ("ODOM 1 2 3 0 0 0 now host 1", ":2: column stamp: 'now' is not a number"),
    ("ODOM 1 2 east 0 0 0 5 host 1", ":2: column theta: 'east' is not a number"),
    ("ODOM 1 2 1e99 0 0 0 5 host 1", r":2: column theta: 1e\+99"),
    ("ODOM 1 2 3 0 0", ":2: ODOM with 6 fields; 10 are needed"),
    (LASER.replace(" 3 1 2 3 0 ", " 3 1 2 3 2 "), ":2: ROBOTLASER1 with 27 fields; 3 beams, 2 remissions, .* 29"),
    ("ROBOTLASER1 0 -2 4 0.5 5.6 0.01 0 3 1 2", ":2: ROBOTLASER1 line ends before its number of remissions"),
    (LASER.replace(" 5.6 ", " 0 "), ":2: column max_range: 0 m; a number above 0"),
    (LASER.replace(" 0.5 ", " 0 "), ":2: column resolution: 0 rad between beams"),
    (LASER.replace(" 4.0 ", " wide "), ":2: column fov: 'wide' is not a number"),
])  # fmt: skip
def test_a_fault_in_a_line_is_named(tmp_path, line, message):
    first = LASER if line.startswith("ROBOTLASER1") else FIRST
    (tmp_path / "bad.log").write_text("\n".join([first, line, odom(0, 0, 0, 3.0), ""]))
    with pytest.raises(DataError, match=f"^{tmp_path / 'bad.log'}{message}") as raised:
        load_carmen(tmp_path / "bad.log")
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(("name", "content", "message"), [
    ("none.log", odom(0, 0, 0, 1.0).encode(), "no line of a laser scan; FLASER or ROBOTLASER1"),
    ("table.log", b"1 2 3\n", ".* for slamref convert table .*table.log LOG"),
    ("empty.log", b"", "no line of a laser scan"),
    ("late.log", f"{FIRST}\n{odom(0, 0, 0, 1.0)}\n".encode(), "no scan after the first ODOM line"),
    ("plain.log.gz", SMALL.encode(), "not a gzip file; compress it"),
    ("cut.log.gz", gzip.compress(SMALL.encode(), mtime=0)[:-20], "the gzip file is broken or cut off"),
    ("bent.log.gz", gzip.compress(SMALL.encode(), mtime=0)[:10] + bytes(40), "the gzip file is broken or cut off"),
    ("noise.log", bytes(range(256)), "no line of a laser scan"),
])  # fmt: skip
def test_a_file_that_is_no_laser_log_is_named(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(DataError, match=f"{name}: {message}"):
        load_carmen(tmp_path / name)


def test_missing_files_are_named(tmp_path):
    with pytest.raises(DataError, match=r"none.log: cannot be read: No such file"):
        load_carmen(tmp_path / "none.log")
    (tmp_path / "small.log").write_text(SMALL)
    with pytest.raises(DataError, match=r"none.csv: no such file"):
        load_carmen(tmp_path / "small.log", Path(tmp_path / "none.csv"))


def test_a_file_of_another_name_and_relations_of_another_log_are_usage_errors(tmp_path):
    (tmp_path / "small.xyz").write_text(SMALL)
    with pytest.raises(
        UsageError, match=r"small.xyz: a file of unknown type; expected an open log folder, a CARMEN log"
    ):
        open_log(str(tmp_path / "small.xyz"))
    with pytest.raises(
        UsageError, match=r"--relations r.csv: arena:0 takes none; name a CARMEN log or an open log folder"
    ):
        open_log("arena:0", Reading(relations=Path("r.csv")))


def test_scans_of_a_course_are_in_centimetres_each_at_its_own_odometry(load, tmp_path):
    text = "O 110 0 0 0.1\nL 100 0 0 125 0 0 200 300 8183 0.2\nO 150 0 0 0.3\nL 140 0 0 165 0 0 2e2 3e2 4e2 0.4\n"
    log = load(text)
    scans = log.recorded.scans
    assert log.recorded.prior.mean[0] + log.recorded.increments.mean[:, 0] == pytest.approx([1.0, 1.4])
    assert scans.ranges.tolist() == [[2.0, 3.0, 0.0], [2.0, 3.0, 4.0]]
    assert (scans.scanner.translation, log.notes[1]) == ((-0.25, 0.0), "Lines left out: 2 O.")
    with pytest.raises(UsageError, match="leave the flags out"):
        load_carmen(tmp_path / "small.log", mending=Mending(range_unit="cm"))
    with pytest.raises(DataError, match=r"small.log:3: 'O 150 0 0'; L .* range 3 stamp or O odom_x .* stamp is needed"):
        load(text.replace("O 150 0 0 0.3", "O 150 0 0"))


STAMPED = "row1,row2,x,y,theta,exact,stamp1,stamp2\n0,2,0.3,0.4,0,1,10.02,10.3\n1,3,0,0,0,0,10.5,11\n"


@pytest.fixture
def small(tmp_path: Path) -> Path:
    (tmp_path / "small.log.gz").write_bytes(gzip.compress(SMALL.encode()))
    (tmp_path / "small.relations.csv").write_text(STAMPED)
    return tmp_path / "small.log.gz"


def found(folder: Path) -> tuple[list[str], list[str]]:
    said: list[str] = []
    return [load().name for load in find_logs(folder, said.append)], said


def test_carmen_logs_are_found_and_those_with_relations_stand_for_the_others(small):
    folder = small.parent
    (folder / "other.clf").write_text(SMALL)
    (folder / "run.log").write_text("a program's log, without scans")
    names, said = found(folder)
    assert names == ["small"]
    assert [line.partition(":")[0].rpartition("/")[2] for line in said] == ["other.clf", "run.log"]
    assert "no relations beside it, unlike other logs there" in said[0]
    assert "not a known dataset" in said[1]
    (folder / "small.relations.csv").unlink()
    assert found(folder)[0] == ["other", "small"]


def test_a_converted_log_is_the_same_but_for_its_name(small, tmp_path, capsys):
    assert convert(["carmen", str(small), str(tmp_path / "out")]) == 0
    assert "frames: 4 (1.0 s)" in (said := capsys.readouterr().out)
    assert "scans: 2 of 3 beams" in said
    assert "reference relations: 2" in said
    assert_same_log(load_folder(tmp_path / "out"), dataclasses.replace(open_log(str(small)), name="out"))


def test_a_converted_log_takes_the_relations_asked_for_and_undoes_corrections(small, tmp_path, capsys):
    (tmp_path / "mine.csv").write_text("row1,row2,x,y,theta\n0,3,1,2,3\n")
    flags = ["--relations", str(tmp_path / "mine.csv"), "--undo-correction"]
    assert convert(["carmen", str(small), str(tmp_path / "out"), *flags]) == 0
    assert "Raw odometry recovered" in capsys.readouterr().out
    assert load_folder(tmp_path / "out").truth.relations.row2.tolist() == [3]


def test_the_summary_tells_of_scans_and_relations(small):
    lines = dict(summarize(load_carmen(small)))
    assert lines["scanner"] == (
        "3 beams from -90 to 90 deg, up to 80 m, sigma 0.01 m; p_scanner = R(0 deg) p_body + (-0.25, 0) m"
    )
    assert lines["scans"] == (
        "in 2 of 4 (50.0 %) frames; 3 of 6 (50.0 %) ranges are no return, the others 1 to 3 m, median 2.5 m"
    )
    assert lines["relations"] == "2 relations between 4 frames, 1 exact, with stamps; up to 0.5 m apart"


@pytest.mark.parametrize("logs", [[], ["--log", "arena:0", "--log", "arena:1"]])
def test_relations_belong_to_one_log(logs):
    with pytest.raises(UsageError, match=r"--relations r.csv: belongs to one log; name one log"):
        make_plan(read_options([*logs, "--relations", "r.csv"]), print)
