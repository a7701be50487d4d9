"""Raw odometry comes back out of a log whose poses were corrected at its scans."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from data.errors import DataError
from data.log import Log
from data.se2 import Array, compose
from tests.wings.laser.formats.carmen_text import flaser, odom
from wings.laser.carmen import load_carmen


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


def test_a_robot_at_rest_after_a_correction_keeps_its_frame(tmp_path):
    here, there = (0.0, 0.0, 0.0), (0.5, 0.0, 0.0)
    lines = [odom(*here, 1.0), flaser([1.0], there, 1.0), odom(*there, 2.0), odom(*there, 3.0)]
    (tmp_path / "rest.log").write_text("\n".join(lines))
    log = load_carmen(tmp_path / "rest.log", undo_correction=True)
    assert len(log.recorded) == 3
    assert not log.recorded.increments.mean.any()


def test_without_odom_lines_there_is_nothing_to_recover(tmp_path):
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
    # six significant digits of metres up to 50 from the origin, and of radians
    assert difference[:2].max() < 2e-4
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
