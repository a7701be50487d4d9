"""Any log comes back bit for bit from its folder, replaced whole, and from arrays; wrong arrays are refused."""

import math
import tempfile
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from hypothesis.extra import numpy as hnp

import slamref
from data.errors import DataError
from data.formats.open_log import load_folder, write_folder
from data.inputs import Increments, Inputs, LandmarkMap, Observations, Prior
from data.log import Log
from data.logs import open_log
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
        draw(st.one_of(st.just(math.inf), st.floats(1e-3, 1e6))), low, draw(st.floats(low, math.pi, exclude_min=True)),
        draw(numbers), (draw(numbers), draw(numbers)),
    )  # fmt: skip
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
        sensor=sensor, map=landmarks, time_is_index=draw(st.booleans()), covariance_floor=floor, floored=floored,
    )  # fmt: skip
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    fixes = random_fixes(rng, n) if draw(st.booleans()) else None
    closures = random_closures(rng, n) if n > 1 and draw(st.booleans()) else None
    recorded = replace(recorded, fixes=fixes, closures=closures)
    fix_inlier, closure_inlier = (
        None if some is None or rng.random() < 0.5 else rng.integers(-1, 2, len(some)) for some in (fixes, closures)
    )
    pose = array((n, 3), st.one_of(numbers, st.just(math.nan))) if draw(st.booleans()) else None
    return Log(
        "log", recorded,
        Truth(
            pose,
            true,
            draw(claimed) if draw(st.booleans()) else None,
            fix_inlier=fix_inlier,
            closure_inlier=closure_inlier,
        ),
        label=draw(claimed) if draw(st.booleans()) else None, labels_are_sensed=draw(st.booleans()),
        source=draw(sources), notes=tuple(draw(st.lists(texts, max_size=2))),
    )  # fmt: skip


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


@pytest.fixture
def log(small_log_files, save, tmp_path) -> Log:
    return load(save(tmp_path / "given", small_log_files("frames", "range_bearing")))


def test_a_log_folder_is_replaced_whole(log, tmp_path):
    target = tmp_path / "out"
    write_folder(log, target)
    write_folder(replace(log, truth=Truth(), recorded=log.recorded.without_map()), str(target) + "/")
    assert sorted(p.name for p in target.iterdir()) == ["frames.csv", "log.toml", "observations.csv"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["given", "out"]


@pytest.mark.parametrize(
    ("inside", "named"), [(["thesis.tex"], "not a log folder"), (["log.toml", "thesis.tex"], "'thesis.tex'")]
)
def test_a_folder_that_holds_anything_else_is_left_alone(log, tmp_path, inside, named):
    target = tmp_path / "precious"
    target.mkdir()
    for name in inside:
        (target / name).write_text("work")
    with pytest.raises(DataError, match=named) as raised:
        write_folder(log, target)
    assert str(target) in str(raised.value)
    assert sorted(p.name for p in target.iterdir()) == sorted(inside)


def test_a_file_or_a_link_in_the_way_is_left_alone(log, tmp_path):
    (tmp_path / "file").write_text("work")
    (tmp_path / "link").symlink_to(tmp_path / "given")
    for name in ("file", "link"):
        with pytest.raises(DataError, match="not a folder"):
            write_folder(log, tmp_path / name)
    assert (tmp_path / "file").read_text() == "work"
    assert (tmp_path / "given" / "log.toml").exists()


def test_a_log_that_could_not_be_read_again_and_a_map_without_a_true_landmark_are_not_written(log, tmp_path):
    z, o, known = log.recorded.observations.z.copy(), log.recorded.observations, log.recorded.map
    z[0, 0] = math.nan
    for broken, said in (
        ({"observations": Observations(o.frame, z, o.R)}, r"observations.csv:2: column z1: nan"),
        ({"map": LandmarkMap(known.id[1:], known.xy[1:])}, "lacks some of its true landmarks"),
    ):
        with pytest.raises(DataError, match=said):
            write_folder(replace(log, recorded=replace(log.recorded, **broken)), tmp_path / "out")
        assert not (tmp_path / "out").exists()


def test_the_header_is_plain_toml_whatever_the_source_holds(log, tmp_path):
    source = {
        "seed": np.int64(3), "sigma": np.array([0.1, 0.2]), "file": Path("a") / "b", "no": None,
        'odd "key"': "\x7f\n\\é",
    }  # fmt: skip
    write_folder(replace(log, source=source), tmp_path / "out")
    with (tmp_path / "out" / "log.toml").open("rb") as file:
        written = tomllib.load(file)["source"]
    assert written == {"seed": 3, "sigma": [0.1, 0.2], "file": str(Path("a") / "b"), 'odd "key"': "\x7f\n\\é"}


SENSOR = {"kind": "relative_point", "sigma": np.array([0.1, 0.1])}
STEPS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.1], [1.0, 0.0, 0.0]])
SEEN = np.array([[0, 4.0, 1.0], [1, 3.0, 1.0], [2, 2.0, 1.0]])
PRIOR = (np.zeros(3), np.zeros(3))


