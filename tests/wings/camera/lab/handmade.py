"""Folders in the lab's format, made without the code under test, and a recording in memory."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import scipy.io

from data.errors import DataError
from data.inputs import Prior
from data.pictures import VisualFrame, VisualSetup
from wings.camera.lab.folder import LabRecording, open_lab

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
    rng = np.random.default_rng(5)
    xyz = rng.uniform(500, 4000, (FRAMES, H, W, 3)).astype(np.float32)
    xyz[:, 0, :4] = 0
    xyz[:, 1, :4] = np.nan
    return {
        "timestamp": np.array([10.0, 10.1, 10.25, 10.3]), "commands": rng.normal(size=(FRAMES, 2)),
        "rgb": rng.integers(0, 256, (FRAMES, H, W, 3), dtype=np.uint8), "xyz": xyz,
    }  # fmt: skip


def as_structs(columns: dict[str, Any]) -> np.ndarray:
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
    """A folder in the lab's format, made without the code under test; without a log where `form` is empty."""
    images = folder / "landmark"
    images.mkdir(parents=True)
    scipy.io.savemat(folder / "settings.mat", configuration() if config is None else config)
    if form:
        LOGS[form](folder / form, log_arrays() if columns is None else columns)
    for i in range(2):
        cv2.imwrite(str(images / f"landmark{i + 1}.png"), np.full((6, 8, 3), (10 + i, 20, 30), np.uint8))
    return folder


class Made:
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
