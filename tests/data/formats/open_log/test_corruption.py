"""A corrupted log folder is refused with its place or read soundly."""

from __future__ import annotations

import math
import re
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data.errors import DataError
from data.formats.open_log import FILES, load_folder
from data.inputs import CLUTTER, UNLABELLED, IntArray
from data.log import Log
from data.pose_measurements import MEASURED, FixKind
from data.se2 import Array
from data.sensors import RelativePoint
from data.truth import UNKNOWN_ID
from tests.data.conftest import Files
from tests.data.formats.open_log.measured import measured_files
from tests.data.formats.open_log.test_sensors import files_of
from tests.quick import slow


def assert_definite(P: Array) -> None:
    sigma = np.sqrt(np.diagonal(P))
    assert (sigma > 0.0).all()
    assert np.linalg.eigvalsh(P / sigma[:, None] / sigma)[0] > 0.0


def assert_sound(log: Log) -> None:
    """Every promise that estimators and referee rely on."""
    inputs = log.recorded
    o, n, m = inputs.observations, len(inputs.time), len(inputs.observations.frame)
    assert n >= 1
    assert np.isfinite(inputs.time).all()
    assert (np.diff(inputs.time) > 0).all()
    for covariance, count, d in (
        (inputs.prior.covariance[None], 1, 3),
        (inputs.increments.covariance, n, 3),
        (o.R, m, 2),
    ):
        assert covariance.shape == (count, d, d)
        assert np.isfinite(covariance).all()
        assert np.allclose(covariance, covariance.transpose(0, 2, 1), rtol=1e-9, atol=0.0)
        assert (np.linalg.eigvalsh(covariance) >= -2e-12 * np.trace(covariance, axis1=1, axis2=2)[:, None]).all()
    sigma = np.sqrt(o.R[:, [0, 1], [0, 1]])  # roots first: the product of two tiny variances is zero
    assert (np.linalg.det(o.R / sigma[:, :, None] / sigma[:, None, :]) > 0).all()
    assert inputs.prior.mean.shape == (3,)
    assert inputs.increments.mean.shape == (n, 3)
    assert o.z.shape == (m, 2)
    for array in (inputs.prior.mean, inputs.increments.mean, o.z):
        assert np.isfinite(array).all()
    assert not inputs.increments.mean[0].any()
    assert not inputs.increments.covariance[0].any()
    assert (np.diff(o.frame) >= 0).all()
    assert ((o.frame >= 0) & (o.frame < n)).all()
    assert (o.sensor is None) == (inputs.sensors == ())
    which = np.zeros(m, np.int64) if o.sensor is None else o.sensor
    assert ((np.diff(which) >= 0) | (np.diff(o.frame) > 0)).all()
    for i, sensor in enumerate(inputs.sensors or (inputs.sensor,)):
        rows = which == i
        if not isinstance(sensor, RelativePoint):
            assert (o.z[rows, 0] >= 0).all()
        if not sensor.locates:
            unmeasured = 1 - sensor.measures[0]
            assert not o.z[rows, unmeasured].any()
            assert (o.R[rows, unmeasured, unmeasured] == 1.0).all()
            assert not o.R[rows, 0, 1].any()
        assert sensor.max_range > 0
        assert sensor.min_angle < sensor.max_angle
        assert math.isfinite(sensor.rotation)
        assert np.isfinite(sensor.translation).all()
    assert set(which.tolist()) <= set(range(max(len(inputs.sensors), 1)))
    if inputs.fixes is not None:
        f = inputs.fixes
        assert (np.diff(f.frame) >= 0).all()
        assert ((f.frame >= 0) & (f.frame < n)).all()
        assert ((f.source >= 0) & (f.source < len(f.sources))).all()
        for kind, z, P in zip(f.kind.tolist(), f.z, f.covariance, strict=True):
            of = list(MEASURED[FixKind(kind)])
            rest = [entry for entry in range(3) if entry not in of]
            assert np.isfinite(z).all()
            assert not z[rest].any()
            assert not P[rest].any()
            assert_definite(P[np.ix_(of, of)])
        assert log.truth.fix_inlier is None or log.truth.fix_inlier.shape == f.frame.shape
    if inputs.closures is not None:
        c = inputs.closures
        assert (np.diff(c.later) >= 0).all()
        assert ((c.earlier >= 0) & (c.earlier < c.later) & (c.later < n)).all()
        assert ((c.source >= 0) & (c.source < len(c.sources))).all()
        assert np.isfinite(c.relative).all()
        for P in c.covariance:
            assert_definite(P)
        assert log.truth.closure_inlier is None or log.truth.closure_inlier.shape == c.frame1.shape
    for landmarks in (inputs.map, log.truth.landmarks):
        if landmarks is not None:
            assert (landmarks.id >= 0).all()
            assert (np.diff(landmarks.id) > 0).all()
            assert np.isfinite(landmarks.xy).all()
    assert log.truth.pose is None or (log.truth.pose.shape == (n, 3) and not np.isinf(log.truth.pose).any())
    ids: list[tuple[IntArray | None, int]] = [(log.truth.landmark_of, UNKNOWN_ID), (log.label, UNLABELLED)]
    for claimed, blank in ids:
        assert claimed is None or (claimed.shape == (m,) and ((claimed >= CLUTTER) | (claimed == blank)).all())


