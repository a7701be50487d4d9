"""The lab's format: units, readings of R and T, every file form, what is written is read, faults are named."""

from __future__ import annotations

import math
import subprocess
import sys
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import scipy.io

from data.errors import DataError, UsageError
from data.inputs import Prior
from data.pictures import VisualFrame, VisualSetup
from data.visual.lab.folder import LabRecording, is_lab, open_lab, unit_suspicion, write_lab
from data.visual.lab.mat_writer import write_struct_array

FRAMES, H, W = 4, 12, 16
Config = dict[str, dict[str, Any]]


def configuration() -> Config:
    """In the file's units: two pictures 50 cm wide on the wall x = 400 cm; the camera looks ahead, 12 cm before."""
    return {
        "camera_to_body": {"R": np.array([[0.0, -1.0], [1.0, 0.0]]), "T": np.array([[3.0], [-12.0]])},
        "landmark": {
            "xpos": np.full((2, 4), 400.0),
            "ypos": np.array([[75.0, 25.0, 25.0, 75.0], [-25.0, -75.0, -75.0, -25.0]]),
        },
        "pose_init": {"x0": 100, "y0": -20.0, "theta0": 30.0, "sigma_x": 5.0, "sigma_y": 4.0, "sigma_theta": 2.0},
    }


def log_arrays() -> dict[str, np.ndarray]:
    """Columns of a log in the file's units."""
    rng = np.random.default_rng(5)
    xyz = rng.uniform(500, 4000, (FRAMES, H, W, 3)).astype(np.float32)
    xyz[:, 0, :4] = 0
    xyz[:, 1, :4] = np.nan
    return {
        "timestamp": np.array([10.0, 10.1, 10.25, 10.3]),
        "commands": rng.normal(size=(FRAMES, 2)),
        "rgb": rng.integers(0, 256, (FRAMES, H, W, 3), dtype=np.uint8),
        "xyz": xyz,
    }


def as_structs(columns: dict[str, Any]) -> np.ndarray:
    """A log as scipy.io wants a struct array."""
    log = np.zeros((1, len(columns["timestamp"])), dtype=[(name, object) for name in columns])
    for i in range(log.size):
        for name, column in columns.items():
            log[0, i][name] = column[i]
    return log


def as_records(columns: dict[str, np.ndarray]) -> np.ndarray:
    log = np.zeros(FRAMES, dtype=[(n, c.dtype, c.shape[1:]) for n, c in columns.items()])
    for name, column in columns.items():
        log[name] = column
    return log


def as_dicts(columns: dict[str, np.ndarray]) -> np.ndarray:
    log = np.empty(len(columns["timestamp"]), object)
    log[:] = [{n: c[i] for n, c in columns.items()} for i in range(len(log))]
    return log


LOGS: dict[str, Callable[[Path, Any], object]] = {
    "log.mat": lambda path, c: scipy.io.savemat(path, {"log": as_structs(c)}, do_compression=True),
    "plain.mat": lambda path, c: scipy.io.savemat(path, {"log": as_structs(c)}),
    "log.npy": lambda path, c: np.save(path, as_records(c)),
    "log.npz": lambda path, c: np.savez_compressed(path, **c),
}


def lab(
    folder: Path, config: Config | None = None, columns: dict[str, Any] | None = None, *, form: str = "log.mat"
) -> Path:
    """A folder in the lab's format, made without the code under test."""
    images = folder / "landmark"
    images.mkdir(parents=True)
    scipy.io.savemat(folder / "settings.mat", configuration() if config is None else config)
    LOGS[form](folder / form, log_arrays() if columns is None else columns)
    for i in range(2):
        cv2.imwrite(str(images / f"landmark{i + 1}.png"), np.full((6, 8, 3), (10 + i, 20, 30), np.uint8))
    return folder


class Made:
    """A recording in memory."""

    def __init__(self, *, says: int = FRAMES, prior: Prior | None = None) -> None:
        rng = np.random.default_rng(2)
        corners = rng.normal(size=(12, 4, 2))
        self.setup = VisualSetup(1.2, (0.03, -0.2), corners, prior or Prior(np.array([1.0, 2.0, -3.0]), np.eye(3) / 9))
        self.references = [rng.integers(0, 256, (5, 7, 3), dtype=np.uint8) for _ in range(12)]
        self._says = says
        self._frames = []
        for i in range(FRAMES):
            xyz = rng.normal(size=(H, W, 3)).astype(np.float32)
            xyz[i] = np.nan
            rgb = rng.integers(0, 256, (H, W, 3), dtype=np.uint8)
            self._frames.append(VisualFrame(0.1 * i, rng.normal(), rng.normal(), rgb, xyz))

    def __len__(self) -> int:
        return self._says

    def frames(self) -> Iterator[VisualFrame]:
        return iter(self._frames)


def all_frames(recording: LabRecording) -> list[VisualFrame]:
    return list(recording.frames())


