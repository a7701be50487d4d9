"""A recording, with scans or without, opens as the log it was while it was made; completed, others can read it."""

import shutil

import numpy as np
import pytest

from data.errors import DataError, UsageError
from data.formats.open_log import load_folder
from data.logs import Reading, find_logs, open_log
from tests.builders.logs import same
from tests.wings.robot.line import linked
from wings.robot.driving import WallFollower
from wings.robot.log import Framing, Noise, complete
from wings.robot.packets import command_of
from wings.robot.simulated import Faults, Lidar
from wings.robot.traffic import HEADER, PACKETS, Recording, decoded, read_recording

NOISE = Noise(0.004, 0.006)


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    """A folder with a recording of 20 s on a bad line, and its frames as they came."""
    folder, frames, framing, drive = tmp_path_factory.mktemp("robot") / "log", [], Framing(NOISE), WallFollower()
    command = command_of(0.0, 0.0)
    with Recording(folder, noise=NOISE) as recording:
        link, _, clock = linked(Faults(0.003, 0.001, 0.0), 3, recording=recording)
        while clock.now() < 20.0:
            for packet in link.step(command):
                frames.append(framing.frame(packet))
                command = command_of(*drive(packet))
    return folder, frames


@pytest.fixture
def folder(driven, tmp_path):
    return shutil.copytree(driven[0], tmp_path / "log")


def test_it_holds_the_frames_that_came_to_the_bit(driven):
    folder, frames = driven
    log = open_log(str(folder))
    assert len(log.recorded) == len(frames) > 60
    assert len(log.recorded.observations.frame) > 5
    for k, frame in enumerate(frames):
        again = log.recorded.frame(k)
        assert again.time == frame.time
        assert again.observations.R.tobytes() == frame.observations.R.tobytes()
        assert k == 0 or again.increment.covariance.tobytes() == frame.increment.covariance.tobytes()
    assert log.name == "log"
    assert "Faults of the link" in log.notes[0]


def test_completed_it_is_an_open_log_too_and_still_the_recording(folder):
    before = open_log(str(folder))
    complete(folder)
    assert same(load_folder(folder), before), "read from its CSV files"
    assert same(open_log(str(folder)), before), "read from its packets"
    complete(folder)
    assert not list(folder.glob(".*"))
    (folder / PACKETS).unlink()
    assert same(open_log(str(folder)), before), "without its packets it is an open log like others"


