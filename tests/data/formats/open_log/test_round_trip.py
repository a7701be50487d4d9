"""Any log comes back bit for bit after writing."""

from __future__ import annotations

import math
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from data.formats.open_log.writer import write_folder
from data.inputs import Increments, Inputs, LandmarkMap, Observations, Prior
from data.log import Log
from data.motion.velocity import floor_covariances
from data.pose_measurements import MEASURED, Closures, Fixes, FixKind, FixSource
from data.sensors import RangeBearing, RelativePoint
from data.truth import Truth
from tests.data.formats.open_log.same_log import assert_same_log, load
from tests.quick import examples

numbers = st.floats(-1e6, 1e6)
scales = st.sampled_from([0.0, 1e-12, 1e-7, 1e-3, 1.0, 1e3])
texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
plain_values = st.one_of(texts, st.booleans(), st.integers(-(2**62), 2**62), st.floats(allow_nan=False))
sources = st.dictionaries(texts, st.one_of(plain_values, st.lists(plain_values, max_size=3)), max_size=4)


@st.composite
def matrices(draw, count: int, d: int, *, definite: bool):
    """(count, d, d) exactly symmetric, positive semidefinite, of any rank unless `definite`."""
    root = draw(hnp.arrays(float, (count, d, d), elements=st.floats(-1.0, 1.0), fill=st.just(0.5)))
    scale = draw(hnp.arrays(float, (count, 1, 1), elements=scales, fill=st.just(1e-3)))
    full = scale * (root @ root.transpose(0, 2, 1))
    full += 1e-15 * np.trace(full, axis1=1, axis2=2)[:, None, None] * np.eye(d)
    if definite:
        full += (1e-6 + scale) * np.eye(d)
    return 0.5 * (full + full.transpose(0, 2, 1))


def definite(rng: np.random.Generator, count: int) -> np.ndarray:
    root = rng.normal(size=(count, 3, 3)) * 10.0 ** rng.uniform(-3, 3, (count, 1, 1))
    full = root @ root.transpose(0, 2, 1) + 1e-3 * np.eye(3)
    return 0.5 * (full + full.transpose(0, 2, 1))


def random_fixes(rng: np.random.Generator, frames: int) -> Fixes:
    """Fixes of a log of so many frames."""
    count, sources = int(rng.integers(6)), int(rng.integers(1, 4))
    kind = rng.integers(0, 3, count)
    there = np.array([[entry in MEASURED[each] for entry in range(3)] for each in FixKind])[kind]
    return Fixes(
        np.sort(rng.integers(0, frames, count)),
        kind,
        rng.integers(0, sources, count),
        np.where(there, rng.normal(size=(count, 3)) * 10.0 ** rng.uniform(-6, 6), 0.0),
        np.where(there[:, :, None] & there[:, None, :], definite(rng, count), 0.0),
        tuple(FixSource(f"Ä {k}", tuple(rng.normal(size=2).tolist()), rng.normal()) for k in range(sources)),
    )


def random_closures(rng: np.random.Generator, frames: int) -> Closures:
    """Closures of a log of so many frames, at least two."""
    count, sources = int(rng.integers(6)), int(rng.integers(1, 4))
    first = rng.integers(0, frames, count)
    second = (first + rng.integers(1, frames, count)) % frames
    by = np.argsort(np.maximum(first, second), kind="stable")
    relative = rng.normal(size=(count, 3)) * 10.0 ** rng.uniform(-6, 6)
    names = tuple(f"source-{k}" for k in range(sources))
    return Closures(first[by], second[by], relative, definite(rng, count), rng.integers(0, sources, count), names)


@st.composite
def logs(draw) -> Log:
    n, m, k = draw(st.integers(1, 6)), draw(st.integers(0, 8)), draw(st.integers(0, 4))

    def array(shape, elements=numbers):
        return draw(hnp.arrays(float, shape, elements=elements))

    mean, covariance = array((n, 3)), draw(matrices(n, 3, definite=False))
    mean[0], covariance[0] = 0.0, 0.0
    floor = draw(st.sampled_from([0.0, 1e-10, 1e-4]))
    covariance, floored = floor_covariances(covariance, floor)
    z = array((m, 2))
    sensor_class = draw(st.sampled_from([RangeBearing, RelativePoint]))
    if sensor_class is RangeBearing:
        z[:, 0] = np.abs(z[:, 0])
    low = draw(st.floats(-math.pi, 3.0))
    sensor = sensor_class(
        draw(st.one_of(st.just(math.inf), st.floats(1e-3, 1e6))),
        low,
        draw(st.floats(low, math.pi, exclude_min=True)),
        draw(numbers),
        (draw(numbers), draw(numbers)),
    )
    ids = np.array(sorted(draw(st.sets(st.integers(0, 2**40), min_size=k, max_size=k))), np.int64)
    sigma = np.abs(array((k, 2))) if draw(st.booleans()) else np.zeros((k, 2))
    landmarks = LandmarkMap(ids, array((k, 2)), sigma=sigma if sigma.any() else None) if draw(st.booleans()) else None
    true = LandmarkMap(ids, array((k, 2))) if landmarks is not None and draw(st.booleans()) else landmarks
    claimed = hnp.arrays(np.int64, m, elements=st.integers(-2, 2**40))
    recorded = Inputs(
        prior=Prior(array(3), draw(matrices(1, 3, definite=False))[0]),
        time=np.cumsum(array(n, st.floats(1e-3, 1e3))) + draw(st.sampled_from([0.0, -5.0, 1.3e9])),
        increments=Increments(mean, covariance),
        observations=Observations(
            np.sort(draw(hnp.arrays(np.int64, m, elements=st.integers(0, n - 1)))),
            z,
            draw(matrices(m, 2, definite=True)),
        ),
        sensor=sensor,
        map=landmarks,
        time_is_index=draw(st.booleans()),
        covariance_floor=floor,
        floored=floored,
    )
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    fixes = random_fixes(rng, n) if draw(st.booleans()) else None
    closures = random_closures(rng, n) if n > 1 and draw(st.booleans()) else None
    recorded = replace(recorded, fixes=fixes, closures=closures)
    fix_inlier, closure_inlier = (
        None if some is None or rng.random() < 0.5 else rng.integers(-1, 2, len(some)) for some in (fixes, closures)
    )
    pose = array((n, 3), st.one_of(numbers, st.just(math.nan))) if draw(st.booleans()) else None
    return Log(
        "log",
        recorded,
        Truth(
            pose,
            true,
            draw(claimed) if draw(st.booleans()) else None,
            fix_inlier=fix_inlier,
            closure_inlier=closure_inlier,
        ),
        label=draw(claimed) if draw(st.booleans()) else None,
        labels_are_sensed=draw(st.booleans()),
        source=draw(sources),
        notes=tuple(draw(st.lists(texts, max_size=2))),
    )


@given(logs())
@settings(max_examples=examples(60), deadline=None)
def test_any_log_comes_back_bit_for_bit(log):
    with tempfile.TemporaryDirectory() as folder:
        write_folder(log, Path(folder) / "log")
        assert_same_log(load(Path(folder) / "log"), log)


def test_the_floor_is_reached_from_a_rounding_below_zero():
    covariance = np.array([np.zeros((3, 3)), np.diag([1000.0, 1.0, -5e-10])])
    once, count = floor_covariances(covariance, 1e-10)
    assert count == 1
    assert once[1, 2, 2] == pytest.approx(1e-10)
    assert floor_covariances(once, 1e-10)[1] == 0
