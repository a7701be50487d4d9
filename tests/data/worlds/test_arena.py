"""Worlds in the arena, of one sensor and of several: noise and outliers as stated, and errors that are undone."""

import math
from dataclasses import fields

import numpy as np
import pytest

from data.errors import UsageError
from data.logs import open_log
from data.pose_measurements import FixKind, expected_closure, expected_fix
from data.se2 import wrap_angle
from data.worlds.arena import Arena, simulate
from data.worlds.registry import named_log
from tests.data.worlds.samples import agrees

MANY = Arena(landmarks=400, side=40.0, frames=1000, clutter=2.0, detection=0.8)


@pytest.fixture(scope="module", params=["range_bearing", "relative_point"])
def made(request):
    arena = Arena(**{f.name: getattr(MANY, f.name) for f in fields(Arena)} | {"sensor": request.param})
    return arena, simulate(arena, 5)


@pytest.fixture(scope="module")
def log(made):
    return made[1]


def test_what_is_in_view_is_read_as_often_as_detected_and_nothing_nearer_or_farther(log):
    o, who, p = log.recorded.observations, log.truth.landmark_of, log.truth.pose
    away = np.linalg.norm(log.truth.landmarks.xy[None] - p[:, None, :2], axis=2)
    there = (away >= MANY.min_range) & (away <= MANY.max_range)
    own = who >= 0
    assert there[o.frame[own], who[own]].all()
    assert own.sum() / there.sum() == pytest.approx(0.8, abs=0.02)
    assert len({*zip(o.frame[own].tolist(), who[own].tolist(), strict=True)}) == own.sum()


def test_a_narrow_view_reads_only_what_is_ahead():
    arena = Arena(landmarks=200, frames=60, field_of_view=math.pi / 2, clutter=5.0)
    log = simulate(arena, 1)
    assert np.abs(log.recorded.observations.z[:, 1]).max() < math.pi / 4 + 5.0 * arena.sigma_bearing
    assert (log.recorded.sensor.min_angle, log.recorded.sensor.max_angle) == pytest.approx((-np.pi / 4, np.pi / 4))
    assert Arena(field_of_view=9.0).model().max_angle == math.pi


def test_the_prior_is_off_by_what_it_states():
    arena = Arena(landmarks=1, frames=2, odometry_rate=2.0)
    logs = [simulate(arena, seed) for seed in range(200)]
    off = np.array([g.recorded.prior.mean - g.truth.pose[0] for g in logs])
    np.testing.assert_allclose(off.std(axis=0), [0.1, 0.1, 0.03], rtol=0.2)
    np.testing.assert_allclose(np.sqrt(np.diag(logs[0].recorded.prior.covariance)), [0.1, 0.1, 0.03])


@pytest.mark.parametrize(("name", "sigma"), [
    ("arena:5", (0.1, 0.02)), ("park:5", (0.1, 0.02)), ("arena:5:sensor=relative_point", (0.1, 0.1)),
])  # fmt: skip
def test_readings_have_the_sensors_errors_and_the_noise_as_stated(name, sigma):
    off = named_log(f"{name}{'+' if name.count(':') > 1 else ':'}range_error=0.05+bearing_error=-0.03")
    o, sensor = off.inputs().observations, off.inputs().sensor
    exact = sensor.predict(off.truth.pose[o.frame], off.inputs().map.xy[off.truth.landmark_of])
    polar = sensor.polar(exact) * [1.05, 1.0] + [0.0, -0.03]
    read = sensor.polar(o.z)
    far = polar[:, 0] > 4.0
    across = (read[far, 1] - polar[far, 1] + np.pi) % (2 * np.pi) - np.pi
    assert agrees(read[far, 0] - polar[far, 0], sigma[0], 0.0)
    assert agrees(across / (1.0 / polar[far, 0] if "point" in name else 1.0), sigma[1], 0.0)
    assert off.truth.errors.names == ("range", "bearing")