junk = st.one_of(
    st.sampled_from(
        ["", "nan", "inf", "-inf", "-1", "0", "1e-320", "1e30", "-1e300", "1e999", "9" * 400, "x", "1_0", '"1"']
    ),
    st.sampled_from(["0.5", "1,", "\u0663", "\x00", "#", "1e5", "true", "-0.0", "1e14", "-1e-3", "[1, 2]", "[]", "{}"]),
    st.floats().map(repr),
    st.integers(-(10**18), 10**18).map(str),
    st.text(max_size=5),
)


@st.composite
def corruptions(draw, files: dict[str, str]) -> dict[str, bytes]:
    """The files with one to three faults of any sort."""
    broken = {name: text.encode() for name, text in files.items()}
    for _ in range(draw(st.integers(1, 3))):
        name = draw(st.sampled_from(sorted(broken)))
        content = broken[name]
        lines = content.split(b"\n")
        i, j = draw(st.integers(0, len(lines) - 1)), draw(st.integers(0, len(lines) - 1))
        new = draw(junk).encode("utf-8", "replace")
        fault = draw(
            st.sampled_from(
                ["field", "field", "field", "delete", "column", "cut", "twice", "swap", "truncate", "append", "bytes"]
            )
        )
        separator = b"=" if name == "log.toml" and draw(st.booleans()) else b","
        if fault == "delete":
            if len(broken) > 1:
                del broken[name]
            continue
        if fault == "field":
            fields = lines[i].split(separator)
            fields[draw(st.integers(0, len(fields) - 1))] = new
            lines[i] = separator.join(fields)
        elif fault == "column":
            k = draw(st.integers(0, lines[0].count(b",")))
            lines = [b",".join(f for c, f in enumerate(line.split(b",")) if c != k) for line in lines]
        elif fault == "cut":
            lines[i] = lines[i][: draw(st.integers(0, len(lines[i])))]
        elif fault == "twice":
            lines.insert(i, lines[i])
        elif fault == "swap":
            lines[i], lines[j] = lines[j], lines[i]
        content = b"\n".join(lines)
        if fault == "truncate":
            content = content[: draw(st.integers(0, len(content)))]
        elif fault == "append":
            content += new
        elif fault == "bytes":
            at = draw(st.integers(0, len(content)))
            content = content[:at] + draw(st.binary(max_size=4)) + content[at + draw(st.integers(0, 4)) :]
        broken[name] = content
    return broken


@pytest.mark.parametrize("source", ["frames", "odometry"])
@pytest.mark.parametrize("sensor", ["range_bearing", "relative_point"])
@pytest.mark.parametrize("examples", [30, slow(400)])
def test_a_corrupted_folder_is_refused_with_its_place_or_read_soundly(small_log_files, save, source, sensor, examples):
    refused_or_sound(small_log_files(source, sensor), save, examples)


@pytest.mark.parametrize("source", ["frames", "odometry"])
@pytest.mark.parametrize("examples", [30, slow(5000)])
def test_corrupted_fixes_and_closures_are_refused_with_their_place_or_read_soundly(save, source, examples):
    refused_or_sound(measured_files(source), save, examples)


@pytest.mark.parametrize("source", ["frames", "odometry"])
@pytest.mark.parametrize("examples", [30, pytest.param(5000, marks=pytest.mark.slow)])
def test_corrupted_sensors_are_refused_with_their_place_or_read_soundly(save, source, examples):
    refused_or_sound(files_of(source), save, examples)


def refused_or_sound(files: Files, save: Callable[[Path, Files], Path], examples: int) -> None:
    @given(corruptions(files))
    @settings(max_examples=examples, deadline=None)
    def check(broken):
        with tempfile.TemporaryDirectory() as temporary:
            folder = save(Path(temporary) / "log", broken)
            try:
                log = load_folder(folder)
            except DataError as error:
                message = str(error)
                assert "\n" not in message
                named = [name for name in FILES if message.startswith(f"{folder / name}:")]
                assert len(named) == 1
                # a fault inside a table has a line
                if named[0].endswith(".csv") and (folder / named[0]).exists() and "sigma in [sensor]" not in message:
                    assert re.match(rf"{re.escape(str(folder / named[0]))}:\d+", message)
            else:
                assert_sound(log)

    check()
