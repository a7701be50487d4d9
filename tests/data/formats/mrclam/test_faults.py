"""UTIAS MRCLAM: a fault is a `DataError` with its place, whatever is corrupted."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from data.errors import DataError
from data.formats.mrclam import load_mrclam
from data.log import Log
from tests.data.formats.mrclam import world
from tests.data.formats.mrclam.loading import MEASURED, ODOMETRY, TRUTH
from tests.data.formats.mrclam.world import Texts, replace_row, save_folder
from tests.quick import examples


class TestFaults:
    def fails(self, files: Texts, tmp_path: Path, name: str, line: int, *words: str) -> None:
        with pytest.raises(DataError) as caught:
            load_mrclam(save_folder(tmp_path / "set", files), 1)
        message = str(caught.value)
        assert "\n" not in message
        assert f"{name}:{line}" in message
        for word in words:
            assert word in message

    @pytest.mark.parametrize("name", [TRUTH, ODOMETRY, MEASURED])
    def test_a_decreasing_stamp(self, files: Texts, tmp_path: Path, name: str) -> None:
        rest = files[name].splitlines()[20].split(None, 1)[1]
        files[name], line = replace_row(files[name], 16, f"{world.T0 - 5:.3f} {rest}")
        self.fails(files, tmp_path, name, line, "column time", "1248272258.361", "must not decrease")

    @pytest.mark.parametrize("name", [ODOMETRY, MEASURED])
    def test_equal_consecutive_stamps_are_fine(self, files: Texts, load: Callable[..., Log], name: str) -> None:
        lines = files[name].splitlines()
        lines.insert(21, lines[20])
        assert len(load({**files, name: "\n".join(lines) + "\n"}).recorded) == len(load(files).recorded)

    @pytest.mark.parametrize("name", sorted(world.texts()))
    def test_a_truncated_last_line(self, files: Texts, tmp_path: Path, name: str) -> None:
        last = len(files[name].splitlines())
        files[name] = files[name].rstrip().rsplit(None, 1)[0]
        self.fails(files, tmp_path, name, last, "fields where", "cut off")

    @pytest.mark.parametrize("name", [TRUTH, ODOMETRY, MEASURED])
    def test_a_last_number_that_lost_its_tail(self, files: Texts, tmp_path: Path, name: str) -> None:
        last = len(files[name].splitlines())
        files[name] = files[name].rstrip()[:-1]
        self.fails(files, tmp_path, name, last, "cut off")

    def test_a_missing_last_line_end_alone_is_fine(self, files: Texts, load: Callable[..., Log]) -> None:
        bare = {name: text.rstrip() for name, text in files.items()}
        assert len(load(bare).recorded) == len(load(files).recorded)

    @pytest.mark.parametrize(
        ("name", "row", "words"),
        [
            (MEASURED, "T 94 -0.5 0.1", ("column range", "negative")),
            (MEASURED, "T 94.5 0.5 0.1", ("column barcode", "whole number")),
            (MEASURED, "T 94 0.5 nan", ("column bearing", "not a number")),
            (ODOMETRY, "T 0.1", ("2 fields where 3",)),
            (ODOMETRY, "T 0.1 0.2 0.3", ("4 fields where 3",)),
            (ODOMETRY, "T fast 0.2", ("column forward velocity", "'fast'")),
            (ODOMETRY, "T 1_0 0.2", ("column forward velocity", "'1_0'")),
            (TRUTH, "T 0.1 inf 0.2", ("column y", "not a number")),
            ("Barcodes.dat", "6 63", ("column subject", "is in two rows")),
            ("Barcodes.dat", "30 94", ("column barcode", "is in two rows")),
            ("Landmark_Groundtruth.dat", "3 1 2 0 0", ("column subject", "robot")),
            ("Landmark_Groundtruth.dat", "8 1 2 0 0", ("column subject", "two rows")),
        ],
    )
    def test_a_wrong_row_is_named_with_line_and_column(
        self, files: Texts, tmp_path: Path, name: str, row: str, words: tuple[str, ...]
    ) -> None:
        stamp = files[name].splitlines()[14].split()[0]
        files[name], line = replace_row(files[name], 10, row.replace("T", stamp))
        self.fails(files, tmp_path, name, line, *words)

    def test_a_file_without_rows(self, files: Texts, tmp_path: Path) -> None:
        files[ODOMETRY] = "# nothing\n"
        with pytest.raises(DataError, match=rf"{ODOMETRY}:\d+: no rows"):
            load_mrclam(save_folder(tmp_path / "set", files), 1)

    def test_a_stamp_far_in_the_future(self, files: Texts, tmp_path: Path) -> None:
        files[ODOMETRY], line = replace_row(files[ODOMETRY], -1, "9248272263.361 0.4 0.2")
        self.fails(files, tmp_path, ODOMETRY, line, "9248272263.361", "seconds")


CORRUPTIONS = st.sampled_from(["delete", "insert", "replace", "cut", "swap lines", "double line", "drop line"])


@settings(max_examples=examples(120), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    name=st.sampled_from(sorted(world.texts())), how=CORRUPTIONS, where=st.floats(0.0, 1.0, exclude_max=True),
    put=st.sampled_from([*"0123456789-.eE+#nai _\t\n\r\"',\x00", "\xff", "\n\n", "1e400", "-9", "e9"]),
)  # fmt: skip
def test_a_corrupted_folder_is_a_data_error_with_its_place_or_loads_with_finite_numbers(
    tmp_path: Path, name: str, how: str, where: float, put: str
) -> None:
    files = world.texts()
    text, lines = files[name], files[name].splitlines(keepends=True)
    at, line = int(where * len(text)), int(where * len(lines))
    files[name] = {
        "delete": text[:at] + text[at + 1 :],
        "insert": text[:at] + put + text[at:],
        "replace": text[:at] + put + text[at + 1 :],
        "cut": text[:at],
        "swap lines": "".join([*lines[:line], *lines[line : line + 2][::-1], *lines[line + 2 :]]),
        "double line": "".join([*lines[: line + 1], *lines[line:]]),
        "drop line": "".join([*lines[:line], *lines[line + 1 :]]),
    }[how]
    folder = save_folder(tmp_path / "set", files)
    try:
        log = load_mrclam(folder, 1)
    except DataError as error:
        message = str(error)
        assert "\n" not in message
        assert f"{name}:" in message or "no instant with both" in message or "nothing between" in message
        return
    recorded = log.recorded
    for values in (recorded.time, recorded.increments.mean, recorded.increments.covariance, recorded.prior.mean):
        assert np.isfinite(values).all()
    assert np.isfinite(recorded.observations.z).all()
    assert np.isfinite(recorded.observations.R).all()
    assert (np.diff(recorded.time) > 0.0).all()
    assert log.truth.landmark_of is not None
    assert set(log.truth.landmark_of.tolist()) <= set(world.LANDMARKS)