def refuse(folder: Path, said: str, **options: Any) -> None:
    with pytest.raises(DataError, match=said) as caught:
        all_frames(open_lab(folder, **options))
    assert "\n" not in str(caught.value)
    assert str(folder) in str(caught.value)


# --- units: each of these fails when the one conversion it names is removed -------------------------------------------


def test_the_map_is_in_cm(tmp_path: Path) -> None:
    setup = open_lab(lab(tmp_path / "lab")).setup
    np.testing.assert_allclose(setup.corners[0], [[4, 0.75], [4, 0.25], [4, 0.25], [4, 0.75]], rtol=1e-15)
    np.testing.assert_allclose(setup.width, [0.5, 0.5])


def test_the_first_pose_is_in_cm(tmp_path: Path) -> None:
    np.testing.assert_allclose(open_lab(lab(tmp_path / "lab")).setup.prior.mean[:2], [1.0, -0.2])


def test_theta0_is_in_degrees(tmp_path: Path) -> None:
    assert open_lab(lab(tmp_path / "lab")).setup.prior.mean[2] == pytest.approx(math.pi / 6)


def test_sigma_of_the_position_is_a_standard_deviation_in_cm(tmp_path: Path) -> None:
    covariance = open_lab(lab(tmp_path / "lab")).setup.prior.covariance
    np.testing.assert_allclose(np.diag(covariance)[:2], [0.05**2, 0.04**2])
    assert np.count_nonzero(covariance) == 3


def test_sigma_of_the_heading_is_a_standard_deviation_in_degrees(tmp_path: Path) -> None:
    variance = open_lab(lab(tmp_path / "lab")).setup.prior.covariance[2, 2]
    assert variance == pytest.approx((2.0 * math.pi / 180) ** 2)


@pytest.mark.parametrize("form", LOGS)
def test_xyz_is_in_mm(tmp_path: Path, form: str) -> None:
    columns = log_arrays()
    recording = open_lab(lab(tmp_path / "lab", columns=columns, form=form))
    for frame, xyz in zip(recording.frames(), columns["xyz"], strict=True):
        assert frame.xyz.dtype == np.float32
        np.testing.assert_allclose(frame.xyz[2:], xyz[2:] / 1000.0, rtol=1e-6)


@pytest.mark.parametrize(("unit", "metres"), [("cm", 0.01), ("mm", 0.001), ("m", 1.0)])
def test_T_is_in_the_unit_asked_for(tmp_path: Path, unit: str, metres: float) -> None:
    recording = open_lab(lab(tmp_path / "lab"), translation_unit=unit)
    assert recording.setup.translation == pytest.approx((3.0 * metres, -12.0 * metres))
    assert f"T in {unit}" in recording.notes[0]


def test_T_is_in_cm_unless_said_otherwise(tmp_path: Path) -> None:
    assert open_lab(lab(tmp_path / "lab")).setup.translation == pytest.approx((0.03, -0.12))


# --- the reading of R and T -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("reading", ["to-camera", "to-body"])
def test_R_and_T_lead_from_body_to_camera_or_back(tmp_path: Path, reading: str) -> None:
    config = configuration()
    angle = 1.3
    R = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    config["camera_to_body"]["R"] = R
    setup = open_lab(lab(tmp_path / "lab", config), reading=reading).setup
    T, p = np.array([0.03, -0.12]), np.array([1.5, 0.4])
    there = R @ p + T if reading == "to-camera" else np.linalg.solve(R, p - T)
    c, s = math.cos(setup.rotation), math.sin(setup.rotation)
    np.testing.assert_allclose(np.array([[c, -s], [s, c]]) @ p + setup.translation, there, atol=1e-14)


def test_unknown_units_and_readings_are_refused(tmp_path: Path) -> None:
    folder = lab(tmp_path / "lab")
    with pytest.raises(UsageError, match="'inch'; known: cm, mm, m"):
        open_lab(folder, translation_unit="inch")
    with pytest.raises(UsageError, match="'both'; known: to-camera, to-body"):
        open_lab(folder, reading="both")


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


def test_one_frame_with_points_is_enough(tmp_path: Path) -> None:
    columns = log_arrays()
    columns["xyz"][[0, 2, 3]] = 0
    frames = all_frames(open_lab(lab(tmp_path / "lab", columns=columns)))
    assert [bool(np.isfinite(f.xyz).any()) for f in frames] == [False, True, False, False]


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
    refuse(folder, "pickle.*can run any code.*--trust-pickle")
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
        (np.array({"rgb": 1}, object), "holds one dict; a list of dicts"),
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


# --- reference images -------------------------------------------------------------------------------------------------


