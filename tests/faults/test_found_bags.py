"""Faults that broken bags once met, each in its smallest form."""

import numpy as np
import pytest

from data.errors import DataError

pytest.importorskip("rosbags", reason="rosbags is not installed: pip install 'slamref[ros]'")
from data.formats.bags import laser_log
from tests.data.formats.recordings.ros.bags import Maker
from tests.faults.test_found import peak


def small(form):
    made = Maker(form)
    made.drive(np.arange(0.0, 3.01, 0.5))
    made.scan(1.0, [1.0, 2.0, 3.0])
    return made


def test_a_record_or_file_longer_than_it_is_takes_little_memory(tmp_path):
    (file,) = small("mcap").save(tmp_path).glob("*.mcap")
    content = file.read_bytes()
    file.write_bytes(content[:9] + (1 << 40).to_bytes(8, "little") + content[17:])
    most, said = peak(laser_log, file)
    assert "not a bag that can be read" in said
    assert most < 8 << 20
    assert "expected 1099511627776 bytes" in said


@pytest.mark.parametrize("angle", [np.nan, np.inf, -1e30])
@pytest.mark.parametrize("name", ["angle_min", "angle_increment"])
def test_a_later_scan_without_finite_angles_is_one_line(tmp_path, name, angle):
    """It cannot be resampled to the angles of the others."""
    maker = Maker("mcap")
    maker.drive(np.arange(0.0, 3.01, 0.5))
    for at, changed in ((0.75, {}), (1.0, {}), (1.5, {name: angle})):
        maker.scan(at, [1.0, 0.125, 8.0, 2.0], **changed)
    with pytest.raises(DataError, match=r"message 2.*is no scan") as error:
        laser_log(maker.save(tmp_path), "/scan", "/odom")
    assert "\n" not in str(error.value)
