"""An open log folder says what it means, and comes back bit for bit after writing."""

from __future__ import annotations

import dataclasses
import math
import tempfile
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from data.errors import DataError
from data.inputs import UNLABELLED, Increments, Inputs, LandmarkMap, Observations, Prior, floor_covariances
from data.log import Log
from data.motion import VelocityModel, VelocityNoise, preintegrate
from data.open_log.reader import load_folder
from data.open_log.writer import write_folder
from data.sensors import RangeBearing, RelativePoint
from data.truth import CLUTTER, UNKNOWN_ID, Truth

# parts of a log are optional; a test knows which ones its log has
load: Any = load_folder


def test_frames_folder_is_read_as_written(small_log_files, save, tmp_path):
    log = load(save(tmp_path / "any", small_log_files("frames", "relative_point")))
    inputs = log.recorded
    assert log.name == "small"
    assert log.labels_are_sensed
    assert log.source == {"maker": "hand"}
    assert log.notes[0] == "made by hand"
    assert inputs.time.tolist() == [0.0, 0.5, 1.25, 2.0]
    assert inputs.increments.mean[2].tolist() == [0.5, -0.02, -0.3]
    assert inputs.increments.covariance[1].tolist() == [[1e-3, 1e-4, 0], [1e-4, 2e-3, 1e-5], [0, 1e-5, 1e-4]]
    assert inputs.observations.frame.tolist() == [0, 1, 1, 3]
    assert inputs.observations.z[1].tolist() == [1.5, -0.75]
    assert inputs.observations.R[0].tolist() == [[0.01, 0.001], [0.001, 0.02]]
    assert log.truth.landmark_of.tolist() == [3, CLUTTER, UNKNOWN_ID, 7]
    assert log.label.tolist() == [3, 7, UNLABELLED, CLUTTER]
    assert inputs.prior.mean.tolist() == [1.0, 2.0, 0.5]
    assert inputs.prior.covariance.tolist() == [[0.02, 0.01, 0], [0.01, 0.02, 0], [0, 0, 0.01]]
    assert inputs.sensor == RelativePoint(8.0, -1.0, 2.0, 0.1, (0.2, -0.1))
    assert np.array_equal(log.truth.pose[:2], [[1, 2, 0.5], [1.2, 2.1, 0.6]])
    assert np.isnan(log.truth.pose[2:]).all()


def test_landmarks_are_the_map_and_the_truth_ascending_by_id(small_log_files, save, tmp_path):
    log = load(save(tmp_path, small_log_files("frames", "range_bearing")))
    for landmarks in (log.recorded.map, log.truth.landmarks):
        assert landmarks.id.tolist() == [3, 7]
        assert landmarks.xy.tolist() == [[-2.5, 3.0], [4.5, 1.25]]
    assert any("survey's sigmas" in note for note in log.notes)


def test_prior_sigma_and_field_of_view_are_short_for_covariance_and_angles(small_log_files, save, tmp_path):
    inputs = load(save(tmp_path, small_log_files("odometry", "range_bearing"))).recorded
    assert inputs.prior.covariance == pytest.approx(np.diag([0.01, 0.01, 0.0025]))
    assert inputs.sensor == RangeBearing(8.0, -1.5, 1.5, 0.1, (0.2, -0.1))
    assert inputs.observations.R[2] == pytest.approx(np.diag([0.01, 0.0025]))


def test_the_extrinsic_may_be_a_table_of_its_own(small_log_files, save, tmp_path):
    files = small_log_files("frames", "range_bearing")
    flat = load(save(tmp_path / "flat", files)).recorded.sensor
    moved = "rotation = 0.1\ntranslation = [0.2, -0.1]\n"
    files["log.toml"] = files["log.toml"].replace(moved, "") + "[sensor.extrinsic]\n" + moved
    assert load(save(tmp_path / "own", files)).recorded.sensor == flat