def test_reference_images_come_as_rgb_in_the_natural_order_of_their_names(tmp_path: Path) -> None:
    config = configuration()
    config["landmark"] = {"xpos": np.zeros((11, 4)), "ypos": np.tile([1.0, 0.0, 0.0, 1.0], (11, 1))}
    folder = lab(tmp_path / "lab", config)
    for i in range(11):
        blue_green_red = np.full((3, 4, 3), (7, 100, 10 * (i + 1)), np.uint8)
        cv2.imwrite(str(folder / "landmark" / f"landmark{i + 1}.png"), blue_green_red)
    (folder / "landmark" / "Thumbs.db").write_bytes(b"not an image")
    (folder / "landmark" / "._landmark1.png").write_bytes(b"left by a Mac")
    recording = open_lab(folder)
    assert [r[0, 0].tolist() for r in recording.references] == [[10 * (i + 1), 100, 7] for i in range(11)]
    assert "Thumbs.db" in recording.notes[1]


def test_an_image_that_cannot_be_read_and_a_wrong_number_of_images_are_named(tmp_path: Path) -> None:
    folder = lab(tmp_path / "lab")
    for content in (b"", b"no image at all"):
        (folder / "landmark" / "landmark2.png").write_bytes(content)
        refuse(folder, "landmark2.png: not an image that can be read")
    (folder / "landmark" / "landmark2.png").unlink()
    refuse(folder, r"settings.mat: landmark.xpos: 2 rows, but .*landmark holds 1 images \(landmark1.png\)")
    (folder / "landmark" / "landmark1.png").unlink()
    (folder / "landmark").rmdir()
    refuse(folder, r"landmark: missing; a folder with one reference image per picture")


# --- the folder -------------------------------------------------------------------------------------------------------


def test_a_lab_folder_is_known_by_what_it_holds(tmp_path: Path) -> None:
    folder = lab(tmp_path / "lab")
    assert is_lab(folder)
    assert not is_lab(tmp_path / "nowhere")
    assert not is_lab(tmp_path)
    other = tmp_path / "other"
    other.mkdir()
    scipy.io.savemat(other / "x.mat", {"x": 1.0})
    np.save(other / "y.npy", np.zeros(3))
    np.savez(other / "z.npz", z=np.zeros(3))
    (other / "broken.mat").write_bytes(b"broken")
    assert not is_lab(other)
    (folder / "settings.mat").rename(other / "a.mat")
    assert is_lab(other)
    assert is_lab(folder)


def test_missing_and_doubled_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="nowhere: not a folder"):
        open_lab(tmp_path / "nowhere")
    folder = lab(tmp_path / "lab")
    content = (folder / "settings.mat").read_bytes()
    (folder / "again.mat").write_bytes(content)
    refuse(folder, r"again.mat, settings.mat each hold a configuration; one")
    (folder / "again.mat").unlink()
    np.savez(folder / "second.npz", **log_arrays())  # type: ignore[arg-type]
    refuse(folder, r"log.mat:log, second.npz each hold a log; one")
    (folder / "second.npz").unlink()
    (folder / "log.mat").rename(tmp_path / "log.mat")
    refuse(folder, r"no log found \(there: settings.mat\); a .mat with the struct array log, or a .npy or .npz")
    (tmp_path / "log.mat").rename(folder / "log.mat")
    (folder / "settings.mat").unlink()
    refuse(folder, r"no configuration found \(there: log.mat\); a .mat with camera_to_body, landmark, pose_init")


def test_two_logs_in_a_file_are_refused(tmp_path: Path) -> None:
    folder = lab(tmp_path / "lab")
    scipy.io.savemat(folder / "log.mat", {"log": as_structs(log_arrays()), "log2": as_structs(log_arrays())})
    refuse(folder, "log.mat:log, log.mat:log2 each hold a log; one per folder is needed")


def test_a_file_that_does_not_open_is_named_only_if_one_is_missing(tmp_path: Path) -> None:
    folder = lab(tmp_path / "lab")
    (folder / "extra.mat").write_bytes(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + bytes(500))
    assert len(all_frames(open_lab(folder))) == FRAMES
    (folder / "extra.mat").rename(folder / "log.mat")
    refuse(folder, r"log.mat: MATLAB 7.3 \(HDF5\), which is not read; save it with -v7")


@pytest.mark.parametrize("form", LOGS)
def test_the_digest_depends_on_configuration_log_and_images_alone(tmp_path: Path, form: str) -> None:
    folder = lab(tmp_path / "lab", form=form)
    digest = open_lab(folder).digest()
    (folder / "other.txt").write_text("beside")
    folder = folder.rename(tmp_path / "moved")
    assert open_lab(folder, translation_unit="m").digest() == digest
    for name in ("settings.mat", form, "landmark/landmark2.png"):
        path = folder / name
        content = path.read_bytes()
        at = 20 if name.endswith(".mat") else len(content) - 30
        recording = open_lab(folder)
        path.write_bytes(content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :])
        assert recording.digest() != digest, name
        path.write_bytes(content)
    assert open_lab(folder).digest() == digest


