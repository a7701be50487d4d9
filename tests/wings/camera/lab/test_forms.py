"""Every form of the lab's log, MATLAB 7.3 included, gives the same frames, in memory that does not grow."""

import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io

from tests.builders.processes import python
from tests.wings.camera.lab import handmade
from wings.camera.lab.folder import is_lab, open_lab


def read_twice(recording: Any, columns: dict[str, Any]) -> Iterator[list[Any]]:
    """Its frames, read twice, each time with the times, commands and images of `columns`."""
    assert len(recording) == handmade.FRAMES
    for _ in range(2):
        frames = handmade.all_frames(recording)
        assert [f.time for f in frames] == columns["timestamp"].tolist()
        np.testing.assert_array_equal([(f.v, f.omega) for f in frames], columns["commands"])
        np.testing.assert_array_equal([f.rgb for f in frames], columns["rgb"])
        yield frames


@pytest.mark.parametrize("form", handmade.LOGS)
def test_every_form_of_the_log_gives_the_same_frames_and_zeros_nan_or_infinity_no_point(tmp_path: Path, form: str):
    columns = handmade.log_arrays()
    columns["xyz"][:, 5, 5] = [0.0, 0.0, np.inf]
    columns["xyz"][:, 5, 6] = [np.nan, 5.0, 700.0]
    columns["xyz"][:, 5, 7] = [0.0, 0.0, 700.0]
    for frames in read_twice(open_lab(handmade.lab(tmp_path / "lab", columns=columns, form=form)), columns):
        assert all(f.rgb.dtype == np.uint8 and f.rgb.flags.c_contiguous and f.xyz.flags.c_contiguous for f in frames)
        none = np.isnan([f.xyz for f in frames])
        assert none[:, :2, :4].all()
        assert none[:, 5, 5:7].all()
        assert not none[:, 5, 7].any()
        assert (none.sum(axis=(1, 2, 3)) == 3 * (8 + 2)).all()


def fields(commands: np.ndarray) -> np.ndarray:
    return np.array([(v, omega) for v, omega in commands], [("v", "f8"), ("omega", "f8")])


@pytest.mark.parametrize(("form", "write"), [
    ("log.mat", lambda c: [row.reshape(1, 2) for row in c]), ("log.mat", lambda c: [row.reshape(2, 1) for row in c]),
    ("log.mat", lambda c: [{"v": v, "omega": omega, "more": 1.0} for v, omega in c]),
    *((form, fields) for form in ("log.mat", "log.npy", "log.npz")),
])  # fmt: skip
def test_commands_may_be_rows_columns_structs_or_fields_of_numpy(tmp_path, form, write):
    columns: dict[str, Any] = handmade.log_arrays()
    plain = columns["commands"]
    columns["commands"] = write(plain)
    frames = handmade.all_frames(open_lab(handmade.lab(tmp_path / "lab", columns=columns, form=form)))
    np.testing.assert_array_equal([(f.v, f.omega) for f in frames], plain)


@pytest.mark.parametrize("white", [1.0, 255.0])
@pytest.mark.parametrize("form", ["log.mat", "log.npz"])
def test_colours_may_be_fractions_of_1_or_of_255_as_the_first_frame_that_is_not_black_shows(tmp_path, form, white):
    columns = handmade.log_arrays()
    columns["rgb"][0] = 0
    expected = columns["rgb"]
    columns["rgb"] = columns["rgb"] * (white / 255.0)
    expected[3] = columns["rgb"][3] = 0  # later frames may be nearly black: they are not taken for another scale
    expected[3, 0, 0], columns["rgb"][3, 0, 0] = 1, white / 255.0
    frames = handmade.all_frames(open_lab(handmade.lab(tmp_path / "lab", columns=columns, form=form)))
    np.testing.assert_array_equal([f.rgb for f in frames], expected)


def test_whole_numbers_of_other_types_are_colours_too_and_mm_may_be_whole(tmp_path: Path) -> None:
    columns = handmade.log_arrays()
    expected = columns["rgb"]
    columns["rgb"] = expected.astype(np.int16)
    columns["xyz"] = np.nan_to_num(columns["xyz"]).astype(np.int16)
    frames = handmade.all_frames(open_lab(handmade.lab(tmp_path / "lab", columns=columns)))
    np.testing.assert_array_equal([f.rgb for f in frames], expected)
    np.testing.assert_allclose(frames[2].xyz[4, 4], columns["xyz"][2, 4, 4] / 1000.0, rtol=1e-6)


def test_configuration_and_log_may_share_a_file_and_the_log_may_have_another_name_and_more_fields(tmp_path):
    folder = handmade.lab(tmp_path / "lab")
    columns: dict[str, Any] = handmade.log_arrays() | {"disparity": np.zeros((handmade.FRAMES, 50))}
    (folder / "log.mat").unlink()
    (folder / "settings.mat").unlink()
    scipy.io.savemat(
        folder / "All.MAT", handmade.configuration() | {"run7": handmade.as_structs(columns), "note": "by hand"}
    )
    np.testing.assert_array_equal([f.rgb for f in handmade.all_frames(open_lab(folder))], columns["rgb"])


class Trap:
    def __reduce__(self) -> Any:
        return open, ("sprung", "w")


def test_a_refused_pickle_runs_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    folder = handmade.lab(tmp_path / "lab", form="")
    np.save(folder / "log.npy", np.array([Trap()], object))
    assert is_lab(folder)
    handmade.refuse(folder, "--trust-pickle")
    assert not (tmp_path / "sprung").exists()


