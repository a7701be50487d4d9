"""MATLAB files: the values that scipy reads, whatever their types; damage is named and never ends the process."""

from __future__ import annotations

import contextlib
import io
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from data.errors import DataError
from data.formats import matlab
from data.formats.matlab import load, save, variables
from tests.quick import examples

TYPES = ["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8"]
ARRAYS = st.sampled_from(TYPES).flatmap(
    lambda t: hnp.arrays(np.dtype(t), hnp.array_shapes(min_dims=2, max_dims=4, min_side=0, max_side=4))
)
FIELDS = st.lists(
    st.text("abcdefgh_", min_size=1, max_size=20).filter(lambda s: s[0] != "_"), min_size=1, max_size=4, unique=True
)


def cells(draw: st.DrawFn) -> np.ndarray:
    names, count = draw(FIELDS), draw(st.integers(0, 4))
    log = np.zeros((1, count), dtype=[(n, object) for n in names])
    for i in range(count):
        for name in names:
            log[0, i][name] = draw(ARRAYS)
    return log


struct_arrays = st.composite(cells)()
same_file = settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=examples(60), deadline=None
)


def big_endian(arrays: dict[str, np.ndarray]) -> bytes:
    """A file as a big-endian machine writes it, put together by hand from the format description."""

    def element(kind: int, content: bytes) -> bytes:
        return struct.pack(">II", kind, len(content)) + content + bytes(-len(content) % 8)

    def matrix(name: str, a: np.ndarray) -> bytes:
        small = struct.pack(">HH", len(name), 1) + name.encode().ljust(4, b"\0")
        label = small if 0 < len(name) <= 4 else element(1, name.encode())
        kinds = {"f8": (6, 9), "f4": (7, 7), "u1": (9, 2), "i2": (10, 3)}
        mx, mi = kinds[a.dtype.str[1:]]
        return element(
            14,
            element(6, struct.pack(">II", mx, 0))
            + element(5, np.array(a.shape, ">i4").tobytes())
            + label
            + element(mi, a.astype(a.dtype.newbyteorder(">")).tobytes("F")),
        )

    return b"MATLAB 5.0 MAT-file".ljust(124) + b"\x01\x00MI" + b"".join(matrix(n, a) for n, a in arrays.items())


def same(value: Any, expected: Any) -> bool:
    np.testing.assert_array_equal(value, expected)
    return value.dtype.newbyteorder("=") == expected.dtype.newbyteorder("=") and value.shape == expected.shape


def everything(path: Path) -> dict[str, Any]:
    return load(path, list(variables(path)))


@same_file
@given(a=ARRAYS, b=ARRAYS, compressed=st.booleans())
def test_arrays_of_every_type_are_what_scipy_reads(tmp_path: Path, a: Any, b: Any, compressed: bool) -> None:
    path = tmp_path / "arrays.mat"
    scipy.io.savemat(path, {"first": a, "b": b}, do_compression=compressed)
    expected = scipy.io.loadmat(path)
    assert variables(path) == {"first": (a.size, ()), "b": (b.size, ())}
    assert load(path, ["b", "other"]).keys() == {"b"}
    found = everything(path)
    assert same(found["first"], expected["first"])
    assert same(found["b"], expected["b"])


@same_file
@given(log=struct_arrays, compressed=st.booleans())
def test_struct_arrays_are_dicts_in_matlabs_order(tmp_path: Path, log: Any, compressed: bool) -> None:
    path = tmp_path / "structs.mat"
    scipy.io.savemat(path, {"log": log, "after": np.arange(3.0)}, do_compression=compressed)
    expected = scipy.io.loadmat(path)["log"]
    assert variables(path)["log"] == (log.size, log.dtype.names)
    found = everything(path)
    got = [found["log"]] if log.size == 1 else found["log"]
    assert len(got) == log.size
    for element, wanted in zip(got, expected.ravel(order="F")):
        assert all(same(element[name], wanted[name]) for name in log.dtype.names)
    assert same(found["after"], np.arange(3.0)[None])