# --- faults of the configuration --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("part", "field", "value", "said"),
    [
        ("camera_to_body", "R", [[0, 1], [1, 0]], r"R: \[\[0.0, 1.0\], \[1.0, 0.0\]\] mirrors \(det -1\)"),
        ("camera_to_body", "R", [[0, -1.1], [1, 0]], r"R: .*-1.1.* is no rotation; R R' = I is needed"),
        ("camera_to_body", "R", np.eye(3), r"R: size 3x3; a rotation matrix, 2x2"),
        ("camera_to_body", "R", [[np.nan, 1], [1, 0]], r"R\(1,1\): nan is not a number"),
        ("camera_to_body", "T", [1.0, 2.0, 3.0], r"T: size 1x3; 2 numbers needed"),
        ("camera_to_body", "T", [1.0, np.inf], r"T\(1,2\): inf is not a number"),
        ("camera_to_body", "T", None, r"camera_to_body: no field T; R, T are needed"),
        ("landmark", "xpos", np.zeros((4, 2)), r"landmark.xpos: size 4x2; a row of 4 corners per picture"),
        ("landmark", "ypos", np.zeros((3, 4)), r"landmark.ypos: size 3x4, but xpos has size 2x4"),
        ("landmark", "ypos", [[1, 0, 0, 1], [1, 0, np.nan, 1]], r"landmark.ypos\(2,3\): nan"),
        ("landmark", "ypos", [[1, 0, 0, 1], [1, 1, 0, 0]], r"xpos\(2,:\), ypos\(2,:\): a picture without width"),
        ("landmark", "ypos", None, r"landmark: no field ypos"),
        ("landmark", "xpos", "text", r"landmark.xpos: text; numbers are needed"),
        ("landmark", "xpos", {"a": 1}, r"landmark.xpos: a struct; numbers are needed"),
        ("pose_init", "theta0", np.nan, r"theta0\(1,1\): nan"),
        ("pose_init", "x0", [1, 2], r"x0: size 1x2; one number needed"),
        ("pose_init", "sigma_y", -3.0, r"sigma_y: -3; a standard deviation is not negative"),
        ("pose_init", "sigma_theta", None, r"no field sigma_theta; x0, y0, theta0, sigma_x, sigma_y, sigma_theta"),
        ("pose_init", None, None, r"no struct pose_init; camera_to_body, landmark, pose_init are needed"),
        ("landmark", None, [1, 2, 3], r"landmark: numbers of size 1x3; one struct is needed"),
    ],
)
def test_faults_of_the_configuration_name_field_value_and_what_would_be_right(
    tmp_path: Path, part: str, field: str | None, value: Any, said: str
) -> None:
    config: dict[str, Any] = configuration()
    table, key = (config, part) if field is None else (config[part], field)
    if value is None:
        del table[key]
    else:
        table[key] = value
    refuse(lab(tmp_path / "lab", config), "settings.mat: .*" + said)


def test_a_matrix_typed_with_four_digits_is_a_rotation(tmp_path: Path) -> None:
    config = configuration()
    config["camera_to_body"]["R"] = np.array([[0.2675, -0.9636], [0.9636, 0.2675]])
    assert open_lab(lab(tmp_path / "lab", config)).setup.rotation == pytest.approx(1.3, abs=1e-4)


# --- faults of the log ------------------------------------------------------------------------------------------------


def put(field: str, frame: int, value: Any) -> Callable[[dict[str, Any]], None]:
    def change(columns: dict[str, Any]) -> None:
        columns[field] = list(columns[field])
        columns[field][frame] = value

    return change


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (put("timestamp", 2, 10.1), r"log\(3\).timestamp: 10.1 s is not after 10.1 s, the frame before"),
        (put("timestamp", 1, np.nan), r"log\(2\).timestamp: nan is not a number"),
        (put("timestamp", 1, [1.0, 2.0]), r"log\(2\).timestamp: size 1x2; one number is needed in each frame"),
        (put("commands", 3, [0.1, np.nan]), r"log\(4\).commands: nan is not a number"),
        (put("commands", 3, [0.1, 0.2, 0.3]), r"log\(4\).commands: size 1x3; 2 numbers are needed"),
        (put("commands", 0, {"v": 1.0, "w": 2.0}), r"log\(1\).commands: no field omega"),
        (put("commands", 0, {"v": 1.0, "omega": np.inf}), r"log\(1\).commands.omega: inf"),
        (put("rgb", 1, np.zeros((H, W))), r"log\(2\).rgb: size 12x16; H x W x 3 is needed"),
        (put("rgb", 1, np.zeros((H, W, 4), np.uint8)), r"log\(2\).rgb: size 12x16x4; H x W x 3 is needed"),
        (put("rgb", 1, np.zeros((0, 0))), r"log\(2\).rgb: size 0x0"),
        (put("rgb", 1, "an image"), r"log\(2\).rgb: text; numbers are needed"),
        (put("rgb", 1, np.zeros((H, W, 3)) + 1j), r"log\(2\).rgb: complex numbers; numbers are needed"),
        (put("rgb", 0, np.full((H, W, 3), 300.0)), r"log\(1\).rgb: colour 300; 0 to 255 is needed"),
        (put("rgb", 0, np.full((H, W, 3), np.nan)), r"log\(1\).rgb: colour nan"),
        (put("rgb", 2, np.full((H, W, 3), -1, np.int16)), r"log\(3\).rgb: colour -1"),
        (put("rgb", 3, np.zeros((W, H, 3), np.uint8)), r"log\(4\).rgb: size 16x12x3, but the first frame has 12x16x3"),
        (put("xyz", 3, np.zeros((W, H, 3))), r"log\(4\).xyz: size 16x12x3, but rgb has 12x16x3"),
        (put("xyz", 3, {"x": 1.0}), r"log\(4\).xyz: a struct; numbers are needed"),
        (lambda c: c.update(xyz=c["xyz"] * 0), r"xyz: not one valid point in 4 frames; mm"),
        (lambda c: c.update(xyz=c["xyz"] * np.nan), r"xyz: not one valid point in 4 frames; mm"),
        (lambda c: c.pop("xyz"), r"the log has no xyz; timestamp, commands, rgb, xyz are needed"),
        (lambda c: c.update(timestamp=[]), r"the log has no frames"),
    ],
)
def test_faults_of_a_log_name_frame_field_value_and_what_would_be_right(
    tmp_path: Path, change: Callable[[dict[str, Any]], None], said: str
) -> None:
    columns: dict[str, Any] = log_arrays()
    change(columns)
    refuse(lab(tmp_path / "lab", columns=columns), f"log.mat: {said}")


