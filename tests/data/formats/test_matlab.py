"""MATLAB files: the values that scipy reads, whatever their types; damage is named and never ends the process."""

import struct
import tracemalloc

import numpy as np
import pytest
import scipy.io
from hypothesis import HealthCheck, given, settings, strategies as st
from hypothesis.extra import numpy as hnp

from data.errors import DataError
from data.formats import matlab
from data.formats.matlab import load, variables
from tests.quick import examples

TYPES = ["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8"]
ARRAYS = st.sampled_from(TYPES).flatmap(
    lambda t: hnp.arrays(np.dtype(t), hnp.array_shapes(min_dims=2, max_dims=4, min_side=0, max_side=4))
)


same_file = settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=examples(60), deadline=None
)


def same(value, expected):
    np.testing.assert_array_equal(value, expected)
    return value.dtype.newbyteorder("=") == expected.dtype.newbyteorder("=") and value.shape == expected.shape


def everything(path):
    return load(path, list(variables(path)))


@same_file
@given(a=ARRAYS, b=ARRAYS, compressed=st.booleans())
def test_arrays_of_every_type_are_what_scipy_reads(tmp_path, a, b, compressed):
    path = tmp_path / "arrays.mat"
    scipy.io.savemat(path, {"first": a, "b": b}, do_compression=compressed)
    expected = scipy.io.loadmat(path)
    assert variables(path) == {"first": (a.size, ()), "b": (b.size, ())}
    assert load(path, ["b", "other"]).keys() == {"b"}
    found = everything(path)
    assert same(found["first"], expected["first"])
    assert same(found["b"], expected["b"])


def test_other_kinds_are_told(tmp_path):
    path = tmp_path / "kinds.mat"
    cell = np.empty((1, 2), object)
    cell[0, 0], cell[0, 1] = 1.0, 2.0
    kinds = {
        "word": ("hello", "text"), "cell": (cell, "cell array or objects"),
        "sparse": (scipy.sparse.csc_matrix(np.eye(3)), "a sparse matrix"),
        "s": ({"word": "hello", "n": 4.0}, "a struct"), "yes": (np.array([[True, False]]), "numbers"),
    }  # fmt: skip
    scipy.io.savemat(path, {name: value for name, (value, _) in kinds.items()})
    found = everything(path)
    assert {name: matlab.kind_of(value) for name, value in found.items()} == {n: kind for n, (_, kind) in kinds.items()}
    assert found["s"]["n"] == 4.0


def test_files_of_version_4_are_read(tmp_path):
    path = tmp_path / "four.mat"
    scipy.io.savemat(path, {"x": np.arange(9.0)}, format="4")
    assert variables(path) == {"x": (9, ())}
    assert same(load(path, ["x"])["x"], np.arange(9.0)[None])


def test_numbers_stored_in_a_smaller_type_get_the_type_of_their_class(tmp_path):
    path = tmp_path / "small.mat"
    scipy.io.savemat(path, {"x": np.array([[1.0]])})
    raw = path.read_bytes()
    # MATLAB keeps whole doubles in bytes: class 6 (double), four values of type 2 (uint8) inside the tag
    at = raw.index(struct.pack("<II", 9, 8))
    raw = raw[:at] + struct.pack("<HH", 2, 1) + b"\x07\0\0\0"
    raw = raw[:132] + struct.pack("<I", len(raw) - 136) + raw[136:]
    path.write_bytes(raw)
    assert same(load(path, ["x"])["x"], np.array([[7.0]]))


@pytest.mark.parametrize("compressed", [False, True])
def test_a_file_cut_anywhere_is_damaged(tmp_path, compressed):
    path = tmp_path / "cut.mat"
    whole = np.random.default_rng(3).random((4, 5))
    scipy.io.savemat(path, {"log": {"a": whole, "b": whole}}, do_compression=compressed)
    raw = path.read_bytes()
    for cut in range(129, len(raw), 3):
        path.write_bytes(raw[:cut])
        with pytest.raises(DataError, match=r"cut.mat: damaged: .*ends early"):
            variables(path)


@pytest.mark.parametrize("kind", [0, 8, 14, 19, 200, 2**31])
def test_types_that_make_scipy_read_memory_that_is_not_its_own_are_damage(tmp_path, kind):
    path = tmp_path / "x.mat"
    scipy.io.savemat(path, {"x": np.arange(9.0)})
    raw = path.read_bytes()
    path.write_bytes(raw.replace(struct.pack("<II", 9, 72), struct.pack("<II", kind, 72)))
    with pytest.raises(DataError, match=r"x.mat: damaged: "):
        load(path, ["x"])


@pytest.mark.parametrize("content", [
    b"", b"just text, but long enough to hold a header" * 9, b"MATLAB 5.0".ljust(124) + b"\x00\x07IM" + bytes(500),
])  # fmt: skip
def test_a_file_of_another_kind_or_none_is_named(tmp_path, content):
    path = tmp_path / "x.mat"
    path.write_bytes(content)
    with pytest.raises(DataError, match=r"x.mat: not a MATLAB file of version 4 to 7.3"):
        variables(path)
    with pytest.raises(DataError, match=r"gone.mat: cannot be read: No such file"):
        variables(tmp_path / "gone.mat")


@pytest.mark.parametrize("header", [(0, 1, 1, 0, 10**8), (0, 10**8, 1, 0, 2), (0, -1, 1, 0, 2), (60, 1, 1, 0, 2)])
def test_a_header_of_version_4_that_promises_more_than_the_file_takes_no_memory(tmp_path, header):
    path = tmp_path / "x.mat"
    path.write_bytes(np.array(header, "<i4").tobytes() + b"x\0" + bytes(8))
    tracemalloc.start()
    try:
        with pytest.raises(DataError, match=r"x.mat: damaged: "):
            variables(path)
        assert tracemalloc.get_traced_memory()[1] < 1e6
    finally:
        tracemalloc.stop()
