"""Write a recording in the lab's format, frame by frame, so that anybody's robot can be exchanged through it."""

from __future__ import annotations

import os
import shutil
import tempfile
import zipfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import IO, Any

import cv2
import numpy as np
import scipy.io
from numpy.typing import NDArray

from data.errors import DataError, UsageError
from data.pictures import VisualFrame, VisualRecording
from data.visual.lab.configuration import REFERENCES, configuration
from data.visual.lab.frames import FIELDS, MM
from data.visual.lab.mat_writer import write_struct_array
from data.whole import whole_folder


def write_lab(folder: Path, recording: VisualRecording, *, form: str = "mat") -> None:
    """Write config.mat, log.mat (or .npy, .npz) and landmark/NN.png into `folder`, which must be free or empty.

    One frame is in memory at a time. The folder is written beside its final name and moved into place when complete.

    Args:
        folder: to be made.
        recording: its points in m become mm (float32), NaN becomes 0.
        form: "mat": MATLAB 5, at most 2 GiB; "npy": a structured array; "npz": an array per field, uncompressed.

    Raises:
        DataError: the folder is in use or cannot be written, frames differ in size or number from what was announced,
            the prior is correlated, or the log is too long for MATLAB 5.
        UsageError: unknown form.
    """
    if form not in WRITERS:
        raise UsageError(f"form {form!r}; known: {', '.join(WRITERS)}")
    folder = Path(os.path.abspath(folder))
    try:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise DataError.at(folder, "exists and is not an empty folder; choose another name")
        with whole_folder(folder) as partial:
            (partial / REFERENCES).mkdir()
            scipy.io.savemat(partial / "config.mat", configuration(recording.setup))
            _write_references(partial / REFERENCES, recording.references)
            WRITERS[form](partial / f"log.{form}", recording)
            if folder.exists():
                folder.rmdir()  # fails, as it should, where somebody has put something into it meanwhile
    except OSError as error:
        raise DataError.at(folder, f"cannot be written: {error.strerror}") from error


def _write_references(folder: Path, references: list[NDArray[np.uint8]]) -> None:
    digits = max(2, len(str(len(references))))
    for i, image in enumerate(references, 1):
        _, content = cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
        (folder / f"{i:0{digits}}.png").write_bytes(content.tobytes())


def _records(recording: VisualRecording) -> Iterator[dict[str, NDArray[Any]]]:
    """The frames in the file's units; as many, and of one size, as the recording says."""
    size, count = None, 0
    for frame in recording.frames():
        size = size or frame.rgb.shape
        if count == len(recording) or frame.rgb.shape != size or frame.xyz.shape != size:
            raise DataError(
                f"frame {count} of the recording: rgb {frame.rgb.shape} and xyz {frame.xyz.shape}; "
                f"{len(recording)} frames of {size} are needed"
            )
        yield _record(frame)
        count += 1
    if count < len(recording):
        raise DataError(f"the recording says {len(recording)} frames and has {count}")


def _record(frame: VisualFrame) -> dict[str, NDArray[Any]]:
    xyz = np.asarray(frame.xyz, np.float32) / MM
    return {
        "timestamp": np.array(frame.time, np.float64),
        "commands": np.array([frame.v, frame.omega], np.float64),
        "rgb": np.asarray(frame.rgb, np.uint8),
        "xyz": np.where(np.isfinite(xyz).all(axis=-1, keepdims=True), xyz, np.float32(0.0)),
    }


def _write_mat(path: Path, recording: VisualRecording) -> None:
    with path.open("wb") as file:
        write_struct_array(file, path.name, "log", FIELDS, len(recording), _records(recording))


def _write_npy(path: Path, recording: VisualRecording) -> None:
    with path.open("wb") as file:
        for i, record in enumerate(_records(recording)):
            dtype = np.dtype([(name, record[name].dtype.str, record[name].shape) for name in FIELDS])
            if not i:
                _write_header(file, dtype, (len(recording),))
            row = np.zeros((), dtype)
            for name in FIELDS:
                row[name] = record[name]
            file.write(row.tobytes())


def _write_npz(path: Path, recording: VisualRecording) -> None:
    """Members of an archive are written one after the other, frames hold a bit of each: columns wait in files."""
    with ExitStack() as stack:
        columns = {name: stack.enter_context(tempfile.TemporaryFile(dir=path.parent)) for name in FIELDS}
        for i, record in enumerate(_records(recording)):
            for name, column in columns.items():
                if not i:
                    _write_header(column, record[name].dtype, (len(recording), *record[name].shape))
                column.write(record[name].tobytes())
        with zipfile.ZipFile(path, "w") as archive:
            for name, column in columns.items():
                column.seek(0)
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    shutil.copyfileobj(column, member, 1 << 20)


def _write_header(file: IO[bytes], dtype: np.dtype[Any], shape: tuple[int, ...]) -> None:
    descr = np.lib.format.dtype_to_descr(dtype)
    np.lib.format.write_array_header_1_0(file, {"descr": descr, "fortran_order": False, "shape": shape})


WRITERS: dict[str, Callable[[Path, VisualRecording], None]] = {"mat": _write_mat, "npy": _write_npy, "npz": _write_npz}