def test_colours_that_change_their_scale_are_refused(tmp_path: Path) -> None:
    columns = log_arrays()
    columns["rgb"] = columns["rgb"] / 255.0
    columns["rgb"][2] *= 255.0
    refuse(
        lab(tmp_path / "lab", columns=columns),
        r"log\(3\).rgb: colour 2\d\d; 0 to 1 is needed \(as in the frames before",
    )


@pytest.mark.parametrize(("form", "place"), [("log.npy", r"\[2\]\['commands'\]"), ("log.npz", r"commands\[2\]")])
def test_faults_in_arrays_are_named_as_numpy_counts(tmp_path: Path, form: str, place: str) -> None:
    columns = log_arrays()
    columns["commands"][2, 0] = np.nan
    refuse(lab(tmp_path / "lab", columns=columns, form=form), f"{form}: {place}: nan is not a number")


def test_a_log_that_is_no_struct_array_is_refused(tmp_path: Path) -> None:
    folder = lab(tmp_path / "lab")
    scipy.io.savemat(folder / "log.mat", {"log": as_dicts(log_arrays())})
    refuse(folder, "log is of kind cell array; a struct array, one element per frame, is needed")
    scipy.io.savemat(folder / "log.mat", {"log": log_arrays()})
    refuse(folder, r"log\(1\).timestamp: size 1x4; one number is needed in each frame")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda c: c.update(rgb=c["rgb"][:3]), "rows: timestamp 4, commands 4, rgb 3, xyz 4; as many rows as frames"),
        (lambda c: c.update(rgb=np.asfortranarray(c["rgb"])), "rgb: in Fortran order, frames are not in one piece"),
        (lambda c: c.update(timestamp=np.array(3.0)), "timestamp: a single value; one row per frame is needed"),
        (lambda c: c.pop("commands"), "the log has no commands"),
        (lambda c: c.update({k: v[:0] for k, v in c.items()}), "the log has no frames"),
    ],
)
def test_faults_of_an_archive_are_named(
    tmp_path: Path, change: Callable[[dict[str, np.ndarray]], None], said: str
) -> None:
    columns = log_arrays()
    change(columns)
    refuse(lab(tmp_path / "lab", columns=columns, form="log.npz"), f"log.npz: {said}")