@pytest.mark.parametrize("compressed", [False, True])
def test_structs_inside_structs_and_a_two_dimensional_struct_array_keep_their_order(
    tmp_path: Path, compressed: bool
) -> None:
    path = tmp_path / "nested.mat"
    grid = np.zeros((2, 3), dtype=[("k", object)])
    for i, j in np.ndindex(2, 3):
        grid[i, j]["k"] = float(10 * i + j)
    scipy.io.savemat(path, {"grid": grid, "pose": {"x0": 3.0, "deep": {"w": [1, 2]}}}, do_compression=compressed)
    found = everything(path)
    assert [float(e["k"].item()) for e in found["grid"]] == [0, 10, 1, 11, 2, 12]
    np.testing.assert_array_equal(found["pose"]["deep"]["w"], [[1, 2]])


def test_other_kinds_are_told(tmp_path: Path) -> None:
    path = tmp_path / "kinds.mat"
    cell = np.empty((1, 2), object)
    cell[0, 0], cell[0, 1] = 1.0, 2.0
    kinds = {
        "word": ("hello", "text"),
        "cell": (cell, "cell array or objects"),
        "sparse": (scipy.sparse.csc_matrix(np.eye(3)), "a sparse matrix"),
        "s": ({"word": "hello", "n": 4.0}, "a struct"),
        "yes": (np.array([[True, False]]), "numbers"),
    }
    scipy.io.savemat(path, {name: value for name, (value, _) in kinds.items()})
    found = everything(path)
    assert {name: matlab.kind_of(value) for name, value in found.items()} == {n: kind for n, (_, kind) in kinds.items()}
    assert found["s"]["n"] == 4.0


@same_file
@given(
    a=hnp.arrays(np.float64, (2, 3)),
    b=hnp.arrays(np.uint8, hnp.array_shapes(min_dims=2, max_dims=3, max_side=3)),
    c=hnp.arrays(np.int16, (1, 1)),
)
def test_files_of_big_endian_machines_are_what_scipy_reads(tmp_path: Path, a: Any, b: Any, c: Any) -> None:
    path = tmp_path / "big.mat"
    path.write_bytes(big_endian({"a": a, "longer_name": b, "c": c}))
    expected, found = scipy.io.loadmat(path), everything(path)
    for name in ("a", "longer_name", "c"):
        assert same(found[name], expected[name])


def test_files_of_version_4_are_read(tmp_path: Path) -> None:
    path = tmp_path / "four.mat"
    scipy.io.savemat(path, {"x": np.arange(9.0)}, format="4")
    assert variables(path) == {"x": (9, ())}
    assert same(load(path, ["x"])["x"], np.arange(9.0)[None])


def test_numbers_stored_in_a_smaller_type_get_the_type_of_their_class(tmp_path: Path) -> None:
    path = tmp_path / "small.mat"
    scipy.io.savemat(path, {"x": np.array([[1.0]])})
    raw = path.read_bytes()
    # MATLAB keeps whole doubles in bytes: class 6 (double), four values of type 2 (uint8) inside the tag
    at = raw.index(struct.pack("<II", 9, 8))
    raw = raw[:at] + struct.pack("<HH", 2, 1) + b"\x07\0\0\0"
    raw = raw[:132] + struct.pack("<I", len(raw) - 136) + raw[136:]
    path.write_bytes(raw)
    assert same(load(path, ["x"])["x"], np.array([[7.0]]))


def test_a_field_that_was_never_set_is_empty(tmp_path: Path) -> None:
    path = tmp_path / "unset.mat"
    scipy.io.savemat(path, {"log": {"a": np.array([[5.0]]), "b": np.array([[1.0]])}})
    raw = path.read_bytes()
    inner = raw.rindex(struct.pack("<I", 14))
    raw = raw[:inner] + struct.pack("<II", 14, 0)
    raw = raw[:132] + struct.pack("<I", len(raw) - 136) + raw[136:]
    path.write_bytes(raw)
    log = everything(path)["log"]
    assert log["a"] == 5.0
    assert log["b"].size == 0


@pytest.mark.parametrize("compressed", [False, True])
def test_a_file_cut_anywhere_is_damaged(tmp_path: Path, compressed: bool) -> None:
    path = tmp_path / "cut.mat"
    whole = np.random.default_rng(3).random((4, 5))
    scipy.io.savemat(path, {"log": {"a": whole, "b": whole}}, do_compression=compressed)
    raw = path.read_bytes()
    for cut in range(129, len(raw), 3):
        path.write_bytes(raw[:cut])
        with pytest.raises(DataError, match=r"cut.mat: damaged: .*ends early"):
            variables(path)


