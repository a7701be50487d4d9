"""Whether two logs are the same, bit for bit, and whether one keeps every promise that is relied on."""

import dataclasses
import math
from typing import Any

import numpy as np

from data.formats.open_log import load_folder
from data.inputs import CLUTTER, UNLABELLED, IntArray
from data.log import Log
from data.pose_measurements import MEASURED, FixKind
from data.se2 import Array
from data.sensors import RelativePoint
from data.truth import UNKNOWN_ID

# parts of a log are optional; a test knows which ones its log has
load: Any = load_folder


def assert_same_log(a: Any, b: Any, where: str = "log") -> None:
    """Equal to the last bit, NaN and the sign of zero included."""
    assert type(a) is type(b), where
    if isinstance(a, np.ndarray):
        assert a.dtype == b.dtype, where
        assert a.shape == b.shape, where
        assert np.where(a == a, a, 0).tobytes() == np.where(b == b, b, 0).tobytes(), where
        assert np.array_equal(np.isnan(a), np.isnan(b)), where
    elif dataclasses.is_dataclass(a):
        for f in dataclasses.fields(a):
            assert_same_log(getattr(a, f.name), getattr(b, f.name), f"{where}.{f.name}")
    else:
        assert a == b, where


def assert_definite(P: Array) -> None:
    sigma = np.sqrt(np.diagonal(P))
    assert (sigma > 0.0).all()
    assert np.linalg.eigvalsh(P / sigma[:, None] / sigma)[0] > 0.0


def assert_sound(log: Log) -> None:
    inputs = log.recorded
    o, n, m = inputs.observations, len(inputs.time), len(inputs.observations.frame)
    assert n >= 1
    assert np.isfinite(inputs.time).all()
    assert (np.diff(inputs.time) > 0).all()
    for covariance, count, d in (
        (inputs.prior.covariance[None], 1, 3), (inputs.increments.covariance, n, 3), (o.R, m, 2),
    ):  # fmt: skip
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
