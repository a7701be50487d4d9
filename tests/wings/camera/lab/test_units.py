"""The lab's units and readings of R and T, and faults of its log: frame, field and value, with what would be right."""

import math
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io

from data.errors import DataError, UsageError
from tests.wings.camera.lab.handmade import LOGS, H, W, as_dicts, configuration, lab, log_arrays, refuse
from wings.camera.lab.folder import open_lab


def test_lengths_are_in_cm_and_angles_in_degrees(tmp_path: Path) -> None:
    setup = open_lab(lab(tmp_path / "lab")).setup
    np.testing.assert_allclose(setup.corners[0], [[4, 0.75], [4, 0.25], [4, 0.25], [4, 0.75]], rtol=1e-15)
    np.testing.assert_allclose(setup.width, [0.5, 0.5])
    assert setup.translation == pytest.approx((0.03, -0.12))
    np.testing.assert_allclose(setup.prior.mean, [1.0, -0.2, math.pi / 6])
    sigma = np.array([0.05, 0.04, 2.0 * math.pi / 180])
    np.testing.assert_allclose(setup.prior.covariance, np.diag(sigma**2))


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


def put(field: str, frame: int, value: Any) -> Callable[[dict[str, Any]], None]:
    def change(columns: dict[str, Any]) -> None:
        columns[field] = list(columns[field])
        columns[field][frame] = value

    return change


@pytest.mark.parametrize(("change", "said"), [
    (put("timestamp", 2, 10.1), r"log\(3\).timestamp: 10.1 s follows 10.1 s; it must increase"),
    (put("timestamp", 1, np.nan), r"log\(2\).timestamp: nan is not a number"),
    (put("timestamp", 1, [1.0, 2.0]), r"log\(2\).timestamp: size 1x2; one number is needed"),
    (put("commands", 3, [0.1, np.nan]), r"log\(4\).commands: nan is not a number"),
    (put("commands", 3, [0.1, 0.2, 0.3]), r"log\(4\).commands: size 1x3; 2 numbers are needed"),
    (put("commands", 0, {"v": 1.0, "w": 2.0}), r"log\(1\).commands: no field omega"),
    (put("commands", 0, {"v": 1.0, "omega": np.inf}), r"log\(1\).commands.omega: inf"),
    (put("rgb", 1, np.zeros((H, W))), r"log\(2\).rgb: size 12x16; H x W x 3 is needed"),
    (put("rgb", 1, np.zeros((H, W, 4), np.uint8)), r"log\(2\).rgb: size 12x16x4; H x W x 3 is needed"),
    (put("rgb", 1, np.zeros((0, 0))), r"log\(2\).rgb: size 0x0"),
    (put("rgb", 1, "an image"), r"log\(2\).rgb: text; numbers are needed"),
    (put("rgb", 1, np.zeros((H, W, 3)) + 1j), "log holds complex numbers; real ones are needed"),
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
])  # fmt: skip
def test_faults_of_a_log_name_frame_field_value_and_what_would_be_right(tmp_path, change, said):
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


def test_a_log_that_is_no_struct_array_is_refused(tmp_path: Path) -> None:
    folder = lab(tmp_path / "lab")
    scipy.io.savemat(folder / "log.mat", {"log": as_dicts(log_arrays())})
    refuse(folder, "log is of kind cell array or objects; a struct array, one element per frame, is needed")
    scipy.io.savemat(folder / "log.mat", {"log": log_arrays()})
    refuse(folder, r"log\(1\).timestamp: size 1x4; one number is needed")


@pytest.mark.parametrize(("change", "said"), [
    (lambda c: c.update(rgb=c["rgb"][:3]), "rows: timestamp 4, commands 4, rgb 3, xyz 4; as many rows as frames"),
    (lambda c: c.update(rgb=np.asfortranarray(c["rgb"])), "rgb: frames are not contiguous in Fortran order"),
    (lambda c: c.update(timestamp=np.array(3.0)), "timestamp: a single value; one row per frame is needed"),
    (lambda c: c.pop("commands"), "the log has no commands"),
    (lambda c: c.update({k: v[:0] for k, v in c.items()}), "the log has no frames"),
])  # fmt: skip
def test_faults_of_an_archive_are_named(tmp_path, change, said):
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
    (folder / "log.npy").write_bytes((folder / "log.npy").read_bytes()[:-1])
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