def test_a_world_without_errors_says_so_and_its_source_stays_as_it_was():
    log = named_log("corridor:5")
    assert log.truth.errors is None
    assert not {"scale", "range_error"} & set(log.source["corridor"])
    assert named_log("corridor:5:scale=0.1").source["corridor"]["scale"] == 0.1


@pytest.mark.parametrize("world", ["arena", "park", "corridor"])
def test_every_world_refuses_the_same_errors_and_names_itself(world):
    for error, said in (
        ("scale=0.9", "scale = 0.9; an error from -0.5 to 0.5 is needed"),
        ("left=-0.51", "left = -0.51; an error from"), ("right=0.51", "right = 0.51; an error from"),
        ("range_error=1.1", "range_error = 1.1; an error from"), ("drift=-0.01", "drift = -0.01; must not be negative"),
    ):  # fmt: skip
        with pytest.raises(UsageError, match=f"^{world}: {said}"):
            named_log(f"{world}:0:{error}")


SEEDS = range(12)


def squares(log):
    """Squared distances of fixes by source, and of closures, from what the true path says: the stated law."""
    fixes, closures, truth = log.recorded.fixes, log.recorded.closures, log.truth.pose
    found = {}
    for i in range(len(fixes)):
        source = fixes.sources[fixes.source[i]]
        z_hat, _ = expected_fix(truth[fixes.frame[i]], fixes.kind[i], source)
        rows = {0: [0, 1], 1: [2], 2: [0, 1, 2]}[int(fixes.kind[i])]
        off = fixes.z[i][rows] - z_hat
        if fixes.kind[i] != FixKind.POSITION:
            off[-1] = wrap_angle(off[-1])
        found.setdefault(source.name, []).append(off @ np.linalg.solve(fixes.covariance[i][np.ix_(rows, rows)], off))
    for i in range(len(closures)):
        off = closures.relative[i] - expected_closure(truth[closures.frame1[i]], truth[closures.frame2[i]])[0]
        off[2] = wrap_angle(off[2])
        found.setdefault("loops", []).append(off @ np.linalg.solve(closures.covariance[i], off))
    return {name: np.array(values) for name, values in found.items()}


def test_fixes_and_closures_scatter_about_the_true_path_as_stated():
    each = [squares(open_log(f"mixed:{seed}")) for seed in SEEDS]
    for name, dof in (("gps", 2), ("compass", 1), ("loops", 3)):
        pooled = np.concatenate([e[name] for e in each])
        assert abs(pooled.mean() - dof) < 4.0 * np.sqrt(2.0 * dof / len(pooled)), name


@pytest.mark.parametrize(("option", "source", "truth"), [
    ("jumps", "gps", "fix_inlier"), ("false-closures", "loops", "closure_inlier"),
])  # fmt: skip
def test_outliers_are_those_that_the_truth_names(option, source, truth):
    log, sound = open_log(f"mixed:7:{option}"), open_log("mixed:7")
    inlier = getattr(log.truth, truth)
    if truth == "fix_inlier":
        assert inlier[log.recorded.fixes.source == 1].all()
        inlier = inlier[log.recorded.fixes.source == 0]
    far = squares(log)[source] > 30.0
    assert np.array_equal(far, inlier == 0)
    assert far.sum() == max(1, round(0.05 * len(far)))
    assert getattr(sound.truth, truth).all()


def test_beneath_is_the_arena_of_the_same_parameters():
    log, arena = open_log("mixed:3:landmarks=20"), open_log("arena:3:landmarks=20")
    assert np.array_equal(log.truth.pose, arena.truth.pose)
    assert np.array_equal(log.recorded.observations.z, arena.recorded.observations.z)
    assert np.array_equal(log.recorded.increments.mean, arena.recorded.increments.mean)
    assert np.array_equal(log.recorded.prior.mean, arena.recorded.prior.mean)


def test_a_period_of_zero_leaves_a_sensor_out():
    assert open_log("mixed:0:closure_period=0").recorded.closures is None
    assert [s.name for s in open_log("mixed:0:gps_period=0").recorded.fixes.sources] == ["compass"]
    assert open_log("mixed:0:gps_period=0+compass_period=0").recorded.fixes is None
