"""The lab's units and the readings of R and T: what a folder's numbers mean."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from data.errors import UsageError
from tests.wings.camera.lab.handmade import LOGS, configuration, lab, log_arrays
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