@pytest.mark.parametrize(("content", "said"), [
    (np.array([1, "two"], object), r"\[0\]: a int; a dict of the frame's fields is needed"),
    (np.array(7, object), "holds one int; a list of dicts, one per frame, or a dict of arrays"),
    (np.array({"rgb": 1}, object), "the log has no timestamp"),
    (np.array([{"rgb": 1}], object), "the log has no timestamp"), (np.array([], object), "the log has no timestamp"),
])  # fmt: skip
def test_trusted_objects_of_another_shape_are_refused(tmp_path: Path, content: Any, said: str) -> None:
    folder = handmade.lab(tmp_path / "lab", form="")
    np.save(folder / "log.npy", content)
    handmade.refuse(folder, said, trust_pickle=True)


def test_a_trusted_frame_without_a_field_or_with_ragged_values_is_named(tmp_path: Path) -> None:
    folder = handmade.lab(tmp_path / "lab", form="")
    log = handmade.as_dicts(handmade.log_arrays())
    del log[2]["xyz"]
    np.save(folder / "log.npy", log)
    handmade.refuse(folder, r"\[2\]\['xyz'\]: missing", trust_pickle=True)
    log[1]["rgb"] = [[1, 2], [3]]
    np.save(folder / "log.npy", log)
    handmade.refuse(folder, r"\[1\]\['rgb'\]: .*inhomogeneous", trust_pickle=True)


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
            references.reshape(-1)[i] = put(kept, f"{name}_{field}_{i}", element[field]).ref
        group.create_dataset(field, data=references, dtype=h5py.ref_dtype)


def saved(
    path: Path, columns: dict[str, Any] | None, config: Any = None, shape: tuple[int, int] = (1, handmade.FRAMES)
) -> None:
    with pytest.importorskip("h5py").File(path, "w", userblock_size=512) as file:
        for name, fields in (config or {}).items():
            put(file, name, fields)
        if columns is not None:
            put_structs(file, "log", list(handmade.as_dicts(columns)), shape)
    with path.open("r+b") as whole:
        whole.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")


@pytest.mark.parametrize("shape", [(1, handmade.FRAMES), (handmade.FRAMES, 1)])
def test_a_log_of_version_7_3_gives_the_same_frames_as_often_as_asked(tmp_path: Path, shape: tuple[int, int]) -> None:
    columns, folder = handmade.log_arrays(), handmade.lab(tmp_path / "lab", form="")
    saved(folder / "log.mat", columns, shape=shape)
    for frames in read_twice(open_lab(folder), columns):
        np.testing.assert_allclose(frames[2].xyz[4, 4], columns["xyz"][2, 4, 4] / 1000.0, rtol=1e-6)


@pytest.mark.parametrize(("change", "said"), [
    (lambda c: c.update(rgb=["an image"] * handmade.FRAMES), r"log\(1\).rgb: text; numbers are needed"),
    (lambda c: c["timestamp"].__setitem__(2, 10.1), r"log\(3\).timestamp: 10.1 s follows 10.1 s"),
    (lambda c: c.pop("xyz"), "the log has no xyz"),
])  # fmt: skip
def test_faults_of_a_log_of_version_7_3_are_named(tmp_path, change, said):
    columns: dict[str, Any] = handmade.log_arrays()
    change(columns)
    folder = handmade.lab(tmp_path / "lab", form="")
    saved(folder / "log.mat", columns)
    handmade.refuse(folder, said)


def test_damaged_files_of_version_7_3_are_refused_in_a_line(tmp_path: Path) -> None:
    folder = handmade.lab(tmp_path / "lab", form="")
    saved(folder / "log.mat", handmade.log_arrays())
    content = (folder / "log.mat").read_bytes()
    (folder / "log.mat").write_bytes(content[: len(content) // 2])
    handmade.refuse(folder, r"log.mat: damaged: ")


def test_without_h5py_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "h5py", None)
    folder = handmade.lab(tmp_path / "lab")
    (folder / "log.mat").write_bytes(
        b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + bytes(384) + b"\x89HDF\r\n\x1a\n"
    )
    handmade.refuse(folder, f"log.mat: {WITHOUT}")


STREAM = """
import sys
from pathlib import Path
import numpy as np
from wings.camera.lab.folder import open_lab, write_lab
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
status = Path("/proc/self/status").read_text()  # ru_maxrss would be a forking parent's, if that is larger
print(int(status.split("VmHWM:")[1].split()[0]) / 1024)
"""


def peak(folder: Path, form: str, count: int) -> float:
    """MiB that a process needed at most to write (unless it is there), read and hash a log of VGA frames."""
    return float(python("-c", STREAM, folder, form, count).stdout)


@pytest.mark.slow
@pytest.mark.parametrize("form", ["npy", "npz"])
def test_memory_does_not_grow_with_the_length_of_a_log(tmp_path: Path, form: str) -> None:
    short, long = peak(tmp_path / "short", form, 4), peak(tmp_path / "long", form, 180)
    assert ((tmp_path / "long" / f"log.{form}").stat().st_size / 2**20) > 750
    assert long < short + 50
    assert long < 512


@pytest.mark.slow
def test_memory_does_not_grow_with_the_length_of_a_compressed_log(tmp_path: Path) -> None:
    peaks = []
    for name, count in (("short", 4), ("long", 180)):
        folder = tmp_path / name
        peak(folder, "npz", count)
        path, other = folder / "log.npz", folder / "packed"
        with zipfile.ZipFile(path) as old, zipfile.ZipFile(other, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as new:
            for member in old.namelist():
                with old.open(member) as source, new.open(member, "w", force_zip64=True) as sink:
                    while block := source.read(1 << 20):
                        sink.write(block)
        other.replace(path)
        peaks.append(peak(folder, "npz", count))
    assert peaks[1] < peaks[0] + 50
    assert peaks[1] < 512
