"""Every form of the lab's log gives the same frames, and objects are read only when trusted."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io

from tests.wings.camera.lab.handmade import (
    FRAMES,
    LOGS,
    all_frames,
    as_dicts,
    as_structs,
    configuration,
    lab,
    log_arrays,
    refuse,
)
from wings.camera.lab.folder import is_lab, open_lab

# --- forms of the log -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", LOGS)
def test_every_form_of_the_log_gives_the_same_frames_as_often_as_asked(tmp_path: Path, form: str) -> None:
    columns = log_arrays()
    recording = open_lab(lab(tmp_path / "lab", columns=columns, form=form))
    assert len(recording) == FRAMES
    for _ in range(2):
        frames = all_frames(recording)
        assert [f.time for f in frames] == columns["timestamp"].tolist()
        np.testing.assert_array_equal([(f.v, f.omega) for f in frames], columns["commands"])
        np.testing.assert_array_equal([f.rgb for f in frames], columns["rgb"])
        assert all(f.rgb.dtype == np.uint8 and f.rgb.flags.c_contiguous and f.xyz.flags.c_contiguous for f in frames)


@pytest.mark.parametrize("form", LOGS)
def test_pixels_of_zeros_nan_or_infinity_have_no_point(tmp_path: Path, form: str) -> None:
    columns = log_arrays()
    columns["xyz"][:, 5, 5] = [0.0, 0.0, np.inf]
    columns["xyz"][:, 5, 6] = [np.nan, 5.0, 700.0]
    columns["xyz"][:, 5, 7] = [0.0, 0.0, 700.0]
    for frame in open_lab(lab(tmp_path / "lab", columns=columns, form=form)).frames():
        none = np.isnan(frame.xyz)
        assert none[:2, :4].all()
        assert none[5, 5:7].all()
        assert not none[5, 7].any()
        assert none.sum() == 3 * (8 + 2)


@pytest.mark.parametrize(
    "write", [lambda a: a.reshape(1, 2), lambda a: a.reshape(2, 1), lambda a: {"v": a[0], "omega": a[1], "more": 1.0}]
)
def test_commands_may_be_a_row_a_column_or_a_struct(tmp_path: Path, write: Callable[[np.ndarray], Any]) -> None:
    columns: dict[str, Any] = log_arrays()
    plain = columns["commands"]
    columns["commands"] = [write(row) for row in plain]
    frames = all_frames(open_lab(lab(tmp_path / "lab", columns=columns)))
    np.testing.assert_array_equal([(f.v, f.omega) for f in frames], plain)


@pytest.mark.parametrize("form", ["log.mat", "log.npy", "log.npz"])
def test_commands_as_numpy_fields_or_dicts_are_read(tmp_path: Path, form: str) -> None:
    columns: dict[str, Any] = log_arrays()
    plain = columns["commands"]
    columns["commands"] = np.zeros(FRAMES, dtype=[("v", "f8"), ("omega", "f8")])
    columns["commands"]["v"], columns["commands"]["omega"] = plain.T
    frames = all_frames(open_lab(lab(tmp_path / "lab", columns=columns, form=form)))
    np.testing.assert_array_equal([(f.v, f.omega) for f in frames], plain)


@pytest.mark.parametrize("white", [1.0, 255.0])
@pytest.mark.parametrize("form", ["log.mat", "log.npz"])
def test_colours_may_be_fractions_of_1_or_of_255_as_the_first_frame_that_is_not_black_shows(
    tmp_path: Path, form: str, white: float
) -> None:
    columns = log_arrays()
    columns["rgb"][0] = 0
    expected = columns["rgb"]
    columns["rgb"] = columns["rgb"] * (white / 255.0)
    # later frames may be nearly black: they are not taken for another scale
    expected[3] = columns["rgb"][3] = 0
    expected[3, 0, 0], columns["rgb"][3, 0, 0] = 1, white / 255.0
    frames = all_frames(open_lab(lab(tmp_path / "lab", columns=columns, form=form)))
    np.testing.assert_array_equal([f.rgb for f in frames], expected)


def test_whole_numbers_of_other_types_are_colours_too_and_mm_may_be_whole(tmp_path: Path) -> None:
    columns = log_arrays()
    expected = columns["rgb"]
    columns["rgb"] = expected.astype(np.int16)
    columns["xyz"] = np.nan_to_num(columns["xyz"]).astype(np.int16)
    frames = all_frames(open_lab(lab(tmp_path / "lab", columns=columns)))
    np.testing.assert_array_equal([f.rgb for f in frames], expected)
    np.testing.assert_allclose(frames[2].xyz[4, 4], columns["xyz"][2, 4, 4] / 1000.0, rtol=1e-6)


def test_configuration_and_log_may_share_a_file_and_the_log_may_have_another_name_and_more_fields(
    tmp_path: Path,
) -> None:
    folder = lab(tmp_path / "lab")
    columns: dict[str, Any] = log_arrays() | {"disparity": np.zeros((FRAMES, 50))}
    (folder / "log.mat").unlink()
    (folder / "settings.mat").unlink()
    scipy.io.savemat(folder / "All.MAT", configuration() | {"run7": as_structs(columns), "note": "by hand"})
    frames = all_frames(open_lab(folder))
    np.testing.assert_array_equal([f.rgb for f in frames], columns["rgb"])


def test_timestamps_and_commands_of_an_npz_may_be_in_any_order_of_memory(tmp_path: Path) -> None:
    columns = log_arrays()
    plain = columns["commands"]
    columns["commands"] = np.asfortranarray(plain)
    frames = all_frames(open_lab(lab(tmp_path / "lab", columns=columns, form="log.npz")))
    np.testing.assert_array_equal([(f.v, f.omega) for f in frames], plain)


# --- pickles ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["dicts", "list", "structs", "npz"])
def test_objects_are_read_only_when_trusted(tmp_path: Path, kind: str) -> None:
    columns: dict[str, Any] = log_arrays()
    folder = lab(tmp_path / "lab")
    (folder / "log.mat").unlink()
    if kind == "npz":
        rgb = np.empty(FRAMES, object)
        rgb[:] = list(columns["rgb"])
        np.savez(folder / "log.npz", **(columns | {"rgb": rgb}))
    else:
        one = np.array(None, object)
        one[()] = list(as_dicts(columns))
        log = {"dicts": as_dicts(columns), "list": one, "structs": as_structs(columns)}[kind]
        np.save(folder / "log.npy", log)
    refuse(folder, "pickle.*can run code.*--trust-pickle")
    frames = all_frames(open_lab(folder, trust_pickle=True))
    np.testing.assert_array_equal([f.rgb for f in frames], columns["rgb"])
    np.testing.assert_array_equal([(f.v, f.omega) for f in frames], columns["commands"])


def test_a_refused_pickle_runs_nothing(tmp_path: Path) -> None:
    folder = lab(tmp_path / "lab")
    (folder / "log.mat").unlink()
    array = np.empty(1, object)
    array[0] = _Trap(str(tmp_path / "sprung"))
    np.save(folder / "log.npy", array)
    assert is_lab(folder)
    refuse(folder, "--trust-pickle")
    assert not (tmp_path / "sprung").exists()


class _Trap:
    def __init__(self, path: str) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return open, (self.path, "w")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (np.array([1, "two"], object), r"\[0\]: a int; a dict of the frame's fields is needed"),
        (np.array(7, object), "holds one int; a list of dicts, one per frame, or a dict of arrays"),
        (np.array({"rgb": 1}, object), "the log has no timestamp"),
        (np.array([{"rgb": 1}], object), "the log has no timestamp"),
        (np.array([], object), "the log has no timestamp"),
    ],
)
def test_trusted_objects_of_another_shape_are_refused(tmp_path: Path, content: Any, said: str) -> None:
    folder = lab(tmp_path / "lab")
    (folder / "log.mat").unlink()
    np.save(folder / "log.npy", content)
    refuse(folder, said, trust_pickle=True)


def test_a_trusted_frame_without_a_field_or_with_ragged_values_is_named(tmp_path: Path) -> None:
    folder = lab(tmp_path / "lab")
    (folder / "log.mat").unlink()
    log = as_dicts(log_arrays())
    del log[2]["xyz"]
    np.save(folder / "log.npy", log)
    refuse(folder, r"\[2\]\['xyz'\]: missing", trust_pickle=True)
    log[1]["rgb"] = [[1, 2], [3]]
    np.save(folder / "log.npy", log)
    refuse(folder, r"\[1\]\['rgb'\]: .*inhomogeneous", trust_pickle=True)
