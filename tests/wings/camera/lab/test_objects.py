"""Logs and configurations as Python keeps them: dicts of arrays, object arrays, pickles, NumPy's records."""

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io

from tests.wings.camera.lab import handmade
from wings.camera.lab.folder import is_lab, open_lab


def objects(rows: Any, shape: tuple[int, ...]) -> np.ndarray:
    made = np.empty(len(rows), object)
    made[:] = list(rows)
    return made.reshape(shape)


def columns_of_objects(columns: dict[str, Any], shape: tuple[int, ...]) -> dict[str, np.ndarray]:
    """Every column an object array; each element in MATLAB's at least two dimensions."""
    return {name: objects([np.atleast_2d(row) for row in column], shape) for name, column in columns.items()}


def through_matlab(columns: dict[str, Any], folder: Path) -> np.ndarray:
    """What scipy.io makes of the struct array, commands being structs: records of objects (1, N)."""
    v, omega = columns["commands"].T
    structs = columns | {"commands": [{"v": a, "omega": b} for a, b in zip(v, omega, strict=True)]}
    scipy.io.savemat(folder / "other.m", {"log": handmade.as_structs(structs)}, appendmat=False)
    log: np.ndarray = scipy.io.loadmat(folder / "other.m", appendmat=False)["log"]
    return log


FORMS: dict[str, Callable[[dict[str, Any], Path], Any]] = {
    "a dict of arrays": lambda c, _: c,
    "a dict of arrays, times a row": lambda c, _: c | {"timestamp": c["timestamp"][None]},
    "a dict of lists": lambda c, _: {name: list(column) for name, column in c.items()},
    "a dict of object arrays (N, 1)": lambda c, _: columns_of_objects(c, (-1, 1)),
    "a dict of object arrays (1, N)": lambda c, _: columns_of_objects(c, (1, -1)),
    "dicts (N, 1)": lambda c, _: handmade.as_dicts(c).reshape(-1, 1), "dicts (N,)": lambda c, _: handmade.as_dicts(c),
    "a list of dicts": lambda c, _: list(handmade.as_dicts(c)), "a struct array": lambda c, _: handmade.as_structs(c),
    "MATLAB's struct array (1, N)": through_matlab,
    "MATLAB's struct array (N, 1)": lambda c, folder: through_matlab(c, folder).T,
    "a dict that calls it log": lambda c, folder: {"__header__": b"", "log": through_matlab(c, folder)},
}  # fmt: skip


@pytest.mark.parametrize("suffix", [".npy", ".pkl"])
@pytest.mark.parametrize("form", FORMS)
def test_every_form_of_objects_gives_the_same_frames_once_trusted(tmp_path: Path, form: str, suffix: str) -> None:
    columns, folder = handmade.log_arrays(), handmade.lab(tmp_path / "lab", form="")
    content, path = FORMS[form](columns, tmp_path), folder / f"log{suffix}"
    if suffix == ".npy":
        np.save(path, objects([content], ()) if isinstance(content, dict | list) else content, allow_pickle=True)
    else:
        path.write_bytes(pickle.dumps(content))
    handmade.refuse(folder, rf"log{suffix}: holds Python objects \(a pickle\).*--trust-pickle")
    frames = handmade.all_frames(open_lab(folder, trust_pickle=True))
    assert [f.time for f in frames] == columns["timestamp"].tolist()
    np.testing.assert_array_equal([(f.v, f.omega) for f in frames], columns["commands"])
    np.testing.assert_array_equal([f.rgb for f in frames], columns["rgb"])
    assert np.nanmax([f.xyz for f in frames]) == pytest.approx(np.nanmax(columns["xyz"]) / 1000.0)


@pytest.mark.parametrize("shape", [(-1, 1), (1, -1), (-1,)])
def test_object_arrays_of_an_archive_may_be_columns_or_rows(tmp_path: Path, shape: tuple[int, ...]) -> None:
    columns, folder = handmade.log_arrays(), handmade.lab(tmp_path / "lab", form="")
    np.savez(folder / "log.npz", **columns_of_objects(columns, shape))  # type: ignore[arg-type]
    handmade.refuse(folder, "timestamp holds Python objects.*--trust-pickle")
    frames = handmade.all_frames(open_lab(folder, trust_pickle=True))
    assert [f.time for f in frames] == columns["timestamp"].tolist()
    np.testing.assert_array_equal([(f.v, f.omega) for f in frames], columns["commands"])


def test_a_log_of_one_frame_is_one_dict_or_columns_of_one_row(tmp_path: Path) -> None:
    one = {name: column[:1] for name, column in handmade.log_arrays().items()}
    folder = handmade.lab(tmp_path / "lab", form="")
    for content in (one, {name: column[0] for name, column in one.items()}):
        (folder / "log.pkl").write_bytes(pickle.dumps(content))
        (frame,) = handmade.all_frames(open_lab(folder, trust_pickle=True))
        np.testing.assert_array_equal(frame.rgb, one["rgb"][0])


