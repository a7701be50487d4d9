"""MATLAB 7.3: written here as MATLAB lays it out, read as the same recording; and what is said without h5py."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.wings.camera.lab.handmade import (
    FRAMES,
    all_frames,
    as_dicts,
    lab,
    log_arrays,
    refuse,
)
from wings.camera.lab.folder import open_lab

CLASSES = {"f8": "double", "f4": "single", "u1": "uint8", "i2": "int16"}
WITHOUT = "MATLAB 7.3 \\(HDF5\\) needs the package h5py: pip install 'slamref\\[hdf5\\]', or save it with '-v7'"


def put(group: Any, name: str, value: Any) -> Any:
    """A value as MATLAB stores it: arrays have two dimensions at least, and the order of all is reversed."""
    if isinstance(value, dict):
        item = group.create_group(name)
        item.attrs["MATLAB_class"] = np.bytes_("struct")
        for field, content in value.items():
            put(item, field, content)
    elif isinstance(value, str):
        item = group.create_dataset(name, data=np.array([[ord(c)] for c in value], np.uint16))
        item.attrs["MATLAB_class"] = np.bytes_("char")
    else:
        array = np.atleast_2d(np.asarray(value, None if isinstance(value, np.ndarray) else float))
        item = group.create_dataset(name, data=array.T)
        item.attrs["MATLAB_class"] = np.bytes_(CLASSES[array.dtype.str[1:]])
    return item


def put_structs(file: Any, name: str, elements: list[dict[str, Any]], shape: tuple[int, int]) -> None:
    """A struct array: a group whose fields are references to the elements' values."""
    import h5py

    group = file.create_group(name)
    group.attrs["MATLAB_class"] = np.bytes_("struct")
    kept = file.require_group("#refs#")
    for field in elements[0]:
        references = np.empty(shape[::-1], h5py.ref_dtype)
        for i, element in enumerate(elements):
            stored = put(kept, f"{name}_{field}_{i}", element[field])
            references.reshape(-1)[i] = stored.ref
        group.create_dataset(field, data=references, dtype=h5py.ref_dtype)


def saved(path: Path, columns: dict[str, Any] | None, config: Any = None, shape: tuple[int, int] = (1, FRAMES)) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, fields in (config or {}).items():
            put(file, name, fields)
        if columns is not None:
            put_structs(file, "log", list(as_dicts(columns)), shape)
    with path.open("r+b") as whole:
        whole.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")


@pytest.mark.parametrize("shape", [(1, FRAMES), (FRAMES, 1)])
def test_a_log_of_version_7_3_gives_the_same_frames_as_often_as_asked(tmp_path: Path, shape: tuple[int, int]) -> None:
    columns, folder = log_arrays(), lab(tmp_path / "lab")
    (folder / "log.mat").unlink()
    saved(folder / "log.mat", columns, shape=shape)
    recording = open_lab(folder)
    assert len(recording) == FRAMES
    for _ in range(2):
        frames = all_frames(recording)
        assert [f.time for f in frames] == columns["timestamp"].tolist()
        np.testing.assert_array_equal([(f.v, f.omega) for f in frames], columns["commands"])
        np.testing.assert_array_equal([f.rgb for f in frames], columns["rgb"])
        np.testing.assert_allclose(frames[2].xyz[4, 4], columns["xyz"][2, 4, 4] / 1000.0, rtol=1e-6)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda c: c.update(rgb=["an image"] * FRAMES), r"log\(1\).rgb: text; numbers are needed"),
        (lambda c: c["timestamp"].__setitem__(2, 10.1), r"log\(3\).timestamp: 10.1 s follows 10.1 s"),
        (lambda c: c.pop("xyz"), "the log has no xyz"),
    ],
)
def test_faults_of_a_log_of_version_7_3_are_named(
    tmp_path: Path, change: Callable[[dict[str, Any]], None], said: str
) -> None:
    columns: dict[str, Any] = log_arrays()
    change(columns)
    folder = lab(tmp_path / "lab")
    (folder / "log.mat").unlink()
    saved(folder / "log.mat", columns)
    refuse(folder, said)


def test_damaged_files_of_version_7_3_are_refused_in_a_line(tmp_path: Path) -> None:
    folder = lab(tmp_path / "lab")
    (folder / "log.mat").unlink()
    saved(folder / "log.mat", log_arrays())
    content = (folder / "log.mat").read_bytes()
    (folder / "log.mat").write_bytes(content[: len(content) // 2])
    refuse(folder, r"log.mat: damaged: ")


def test_without_h5py_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "h5py", None)
    folder = lab(tmp_path / "lab")
    (folder / "log.mat").write_bytes(
        b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + bytes(384) + b"\x89HDF\r\n\x1a\n"
    )
    refuse(folder, f"log.mat: {WITHOUT}")