def test_odometry_folder_has_a_frame_at_each_observation_and_no_long_gap(small_log_files, save, tmp_path):
    log = load(save(tmp_path, small_log_files("odometry", "range_bearing")))
    inputs = log.recorded
    # first odometry 10, observations 10.25 and 12, last observation 13.75; two keyframes cut 1.75 s in two, twice
    assert inputs.time.tolist() == [10.0, 10.25, 11.125, 12.0, 12.875, 13.75]
    assert inputs.observations.frame.tolist() == [1, 1, 3, 5]
    model = VelocityModel(VelocityNoise("density", sigma=(0.05, 0.02)))
    t, v, w = np.array([[10, 0.5, 0.1], [10.5, 0.6, -0.2], [11, 0, 0], [13.25, 0.4, 0.3], [13.5, 0.4, 0.3]]).T
    expected, gaps = preintegrate(model, t, v, w, inputs.time)
    assert np.array_equal(inputs.increments.mean, expected.mean)
    assert np.array_equal(inputs.increments.covariance, floor_covariances(expected.covariance, 1e-10)[0])
    assert gaps == 1
    assert any("1 gap longer" in note for note in log.notes)


def test_stamped_truth_is_interpolated_at_frames_where_it_is_known_around_them(small_log_files, save, tmp_path):
    pose = load(save(tmp_path, small_log_files("odometry", "range_bearing"))).truth.pose
    # rows at 11 (blank) and a gap from 11.5 to 13.4 leave 11.125, 12 and 12.875 unknown
    assert np.isnan(pose[:, 0]).tolist() == [False, False, True, True, True, False]
    assert pose[1] == pytest.approx([1.1, 2.05, math.pi])
    assert pose[5] == pytest.approx([1.7, 2.2, -2.8])


def test_observations_before_the_first_odometry_and_after_the_last_have_frames(small_log_files, save, tmp_path):
    files = small_log_files("odometry", "range_bearing")
    files["observations.csv"] = "t,z1,z2\n9.5,1,0\n15,1,0\n"
    del files["truth.csv"]
    inputs = load(save(tmp_path, files)).recorded
    assert inputs.time[0] == 9.5
    assert inputs.time[-1] == 15.0
    assert np.diff(inputs.time).max() <= 1.0


def test_everything_optional_may_be_absent(save, tmp_path):
    toml = 'format = 1\nname = "least"\n[prior]\nmean = [0, 0, 0]\nsigma = [0, 0, 0]\n'
    toml += '[sensor]\nkind = "range_bearing"\nsigma = [0.1, 0.1]\n'
    header = "t,dx,dy,dtheta,c_xx,c_xy,c_xt,c_yy,c_yt,c_tt\n"
    files = {"log.toml": toml, "frames.csv": header + "0" + ",0" * 9, "observations.csv": "frame,z1,z2\n"}
    log = load(save(tmp_path, files))
    assert log.recorded.map is None
    assert log.label is None
    assert (log.truth.pose, log.truth.landmarks, log.truth.landmark_of) == (None, None, None)
    assert not log.has_labels
    assert len(log.recorded.observations.frame) == 0
    assert log.recorded.sensor == RangeBearing()
    assert log.recorded.covariance_floor == 1e-10
    write_folder(log, tmp_path / "again")
    again = load(tmp_path / "again").truth
    assert (again.pose, again.landmarks, again.landmark_of) == (None, None, None)


@pytest.mark.parametrize("source", ["frames", "odometry"])
def test_byte_order_mark_crlf_and_blank_lines_at_the_end_change_nothing(small_log_files, save, tmp_path, source):
    files = small_log_files(source, "range_bearing")
    plain = load(save(tmp_path / "plain", files))
    dressed = {
        name: b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode() + b"\r\n\r\n" if name.endswith(".csv") else text
        for name, text in files.items()
    }
    assert_same_log(load(save(tmp_path / "dressed", dressed)), plain)


