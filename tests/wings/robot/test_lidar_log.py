"""A recording with scans: what `slamref run` reads of it is what came, as packets and as an open log."""

import numpy as np
import pytest

from data.errors import DataError
from data.formats.open_log import load_folder
from data.logs import open_log
from tests.wings.robot.line import linked
from wings.robot.driving import WallFollower
from wings.robot.log import complete
from wings.robot.packets import command_of
from wings.robot.simulated import Faults, Lidar
from wings.robot.traffic import Recording


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
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


def test_it_holds_the_scans_that_came(driven):
    folder, packets = driven
    inputs = open_log(str(folder)).inputs()
    with_scan = [k for k, p in enumerate(packets) if p.scan is not None]
    assert 30 < len(with_scan) < len(packets) == len(inputs)
    assert inputs.scans.frame.tolist() == with_scan
    assert inputs.scans.ranges.tobytes() == np.array([packets[k].scan.metres for k in with_scan]).tobytes()
    assert (inputs.scans.scanner.sigma, inputs.scans.scanner.max_range) == (0.02, 8.0)
    assert inputs.scans.scanner.angle_min == pytest.approx(-np.pi, abs=1e-6)
    assert inputs.scans.scanner.angle_step == pytest.approx(np.pi / 180.0, abs=1e-9)


def test_completed_it_is_an_open_log_with_the_same_scans(driven):
    folder, _ = driven
    recorded = complete(folder).recorded
    read = load_folder(folder).recorded
    assert (folder / "scans.npz").is_file()
    assert read.scans.scanner == recorded.scans.scanner
    for name in ("frame", "ranges"):
        assert getattr(read.scans, name).tobytes() == getattr(recorded.scans, name).tobytes()
    assert read.increments.mean.tobytes() == recorded.increments.mean.tobytes()
    assert read.observations.z.tobytes() == recorded.observations.z.tobytes()


def test_a_stated_sigma_that_is_none_is_refused(driven, tmp_path):
    folder, _ = driven
    header = (folder / "log.toml").read_text()
    (tmp_path / "packets.bin").write_bytes((folder / "packets.bin").read_bytes())
    (tmp_path / "log.toml").write_text(header.replace("lidar_sigma = 0.02", "lidar_sigma = 0"))
    with pytest.raises(DataError, match="lidar_sigma 0: a number above 0 is needed"):
        open_log(str(tmp_path))
