"""The lab's units and readings of R and T, and faults of its log: frame, field and value, with what would be right."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io

from data.errors import DataError, UsageError
from data.pictures import VisualSetup
from tests.wings.camera.lab.handmade import LOGS, H, W, as_dicts, configuration, lab, log_arrays, refuse
from wings.camera.lab.configuration import unit_suspicion
from wings.camera.lab.folder import open_lab

# --- units: each of these fails when the one conversion it names is removed -------------------------------------------


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


@pytest.mark.slow
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
    assert float(said.split("appear ")[1].split(" times as wide")[0]) == pytest.approx(factor, rel=0.05)
    away = float(said.split("wide and ")[1].split(" ")[0])
    assert away == pytest.approx(factor, rel=0.05)


def put(field: str, frame: int, value: Any) -> Callable[[dict[str, Any]], None]:
    def change(columns: dict[str, Any]) -> None:
        columns[field] = list(columns[field])
        columns[field][frame] = value

    return change


@pytest.mark.parametrize(
    ("change", "said"),
    [
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


def test_a_log_that_is_no_struct_array_is_refused(tmp_path: Path) -> None:
    folder = lab(tmp_path / "lab")
    scipy.io.savemat(folder / "log.mat", {"log": as_dicts(log_arrays())})
    refuse(folder, "log is of kind cell array or objects; a struct array, one element per frame, is needed")
    scipy.io.savemat(folder / "log.mat", {"log": log_arrays()})
    refuse(folder, r"log\(1\).timestamp: size 1x4; one number is needed")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda c: c.update(rgb=c["rgb"][:3]), "rows: timestamp 4, commands 4, rgb 3, xyz 4; as many rows as frames"),
        (lambda c: c.update(rgb=np.asfortranarray(c["rgb"])), "rgb: frames are not contiguous in Fortran order"),
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