def test_columns_come_in_any_order_and_unknown_ones_are_named_in_a_note(small_log_files, save, tmp_path):
    files = small_log_files("frames", "relative_point")
    plain = load(save(tmp_path / "plain", files))
    rows = [line.split(",") for line in files["observations.csv"].splitlines()]
    files["observations.csv"] = "\n".join(
        ",".join([*row[::-1], "colour" if i == 0 else "red"]) for i, row in enumerate(rows)
    )
    shuffled = load(save(tmp_path / "shuffled", files))
    assert any("'colour'" in note for note in shuffled.notes)
    assert_same_log(dataclasses.replace(shuffled, notes=plain.notes), plain)


def test_observations_out_of_view_are_kept(small_log_files, save, tmp_path):
    inputs = load(save(tmp_path, small_log_files("frames", "range_bearing"))).recorded
    assert inputs.sensor.in_view(inputs.observations.z).tolist() == [True, True, False, False]


def test_singular_increments_get_the_floor_once_and_are_counted(small_log_files, save, tmp_path):
    log = load(save(tmp_path / "raw", small_log_files("frames", "range_bearing")))
    assert log.recorded.floored == 1
    assert np.array_equal(log.recorded.increments.covariance[3], 1e-9 * np.eye(3))
    assert not log.recorded.increments.covariance[0].any()
    write_folder(log, tmp_path / "written")
    assert_same_log(dataclasses.replace(load(tmp_path / "written"), name="small"), log)


@pytest.mark.parametrize("source", ["frames", "odometry"])
@pytest.mark.parametrize("sensor", ["range_bearing", "relative_point"])
def test_a_read_log_is_written_and_read_again_unchanged(small_log_files, save, tmp_path, source, sensor):
    log = load(save(tmp_path / "raw", small_log_files(source, sensor)))
    write_folder(log, tmp_path / "deep" / "copy")
    assert (tmp_path / "deep" / "copy" / "frames.csv").exists()
    copy = load(tmp_path / "deep" / "copy")
    assert copy.name == "copy"
    assert_same_log(dataclasses.replace(copy, name="small"), log)


def test_recorded_corridor_logs_are_read_and_written_unchanged(shared_data, tmp_path):
    folders = sorted((shared_data / "lab_corridor").glob("corridor_*"))
    if not folders:
        pytest.skip("no recorded corridor logs")
    for folder in folders:
        log = load(folder)
        lines = (folder / "observations.csv").read_text().splitlines()[1:]
        assert len(log.recorded.observations.frame) == len(lines)
        write_folder(log, tmp_path / log.name)
        assert_same_log(load(tmp_path / log.name), log)


# --- round trip -------------------------------------------------------------------------------------------------------


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
    landmarks = LandmarkMap(ids, array((k, 2))) if draw(st.booleans()) else None
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
    pose = array((n, 3), st.one_of(numbers, st.just(math.nan))) if draw(st.booleans()) else None
    return Log(
        "log",
        recorded,
        Truth(pose, landmarks, draw(claimed) if draw(st.booleans()) else None),
        label=draw(claimed) if draw(st.booleans()) else None,
        labels_are_sensed=draw(st.booleans()),
        source=draw(sources),
        notes=tuple(draw(st.lists(texts, max_size=2))),
    )


@given(logs())
@settings(max_examples=60, deadline=None)
def test_any_log_comes_back_bit_for_bit(log):
    with tempfile.TemporaryDirectory() as folder:
        write_folder(log, Path(folder) / "log")
        assert_same_log(load(Path(folder) / "log"), log)


@given(st.data())
@settings(max_examples=60, deadline=None)
def test_flooring_again_changes_no_bit(data):
    covariance = data.draw(matrices(4, 3, definite=False))
    floor = data.draw(st.sampled_from([1e-10, 1e-6, 1e-2]))
    once, _ = floor_covariances(covariance, floor)
    twice, count = floor_covariances(once, floor)
    assert count == 0
    assert np.array_equal(once, twice)
    assert np.linalg.eigvalsh(once[1:]).min() >= floor * (1 - 1e-5) - 1e-11 * np.abs(once).max()