@pytest.mark.parametrize("form", LOGS)
def test_a_log_cut_short_is_damaged(tmp_path: Path, form: str) -> None:
    folder = lab(tmp_path / "lab", form=form)
    content = (folder / form).read_bytes()
    (folder / form).write_bytes(content[: len(content) * 2 // 3])
    refuse(folder, f"{form}: damaged: ")


def test_an_npy_cut_short_is_named_before_the_first_frame(tmp_path: Path) -> None:
    folder = lab(tmp_path / "lab", form="log.npy")
    content = (folder / "log.npy").read_bytes()
    (folder / "log.npy").write_bytes(content[:-1])
    with pytest.raises(DataError, match=r"damaged: ends early: 4 frames of 2904 bytes are announced and 11615 bytes"):
        open_lab(folder)


def test_a_member_of_an_archive_that_is_short_or_flipped_is_damaged(tmp_path: Path) -> None:
    folder = lab(tmp_path / "lab", form="log.npz")
    path = folder / "log.npz"
    with zipfile.ZipFile(path) as archive:
        members = {n: archive.read(n) for n in archive.namelist()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content[:-500] if name == "rgb.npy" else content)
    refuse(folder, "log.npz: damaged: ends early: 4 frames are announced and 3 are there")
    np.savez(path, **log_arrays())  # type: ignore[arg-type]
    content = bytearray(path.read_bytes())
    content[len(content) * 3 // 4] ^= 1
    path.write_bytes(content)
    refuse(folder, "log.npz: damaged: Bad CRC-32")


# --- writing ----------------------------------------------------------------------------------------------------------


def check_written(folder: Path, made: Made) -> None:
    recording = open_lab(folder)
    np.testing.assert_allclose(recording.setup.rotation, made.setup.rotation, rtol=1e-14)
    np.testing.assert_allclose(recording.setup.translation, made.setup.translation, rtol=1e-14)
    np.testing.assert_allclose(recording.setup.corners, made.setup.corners, rtol=1e-14)
    np.testing.assert_allclose(recording.setup.prior.mean, made.setup.prior.mean, rtol=1e-14)
    np.testing.assert_allclose(recording.setup.prior.covariance, made.setup.prior.covariance, rtol=1e-14)
    assert len(recording.references) == 12
    for read, written in zip(recording.references, made.references):
        np.testing.assert_array_equal(read, written)
    for got, given in zip(recording.frames(), made.frames(), strict=True):
        assert (got.time, got.v, got.omega) == (given.time, given.v, given.omega)
        np.testing.assert_array_equal(got.rgb, given.rgb)
        np.testing.assert_allclose(got.xyz, given.xyz, rtol=3e-7)


@pytest.mark.parametrize("form", ["mat", "npy", "npz"])
def test_what_is_written_is_read(tmp_path: Path, form: str) -> None:
    write_lab(tmp_path / "out" / "lab", Made(), form=form)
    assert sorted(p.name for p in (tmp_path / "out" / "lab").iterdir()) == ["config.mat", "landmark", f"log.{form}"]
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["lab"]
    check_written(tmp_path / "out" / "lab", Made())
    (tmp_path / "empty").mkdir()
    write_lab(tmp_path / "empty", Made(), form=form)


def test_what_is_written_is_what_scipy_and_numpy_read_in_the_files_units(tmp_path: Path) -> None:
    made = Made()
    given = list(made.frames())
    for form in ("mat", "npy", "npz"):
        write_lab(tmp_path / form, made, form=form)
    mat = scipy.io.loadmat(tmp_path / "mat" / "log.mat")["log"]
    assert mat.shape == (1, FRAMES)
    assert mat.dtype.names == ("timestamp", "commands", "rgb", "xyz")
    npy, npz = np.load(tmp_path / "npy" / "log.npy"), np.load(tmp_path / "npz" / "log.npz")
    for i, frame in enumerate(given):
        mm = np.nan_to_num(frame.xyz * np.float32(1000.0))
        element = mat[0, i]
        assert (element["rgb"].dtype, element["xyz"].dtype) == (np.uint8, np.float32)
        assert element["timestamp"].shape == (1, 1)
        for rgb, xyz, time, commands in (
            (element["rgb"], element["xyz"], element["timestamp"], element["commands"]),
            (npy["rgb"][i], npy["xyz"][i], npy["timestamp"][i], npy["commands"][i]),
            (npz["rgb"][i], npz["xyz"][i], npz["timestamp"][i], npz["commands"][i]),
        ):
            np.testing.assert_array_equal(rgb, frame.rgb)
            np.testing.assert_allclose(xyz, mm, rtol=3e-7)
            assert time == frame.time
            np.testing.assert_array_equal(np.ravel(commands), [frame.v, frame.omega])
    config = scipy.io.loadmat(tmp_path / "mat" / "config.mat", squeeze_me=True)
    c, s = math.cos(1.2), math.sin(1.2)
    np.testing.assert_allclose(config["camera_to_body"]["R"].item(), [[c, -s], [s, c]])
    np.testing.assert_allclose(config["camera_to_body"]["T"].item(), [3.0, -20.0])
    np.testing.assert_allclose(config["landmark"]["xpos"].item(), made.setup.corners[..., 0] * 100)
    pose = config["pose_init"]
    got = [pose[name].item() for name in ("x0", "y0", "theta0", "sigma_x", "sigma_y", "sigma_theta")]
    np.testing.assert_allclose(got, [100, 200, -540 / math.pi, 100 / 3, 100 / 3, 60 / math.pi])


def test_a_point_known_in_part_is_written_as_none(tmp_path: Path) -> None:
    made = Made()
    next(made.frames()).xyz[9, 9] = [1.0, np.nan, 2.0]
    write_lab(tmp_path / "lab", made)
    first = next(open_lab(tmp_path / "lab").frames())
    assert np.isnan(first.xyz[9, 9]).all()


def test_writing_refuses_a_folder_in_use_an_unknown_form_and_a_correlated_prior(tmp_path: Path) -> None:
    (tmp_path / "used").mkdir()
    (tmp_path / "used" / "thesis.tex").write_text("long work")
    with pytest.raises(DataError, match="used: exists and is not an empty folder; choose another name"):
        write_lab(tmp_path / "used", Made())
    assert (tmp_path / "used" / "thesis.tex").read_text() == "long work"
    with pytest.raises(UsageError, match="'hdf5'; known: mat, npy, npz"):
        write_lab(tmp_path / "new", Made(), form="hdf5")
    correlated = Prior(np.zeros(3), np.eye(3) + 0.1)
    with pytest.raises(DataError, match="prior's covariance is not diagonal"):
        write_lab(tmp_path / "new", Made(prior=correlated))
    assert [p.name for p in tmp_path.iterdir()] == ["used"]


@pytest.mark.parametrize("form", ["mat", "npy", "npz"])
def test_a_recording_with_more_or_fewer_frames_than_it_says_leaves_nothing_behind(tmp_path: Path, form: str) -> None:
    with pytest.raises(DataError, match="says 5 frames and has 4"):
        write_lab(tmp_path / "lab", Made(says=5), form=form)
    with pytest.raises(DataError, match=r"frame 3 of the recording: .*; 3 frames of"):
        write_lab(tmp_path / "lab", Made(says=3), form=form)
    assert not list(tmp_path.iterdir())


def test_a_log_beyond_2_gib_is_refused_as_mat_at_the_first_frame(tmp_path: Path) -> None:
    def endless() -> Iterator[dict[str, np.ndarray]]:
        yield {"a": np.zeros(1000)}
        raise AssertionError("the second element is not asked for")

    with (tmp_path / "x.mat").open("wb") as file, pytest.raises(DataError, match=r"x.mat: 2\.\d GiB.*npy or npz"):
        write_struct_array(file, "x.mat", "log", ("a",), 280_000, endless())


# --- does it fit? -----------------------------------------------------------------------------------------------------


def seen_from(
    setup: VisualSetup, pose: tuple[float, float, float], rng: np.random.Generator, *, noise: float = 1.0
) -> np.ndarray:
    """Corners (L, 4, 3) as a camera sees them, with the lab's noise or so many times it; the formulas written out."""
    x, y, theta = pose
    dx, dy = setup.corners[..., 0] - x, setup.corners[..., 1] - y
    forward = math.cos(theta) * dx + math.sin(theta) * dy
    left = -math.sin(theta) * dx + math.cos(theta) * dy
    c, s = math.cos(setup.rotation), math.sin(setup.rotation)
    points = np.zeros((*dx.shape, 3))
    points[..., 0] = c * forward - s * left + setup.translation[0]
    points[..., 2] = s * forward + c * left + setup.translation[1]
    points[..., 0] += noise * rng.normal(0, 0.02, dx.shape)
    points[..., 2] += noise * rng.normal(0, 0.05, dx.shape)
    return points


BOTH = np.array([0, 1])


def test_nothing_is_suspected_of_honest_observations_even_if_one_picture_of_three_is_mistaken(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    setup = open_lab(lab(tmp_path / "lab")).setup
    sigma = np.sqrt(np.diag(setup.prior.covariance))
    for _ in range(50):
        pose = tuple(setup.prior.mean + sigma * rng.normal(size=3))
        points = seen_from(setup, pose, rng)  # type: ignore[arg-type]
        assert unit_suspicion(setup, points, BOTH) is None
        assert unit_suspicion(setup, points[[0, 1, 1]], np.array([0, 1, 0])) is None
    assert unit_suspicion(setup, np.zeros((0, 4, 3)), np.zeros(0, int)) is None
    assert unit_suspicion(setup, points * np.nan, BOTH) is None


@pytest.mark.parametrize("true_reading", ["to-camera", "to-body"])
@pytest.mark.parametrize("true_unit", ["cm", "mm", "m"])
@pytest.mark.parametrize(
    ("reading", "unit"), [("to-camera", "cm"), ("to-camera", "m"), ("to-body", "cm"), ("to-body", "mm")]
)
def test_the_reading_that_fits_is_named(
    tmp_path: Path, true_reading: str, true_unit: str, reading: str, unit: str
) -> None:
    config = configuration()
    # a camera 1 m ahead of the body, so that cm and mm differ by more than the first pose's uncertainty
    config["camera_to_body"]["T"] *= {"cm": 8.0, "mm": 80.0, "m": 0.08}[true_unit]
    folder = lab(tmp_path / "lab", config)
    true = open_lab(folder, translation_unit=true_unit, reading=true_reading).setup
    points = seen_from(true, (1.0, -0.2, math.pi / 6), np.random.default_rng(1))
    read = open_lab(folder, translation_unit=unit, reading=reading)
    said = unit_suspicion(read.setup, points, BOTH, translation_unit=unit, reading=reading)
    if (reading, unit) == (true_reading, true_unit):
        assert said is None
    else:
        assert said is not None
        assert f"do not fit the map with camera_to_body read '{reading}' and T in {unit}, but they do with" in said
        assert f"'{true_reading}' with T in {true_unit}" in said


def test_of_two_readings_that_fit_the_better_one_is_named(tmp_path: Path) -> None:
    # T is 12 cm or 12 mm long: the first pose's uncertainty makes room for either
    folder = lab(tmp_path / "lab")
    read = open_lab(folder, translation_unit="m").setup
    for unit in ("cm", "mm"):
        true = open_lab(folder, translation_unit=unit).setup
        points = seen_from(true, (1.0, -0.2, math.pi / 6), np.random.default_rng(1), noise=0.01)
        assert unit_suspicion(open_lab(folder).setup, points, BOTH) is None
        said = unit_suspicion(read, points, BOTH, translation_unit="m")
        assert said is not None
        assert f"'to-camera' with T in {unit};" in said


@pytest.mark.parametrize("factor", [100.0, 0.01, 0.001])
def test_a_unit_no_reading_can_mend_is_suspected_with_its_factor(tmp_path: Path, factor: float) -> None:
    setup = open_lab(lab(tmp_path / "lab")).setup
    points = seen_from(setup, (1.0, -0.2, math.pi / 6), np.random.default_rng(0), noise=0.01)
    said = unit_suspicion(setup, factor * points, BOTH)
    assert said is not None
    assert "nor with another reading" in said
    assert float(said.split("seen ")[1].split(" times as wide")[0]) == pytest.approx(factor, rel=0.05)
    away = float(said.split("wide and ")[1].split(" ")[0])
    assert away == pytest.approx(factor, rel=0.05)


# --- memory -----------------------------------------------------------------------------------------------------------

STREAM = """
import resource, sys
from pathlib import Path
import numpy as np
from data.visual.lab.folder import open_lab, write_lab
from data.inputs import Prior
from data.pictures import VisualFrame, VisualSetup
folder, form, count = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])
rgb = np.full((480, 640, 3), 7, np.uint8)
xyz = np.full((480, 640, 3), 2.5, np.float32)
class Long:
    corners = np.array([[[0, 1], [0, 0], [0, 0], [0, 1]]], float)
    setup = VisualSetup(0.0, (0.0, 0.0), corners, Prior(np.zeros(3), np.eye(3)))
    references = [np.zeros((4, 4, 3), np.uint8)]
    def __len__(self): return count
    def frames(self):
        for i in range(count): yield VisualFrame(float(i), 0.0, 0.0, rgb, xyz)
if not folder.exists():
    write_lab(folder, Long(), form=form)
recording = open_lab(folder)
assert sum(1 for f in recording.frames() if f.xyz[0, 0, 2] == np.float32(2.5)) == len(recording)
recording.digest()
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
"""


def peak(folder: Path, form: str, count: int) -> float:
    """MiB that a process needed at most to write (unless it is there), read and hash a log of VGA frames."""
    done = subprocess.run(
        [sys.executable, "-c", STREAM, str(folder), form, str(count)],
        capture_output=True,
        text=True,
        check=True,
        cwd=Path(__file__).parents[4],
    )
    return float(done.stdout)


@pytest.mark.slow
@pytest.mark.parametrize("form", ["mat", "npy", "npz"])
def test_memory_does_not_grow_with_the_length_of_a_log(tmp_path: Path, form: str) -> None:
    short, long = peak(tmp_path / "short", form, 4), peak(tmp_path / "long", form, 180)
    size = (tmp_path / "long" / f"log.{form}").stat().st_size / 2**20
    assert size > 750
    assert long < short + 50
    assert long < 512


@pytest.mark.slow
@pytest.mark.parametrize("form", ["mat", "npz"])
def test_memory_does_not_grow_with_the_length_of_a_compressed_log(tmp_path: Path, form: str) -> None:
    peaks = []
    for name, count in (("short", 4), ("long", 180)):
        folder = tmp_path / name
        peak(folder, form, count)
        path = folder / f"log.{form}"
        if form == "mat":
            # as MATLAB's -v7 does: the variable as one zlib stream
            packer = zlib.compressobj(1)
            packed = bytearray()
            with path.open("rb") as file:
                head = file.read(128)
                while block := file.read(1 << 20):
                    packed += packer.compress(block)
            packed += packer.flush()
            path.write_bytes(head + (15).to_bytes(4, "little") + len(packed).to_bytes(4, "little") + packed)
        else:
            other = folder / "packed"
            with (
                zipfile.ZipFile(path) as old,
                zipfile.ZipFile(other, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as new,
            ):
                for member in old.namelist():
                    with old.open(member) as source, new.open(member, "w", force_zip64=True) as sink:
                        while block := source.read(1 << 20):
                            sink.write(block)
            other.replace(path)
        peaks.append(peak(folder, form, count))
    assert peaks[1] < peaks[0] + 50
    assert peaks[1] < 512