def made(**changed):
    given = {"increments": STEPS, "covariance": [0.1, 0.1, 0.02], **changed}
    return Log.from_arrays(
        "mine", given.pop("prior", PRIOR), given.pop("sensor", SENSOR), given.pop("seen", SEEN), **given
    )


def arrays(log):
    r, t = log.recorded, log.truth
    o = r.observations
    return (r.prior.mean, r.prior.covariance, r.time, r.increments.mean, r.increments.covariance, o.frame, o.z, o.R), t


def test_a_log_from_arrays_is_the_log_of_the_same_numbers_in_a_folder(tmp_path):
    world = open_log("arena:3")
    r, o, t = world.recorded, world.recorded.observations, world.truth
    again = slamref.Log.from_arrays(
        "arena_3", (r.prior.mean, r.prior.covariance),
        {
            "kind": "range_bearing", "max_range": r.sensor.max_range, "min_angle": r.sensor.min_angle,
            "max_angle": r.sensor.max_angle,
        },
        np.column_stack([o.frame, o.z]), increments=r.increments.mean, covariance=r.increments.covariance, time=r.time,
        R=o.R, landmarks=np.column_stack([t.landmarks.id, t.landmarks.xy]), truth=t.pose, true_id=t.landmark_of,
    )  # fmt: skip
    write_folder(world, tmp_path / "arena_3")
    read = load_folder(tmp_path / "arena_3")
    for one, other in zip(arrays(again)[0], arrays(read)[0], strict=True):
        np.testing.assert_array_equal(one, other)
    assert again.recorded.sensor == read.recorded.sensor
    np.testing.assert_array_equal(again.truth.pose, read.truth.pose)
    np.testing.assert_array_equal(again.truth.landmark_of, read.truth.landmark_of)


def test_one_covariance_holds_for_all_frames_but_the_first():
    log = made()
    np.testing.assert_allclose(log.recorded.increments.covariance[1:], np.tile(np.diag([0.01, 0.01, 4e-4]), (2, 1, 1)))
    assert log.recorded.time_is_index


@pytest.mark.parametrize(("changed", "message"), [
    ({"seen": [[0, 4.0, np.nan]]}, "mine: observations:0: column z2: nan is not a number"),
    ({"seen": [[3, 4.0, 1.0]]}, "mine: observations:0: column frame: 3 is out of range; there are frames 0 to 2"),
    ({"seen": np.ones((4, 2))}, r"mine: observations: shape \(4, 2\); \(rows, 3\) is needed"),
    ({"time": [0.0, 1.0, 1.0]}, "mine: increments:2: column t: 1 follows 1.0; t must increase"),
    ({"covariance": None}, "increments need a covariance"),
    ({"covariance": [[1.0, 2.0, 0], [0, 1.0, 0], [0, 0, 1.0]]}, "mine: covariance: not symmetric"),
    ({"truth": np.zeros((2, 3))}, "mine: truth:1: 2 rows for 3 frames"), ({"sensor": {"kind": "sonar"}}, "sonar"),
    ({"odometry": np.zeros((3, 3))}, "either increments or odometry is needed"),
    ({"label": [1, 2]}, r"label has shape \(2,\); \(3,\) is needed"),
])  # fmt: skip
def test_a_wrong_array_is_refused_with_its_row(changed, message):
    with pytest.raises(DataError, match=message):
        made(**changed)


def test_a_log_prints_a_few_lines():
    assert str(open_log("arena:0")).splitlines() == [
        "Log arena:0", "  frames: 200 (99.5 s)", "  observations: 1627", "  sensor: range_bearing",
        "  map: 25 landmarks", "  truth: in 200 frames", "  labels: yes",
    ]  # fmt: skip
    assert str(made(seen=np.empty((0, 3)), label=[])).endswith("  labels: none")