def test_cut_off_it_ends_earlier_and_says_so(folder):
    whole = open_log(str(folder))
    packets = folder / PACKETS
    packets.write_bytes(packets.read_bytes()[: packets.stat().st_size // 2])
    log = open_log(str(folder))
    n = len(log.recorded)
    assert 20 < n < len(whole.recorded)
    assert log.recorded.time.tobytes() == whole.recorded.time[:n].tobytes()
    assert any("truncated" in note for note in log.notes)


def test_without_an_answer_it_is_no_log(tmp_path):
    Recording(tmp_path / "log").close()
    with pytest.raises(DataError, match=r"packets.bin: 0 records, none of them an answer"):
        open_log(str(tmp_path / "log"))


def test_it_is_found_among_other_logs(folder):
    assert [log.name for log in [load() for load in find_logs(folder.parent, print)]] == ["log"]
    with pytest.raises(UsageError, match="--relations"):
        open_log(str(folder), Reading(relations=folder / "x"))


@pytest.mark.parametrize("noise", ["slip = -1.0\nsonar_sigma = 0.1", "slip = 0.1", 'slip = "a"\nsonar_sigma = 0.1'])
def test_noise_that_is_none_is_said(folder, noise):
    header = folder / HEADER
    header.write_text(f'format = 1\nname = "log"\n[source]\nkind = "robot link"\nframed = false\n{noise}\n')
    with pytest.raises(DataError, match=r"slip and sonar_sigma: two numbers"):
        open_log(str(folder))


def test_walls_are_fitted_as_the_recording_says(driven, folder):
    """A recording of before names no fit; one by the author's is replayed by it."""
    usual = open_log(str(driven[0])).recorded.observations.z
    header = folder / HEADER
    told = header.read_text()
    header.write_text(told.replace("[source]\n", '[source]\nfit = "author"\n'))
    records = read_recording(folder).records
    framing = Framing(NOISE, "author")
    frames = [framing.frame(packet) for packet in decoded(records, framed=False)[0]]
    expected = np.concatenate([frame.observations.z for frame in frames])
    found = open_log(str(folder)).recorded.observations.z
    assert found.tobytes() == expected.tobytes()
    assert found.shape != usual.shape or not np.allclose(found, usual, atol=1e-4)
    header.write_text(told.replace("[source]\n", '[source]\nfit = "best"\n'))
    with pytest.raises(DataError, match=r"fit 'best': weighted or author is needed"):
        open_log(str(folder))


def test_where_a_file_cannot_be_written_the_recording_stays_as_it_was_and_it_is_said(folder):
    header = (folder / HEADER).read_bytes()
    (folder / "frames.csv").mkdir()
    with pytest.raises(DataError) as error:
        complete(folder)
    assert str(error.value) == f"{folder}: cannot be written: Is a directory"
    assert (folder / HEADER).read_bytes() == header
    (folder / "frames.csv").rmdir()
    assert same(complete(folder), load_folder(folder))


@pytest.fixture(scope="module")
def with_scans(tmp_path_factory):
    """A recording of 10 s on a bad line, and the packets that came."""
    folder, packets, policy = tmp_path_factory.mktemp("robot") / "log", [], WallFollower()
    command = command_of(0.0, 0.0)
    with Recording(folder, framed=True, noise=(0.005, 0.005), lidar_sigma=0.02) as recording:
        link, _, clock = linked(Faults(2e-5, 2e-5, 0.0), 3, recording=recording, lidar=Lidar())
        while clock.now() < 10.0:
            for packet in link.step(command):
                packets.append(packet)
                command = command_of(*policy(packet))
    return folder, packets


def test_it_holds_the_scans_that_came(with_scans):
    folder, packets = with_scans
    inputs = open_log(str(folder)).inputs()
    with_scan = [k for k, p in enumerate(packets) if p.scan is not None]
    assert 30 < len(with_scan) < len(packets) == len(inputs)
    assert inputs.scans.frame.tolist() == with_scan
    assert inputs.scans.ranges.tobytes() == np.array([packets[k].scan.metres for k in with_scan]).tobytes()
    assert (inputs.scans.scanner.sigma, inputs.scans.scanner.max_range) == (0.02, 8.0)
    assert inputs.scans.scanner.angle_min == pytest.approx(-np.pi, abs=1e-6)
    assert inputs.scans.scanner.angle_step == pytest.approx(np.pi / 180.0, abs=1e-9)


def test_completed_it_is_an_open_log_with_the_same_scans(with_scans):
    folder, _ = with_scans
    recorded = complete(folder).recorded
    read = load_folder(folder).recorded
    assert (folder / "scans.npz").is_file()
    assert read.scans.scanner == recorded.scans.scanner
    for name in ("frame", "ranges"):
        assert getattr(read.scans, name).tobytes() == getattr(recorded.scans, name).tobytes()
    assert read.increments.mean.tobytes() == recorded.increments.mean.tobytes()
    assert read.observations.z.tobytes() == recorded.observations.z.tobytes()


def test_a_stated_sigma_that_is_none_is_refused(with_scans, tmp_path):
    folder, _ = with_scans
    header = (folder / "log.toml").read_text()
    (tmp_path / "packets.bin").write_bytes((folder / "packets.bin").read_bytes())
    (tmp_path / "log.toml").write_text(header.replace("lidar_sigma = 0.02", "lidar_sigma = 0"))
    with pytest.raises(DataError, match="lidar_sigma 0: a number above 0 is needed"):
        open_log(str(tmp_path))