@pytest.mark.parametrize(("change", "said"), [
    (lambda c: c.update(rgb=c["rgb"][:-1]), "rows: timestamp 4, commands 4, rgb 3, xyz 4; as many rows as frames"),
    (lambda c: c.update(commands=7.0), "commands: a float; an array with a row per frame"),
    (lambda c: c.pop("commands"), "the log has no commands"),
    (lambda c: c.update(xyz=[{1}] * handmade.FRAMES), r"\['xyz'\]\[0\]: cell array or objects; numbers"),
    (lambda c: c["timestamp"].__setitem__(2, 10.1), r"\['timestamp'\]\[2\]: 10.1 s follows 10.1 s"),
])  # fmt: skip
def test_faults_of_a_dict_of_arrays_name_field_and_frame(tmp_path, change, said):
    columns: dict[str, Any] = handmade.log_arrays()
    change(columns)
    folder = handmade.lab(tmp_path / "lab", form="")
    (folder / "log.pkl").write_bytes(pickle.dumps(columns))
    handmade.refuse(folder, said, trust_pickle=True)


def test_a_pickle_that_does_not_load_is_refused_in_a_line(tmp_path: Path) -> None:
    folder = handmade.lab(tmp_path / "lab", form="")
    (folder / "log.pkl").write_bytes(b"\x80\x04nonsense")
    handmade.refuse(folder, r"log.pkl: the pickle cannot be loaded", trust_pickle=True)


def test_an_untrusted_pickle_beside_a_whole_recording_is_let_alone_and_makes_no_lab(tmp_path: Path) -> None:
    folder = handmade.lab(tmp_path / "lab")
    (folder / "notes.pkl").write_bytes(pickle.dumps("a note"))
    assert len(handmade.all_frames(open_lab(folder))) == handmade.FRAMES
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes.pkl").write_bytes(pickle.dumps("a note"))
    assert not is_lab(tmp_path / "other")


def records() -> dict[str, np.ndarray]:
    made = {}
    for name, fields in handmade.configuration().items():
        values = {field: np.asarray(value, float) for field, value in fields.items()}
        record = np.zeros((), [(field, "f8", value.shape) for field, value in values.items()])
        for field, value in values.items():
            record[field] = value
        made[name] = record
    return made


def nested() -> np.ndarray:
    parts = records()
    whole = np.zeros((), [(name, record.dtype) for name, record in parts.items()])
    for name, record in parts.items():
        whole[name] = record
    return whole


def alone() -> dict[str, Any]:
    return {field: value for fields in handmade.configuration().values() for field, value in fields.items()}


CONFIGURATIONS: dict[str, tuple[bool, Callable[[Path], object]]] = {
    "records.npz": (False, lambda path: np.savez(path, **records())),  # type: ignore[arg-type]
    "fields.npz": (False, lambda path: np.savez(path, **alone())),
    "record.npy": (False, lambda path: np.save(path, nested())),
    "dicts.npz": (True, lambda path: np.savez(path, **handmade.configuration())),  # type: ignore[arg-type]
    "dict.npy": (True, lambda path: np.save(path, handmade.configuration())),  # type: ignore[arg-type]
    "dict.pkl": (True, lambda path: path.write_bytes(pickle.dumps(handmade.configuration()))),
    "both.pkl": (
        True,
        lambda path: path.write_bytes(pickle.dumps(handmade.configuration() | {"log": handmade.log_arrays()})),
    ),
}


@pytest.mark.parametrize("name", CONFIGURATIONS)
def test_a_configuration_in_numpys_form_is_that_of_matlab(tmp_path: Path, name: str) -> None:
    folder = handmade.lab(tmp_path / "lab")
    expected = open_lab(folder).setup
    (folder / "settings.mat").unlink()
    needs_trust, write = CONFIGURATIONS[name]
    if name.startswith("both"):
        (folder / "log.mat").unlink()
    write(folder / name)
    if needs_trust:
        handmade.refuse(folder, "holds Python objects.*--trust-pickle")
    setup = open_lab(folder, trust_pickle=needs_trust).setup
    assert (setup.rotation, setup.translation) == (expected.rotation, expected.translation)
    np.testing.assert_array_equal(setup.corners, expected.corners)
    np.testing.assert_array_equal(setup.prior.mean, expected.prior.mean)
    np.testing.assert_array_equal(setup.prior.covariance, expected.prior.covariance)
    assert len(handmade.all_frames(open_lab(folder, trust_pickle=needs_trust))) == handmade.FRAMES


def test_faults_of_a_numpy_configuration_are_named(tmp_path: Path) -> None:
    folder = handmade.lab(tmp_path / "lab")
    (folder / "settings.mat").unlink()
    fields = alone()
    del fields["T"]
    np.savez(folder / "config.npz", **fields)
    handmade.refuse(folder, r"config.npz: camera_to_body: no field T; R, T are needed")
    np.savez(folder / "config.npz", **(fields | {"T": "left"}))
    handmade.refuse(folder, r"config.npz: camera_to_body.T: text; numbers are needed")
    np.savez(folder / "config.npz", **{name: alone()[name] for name in ("R", "T", "xpos", "ypos")})
    handmade.refuse(folder, r"config.npz: no struct pose_init")
