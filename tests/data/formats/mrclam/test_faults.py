"""UTIAS MRCLAM: a fault is a `DataError` with its place, whatever is corrupted."""

import pytest

from data.errors import DataError
from data.formats.mrclam import load_mrclam
from tests.data.formats.mrclam import world
from tests.data.formats.mrclam.loading import MEASURED, ODOMETRY, TRUTH
from tests.data.formats.mrclam.world import replace_row, save_folder


class TestFaults:
    def fails(self, files, tmp_path, name, line, *words):
        with pytest.raises(DataError) as caught:
            load_mrclam(save_folder(tmp_path / "set", files), 1)
        message = str(caught.value)
        assert "\n" not in message
        assert f"{name}:{line}" in message
        for word in words:
            assert word in message

    @pytest.mark.parametrize("name", [TRUTH, ODOMETRY, MEASURED])
    def test_a_decreasing_stamp(self, files, tmp_path, name):
        rest = files[name].splitlines()[20].split(None, 1)[1]
        files[name], line = replace_row(files[name], 16, f"{world.T0 - 5:.3f} {rest}")
        self.fails(files, tmp_path, name, line, "column time", "1248272258.361", "must not decrease")

    @pytest.mark.parametrize("name", [TRUTH, ODOMETRY, MEASURED])
    def test_a_last_number_that_lost_its_tail(self, files, tmp_path, name):
        last = len(files[name].splitlines())
        files[name] = files[name].rstrip()[:-1]
        self.fails(files, tmp_path, name, last, "cut off")

    @pytest.mark.parametrize(("name", "row", "words"), [
        (MEASURED, "T 94 -0.5 0.1", ("column range", "negative")),
        (MEASURED, "T 94 0.5 nan", ("column bearing", "not a number")),
        (ODOMETRY, "T 0.1", ("2 fields where 3",)),
        (ODOMETRY, "T fast 0.2", ("column forward velocity", "'fast'")),
        (TRUTH, "T 0.1 inf 0.2", ("column y", "not a number")),
        ("Barcodes.dat", "6 63", ("column subject", "is in two rows")),
        ("Landmark_Groundtruth.dat", "3 1 2 0 0", ("column subject", "robot")),
    ])  # fmt: skip
    def test_a_wrong_row_is_named_with_line_and_column(self, files, tmp_path, name, row, words):
        stamp = files[name].splitlines()[14].split()[0]
        files[name], line = replace_row(files[name], 10, row.replace("T", stamp))
        self.fails(files, tmp_path, name, line, *words)

    def test_a_stamp_far_in_the_future(self, files, tmp_path):
        files[ODOMETRY], line = replace_row(files[ODOMETRY], -1, "9248272263.361 0.4 0.2")
        self.fails(files, tmp_path, ODOMETRY, line, "9248272263.361", "seconds")