def test_a_compressed_variable_whose_stream_stops_or_whose_checksum_is_wrong_is_damaged(tmp_path: Path) -> None:
    path = tmp_path / "stream.mat"
    buffer = io.BytesIO()
    scipy.io.savemat(buffer, {"a": np.random.default_rng(3).random((40, 50))})
    packed = zlib.compress(buffer.getvalue()[128:])

    def put(stream: bytes) -> None:
        path.write_bytes(buffer.getvalue()[:128] + struct.pack("<II", 15, len(stream)) + stream)

    put(packed)
    assert same(load(path, ["a"])["a"], scipy.io.loadmat(path)["a"])
    for bad in (packed[:-5000], packed[:-4], packed[:-1] + bytes([packed[-1] ^ 1])):
        put(bad)
        with pytest.raises(DataError, match=r"stream.mat: damaged"):
            load(path, ["a"])


@same_file
@given(data=st.data(), compressed=st.booleans())
def test_flipped_bytes_end_in_a_data_error_or_in_values_never_in_another_error(
    tmp_path: Path, data: st.DataObject, compressed: bool
) -> None:
    path = tmp_path / "flipped.mat"
    log = np.zeros((1, 2), dtype=[("rgb", object), ("timestamp", object)])
    log[0, 0]["rgb"] = log[0, 1]["rgb"] = np.arange(12, dtype=np.uint8).reshape(2, 2, 3)
    log[0, 0]["timestamp"] = log[0, 1]["timestamp"] = 1.5
    scipy.io.savemat(path, {"log": log}, do_compression=compressed)
    raw = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        raw[data.draw(st.integers(116, len(raw) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(raw)
    with contextlib.suppress(DataError):
        everything(path)


@pytest.mark.parametrize("kind", [0, 8, 14, 19, 200, 2**31])
def test_types_that_make_scipy_read_memory_that_is_not_its_own_are_damage(tmp_path: Path, kind: int) -> None:
    path = tmp_path / "x.mat"
    scipy.io.savemat(path, {"x": np.arange(9.0)})
    raw = path.read_bytes()
    path.write_bytes(raw.replace(struct.pack("<II", 9, 72), struct.pack("<II", kind, 72)))
    with pytest.raises(DataError, match=r"x.mat: damaged: "):
        load(path, ["x"])


@pytest.mark.parametrize(
    "content",
    [b"", b"just text, but long enough to hold a header" * 9, b"MATLAB 5.0".ljust(124) + b"\x00\x07IM" + bytes(500)],
)
def test_a_file_of_another_kind_or_none_is_named(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "x.mat"
    path.write_bytes(content)
    with pytest.raises(DataError, match=r"x.mat: not a MATLAB file of version 4 to 7.3"):
        variables(path)
    with pytest.raises(DataError, match=r"gone.mat: cannot be read: No such file"):
        variables(tmp_path / "gone.mat")


def test_a_size_that_is_no_whole_number_is_damage(tmp_path: Path) -> None:
    path = tmp_path / "x.mat"
    scipy.io.savemat(path, {"x": np.array([[1.0]])})
    raw = path.read_bytes()
    assert raw[152:160] == struct.pack("<II", 5, 8)
    path.write_bytes(raw[:152] + struct.pack("<IId", 9, 8, float("nan")) + raw[168:])
    with pytest.raises(DataError, match=r"x.mat: damaged: an element of type 9 is where integers should be"):
        variables(path)


@pytest.mark.parametrize("compressed", [False, True])
def test_what_is_larger_than_the_memory_is_refused_with_the_forms_that_are_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, compressed: bool
) -> None:
    path = tmp_path / "x.mat"
    scipy.io.savemat(path, {"x": np.zeros(9000)}, do_compression=compressed)
    monkeypatch.setattr(matlab.os, "sysconf", {"SC_PAGE_SIZE": 4096, "SC_PHYS_PAGES": 4}.__getitem__)
    assert variables(path) == {"x": (9000, ())}
    with pytest.raises(DataError, match=r"x.mat: larger than the memory; save its frames as .npy or .npz"):
        load(path, ["x"])


def test_the_same_values_give_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a.mat", "b.mat"):
        save(tmp_path / name, {"x": np.arange(4.0)})
    assert (tmp_path / "a.mat").read_bytes() == (tmp_path / "b.mat").read_bytes()
    assert b"2026" not in (tmp_path / "a.mat").read_bytes()