def test_the_floor_is_reached_from_a_rounding_below_zero():
    covariance = np.array([np.zeros((3, 3)), np.diag([1000.0, 1.0, -5e-10])])
    once, count = floor_covariances(covariance, 1e-10)
    assert count == 1
    assert once[1, 2, 2] == pytest.approx(1e-10)
    assert floor_covariances(once, 1e-10)[1] == 0


# --- writing ----------------------------------------------------------------------------------------------------------


@pytest.fixture
def log(small_log_files, save, tmp_path) -> Log:
    return load(save(tmp_path / "given", small_log_files("frames", "range_bearing")))


def test_a_log_folder_is_replaced_whole(log, tmp_path):
    target = tmp_path / "out"
    write_folder(log, target)
    write_folder(dataclasses.replace(log, truth=Truth(), recorded=log.recorded.without_map()), str(target) + "/")
    assert sorted(p.name for p in target.iterdir()) == ["frames.csv", "log.toml", "observations.csv"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["given", "out"]


def test_an_empty_folder_is_filled(log, tmp_path):
    (tmp_path / "out").mkdir()
    write_folder(log, tmp_path / "out")
    assert load(tmp_path / "out").name == "out"


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


def test_a_place_that_cannot_be_written_is_a_data_error(log, tmp_path):
    (tmp_path / "file").write_text("work")
    with pytest.raises(DataError, match="cannot be written"):
        write_folder(log, tmp_path / "file" / "out")


class Interrupted(BaseException):
    pass


def test_an_interrupted_write_leaves_the_old_log_and_no_debris(log, tmp_path, monkeypatch):
    target = tmp_path / "out"
    write_folder(log, target)
    before = {p.name: p.read_bytes() for p in target.iterdir()}
    real_write, real_rename = Path.write_text, Path.rename
    for fail_at in ("observations.csv", "out"):

        def write(self, *args, fail_at=fail_at, **kwargs):
            if self.name == fail_at:
                raise Interrupted
            return real_write(self, *args, **kwargs)

        def rename(self, to, fail_at=fail_at):
            if Path(to).name == fail_at and ".partial-" in self.name:
                raise Interrupted
            return real_rename(self, to)

        with monkeypatch.context() as patched:
            patched.setattr(Path, "write_text", write)
            patched.setattr(Path, "rename", rename)
            with pytest.raises(Interrupted):
                write_folder(dataclasses.replace(log, truth=Truth()), target)
        assert {p.name: p.read_bytes() for p in target.iterdir()} == before
        assert sorted(p.name for p in tmp_path.iterdir()) == ["given", "out"]


def test_a_log_that_could_not_be_read_again_is_not_written(log, tmp_path):
    z = log.recorded.observations.z.copy()
    z[0, 0] = math.nan
    o = log.recorded.observations
    broken = dataclasses.replace(
        log, recorded=dataclasses.replace(log.recorded, observations=Observations(o.frame, z, o.R))
    )
    with pytest.raises(DataError, match=r"observations.csv: line 2, column z1: nan"):
        write_folder(broken, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_map_that_differs_from_the_true_landmarks_has_no_place_in_the_format(log, tmp_path):
    moved = LandmarkMap(log.recorded.map.id, log.recorded.map.xy + 1.0)
    with pytest.raises(DataError, match="differs from its true landmarks"):
        write_folder(dataclasses.replace(log, recorded=dataclasses.replace(log.recorded, map=moved)), tmp_path / "out")


def test_the_header_is_plain_toml_whatever_the_source_holds(log, tmp_path):
    source = {
        "seed": np.int64(3),
        "sigma": np.array([0.1, 0.2]),
        "file": Path("a") / "b",
        "no": None,
        'odd "key"': "\x7f\n\\é",
    }
    write_folder(dataclasses.replace(log, source=source), tmp_path / "out")
    with (tmp_path / "out" / "log.toml").open("rb") as file:
        written = tomllib.load(file)["source"]
    assert written == {"seed": 3, "sigma": [0.1, 0.2], "file": str(Path("a") / "b"), 'odd "key"': "\x7f\n\\é"}
