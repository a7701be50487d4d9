"""Foreign worlds: the same seed gives the same bytes, a sound log's covariances are true, a fault changes its part."""

import numpy as np
import pytest

from data import se2
from data.log import Log
from data.se2 import Array
from eval.compare import compare
from tests.research.foreign import causes
from tests.research.foreign.faults import FAULTS
from tests.research.foreign.shapes import SHAPES
from tests.research.foreign.study import Case
from tests.research.foreign.world import make

POLAR = "eight"


def parts(log: Log) -> dict[str, Array]:
    r, t = log.recorded, log.truth
    assert r.map is not None
    assert t.pose is not None
    assert t.landmarks is not None
    assert log.granted is not None
    return {
        "prior": r.prior.mean, "odometry": r.increments.mean, "odometry covariance": r.increments.covariance,
        "z": r.observations.z, "R": r.observations.R, "map": r.map.xy, "pose": t.pose, "landmarks": t.landmarks.xy,
        "labels": log.granted,
    }  # fmt: skip


def changed(shape: str, fault: str, strength: float = 1.0) -> set[str]:
    """What a fault changes of the sound log of the seed."""
    sound, faulty = parts(make(shape, 5)), parts(make(shape, 5, fault, strength))
    return {name for name, value in sound.items() if not np.array_equal(value, faulty[name])}


@pytest.mark.parametrize("shape", SHAPES)
def test_noise_of_a_sound_log_has_the_stated_covariance(shape):
    log = make(shape, 5)
    r, o, pose, known = log.recorded, log.recorded.observations, log.truth.pose, log.truth.landmarks
    exact = r.sensor.predict(pose[o.frame], known.positions(log.truth.landmark_of))
    error = r.sensor.residual(o.z, exact) / np.sqrt(np.einsum("mii->mi", o.R))
    step = se2.pose_error(r.increments.mean[1:], se2.between(pose[:-1], pose[1:]))
    step /= np.sqrt(np.einsum("nii->ni", r.increments.covariance[1:]))
    for noise in (error, step):
        assert np.abs(noise.mean(axis=0)).max() < 4.0 / np.sqrt(len(noise))
        assert np.abs((noise**2).mean(axis=0) - 1.0).max() < 4.0 * np.sqrt(2.0 / len(noise))
    assert r.sensor.in_view(exact).all()


@pytest.mark.slow
def test_nees_with_labels_in_the_known_map_is_3_over_sound_logs():
    means = []
    for shape in SHAPES:
        for seed in (20, 21, 22):
            log = make(shape, seed)
            for run in compare(log.inputs(labels=True), "localization", ("ekf", "batch"), "known"):
                path = run.trajectory(run.phases[0])
                e = se2.pose_error(path.pose, log.truth.pose)
                means.append(np.einsum("ni,nij,nj->n", e, np.linalg.inv(path.covariance), e).mean())
    assert np.mean(means) == pytest.approx(3.0, abs=0.25)
    assert max(means) < 9.0


ODOMETRY, READINGS, MAP, LABELS = {"odometry"}, {"z"}, {"map"}, {"labels"}
CHANGES = {
    **dict.fromkeys(("odometry-sigma", "gyro-bias", "wheel-radius", "wheel-base", "wheel-slip", "stride"), ODOMETRY),
    **dict.fromkeys(("turn-first", "interval-end"), ODOMETRY),
    **dict.fromkeys(("range-sigma", "range-scale", "bearing-offset", "ar1", "noisy-stretch", "tails"), READINGS),
    **dict.fromkeys(("outliers", "mirrored", "sensor-sigma", "sensor-sigma-half", "focal-length"), READINGS),
    **dict.fromkeys(("map-swapped", "map-moved", "map-scale"), MAP),
    "shared-label": LABELS,
}
"""What a fault changes; all others change which landmarks are in view as well."""


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_changes_its_part_and_nothing_of_it_at_strength_0(fault):
    found = changed(POLAR, fault)
    assert found == CHANGES[fault] if fault in CHANGES else "z" in found
    assert not found & {"odometry covariance", "landmarks", "map"} - MAP
    if fault in ("gyro-bias", "wheel-radius", "wheel-base", "range-scale", "turn-first", "latency", "mount-0.5"):
        assert not changed(POLAR, fault, 0.0)


def readings(fault: str | None, shape: str = POLAR) -> tuple[Log, Array]:
    """A log, and its readings against those of the true pose and map, in stated sigmas."""
    log = make(shape, 5, fault)
    r, o = log.recorded, log.recorded.observations
    exact = r.sensor.predict(log.truth.pose[o.frame], log.truth.landmarks.positions(log.truth.landmark_of))
    return log, r.sensor.residual(o.z, exact) / np.sqrt(np.einsum("mii->mi", o.R))


def test_faults_of_the_sensor_have_their_size():
    log, late = readings("latency")
    o, pose = log.recorded.observations, log.truth.pose
    speed, rate = np.gradient(np.unwrap(pose[:, 2]), log.recorded.time), late[:, 1] * np.sqrt(o.R[:, 1, 1])
    turning = np.abs(speed[o.frame]) > 0.3
    assert np.polyfit(speed[o.frame][turning], rate[turning], 1)[0] == pytest.approx(0.08, abs=0.03)
    log, offset = readings("bearing-offset")
    bias = np.mean(offset[:, 1] * np.sqrt(log.recorded.observations.R[:, 1, 1]))
    assert np.degrees(bias) == pytest.approx(1.9, abs=0.1)
    assert readings("range-sigma")[1].std(axis=0) == pytest.approx([2.0, 1.0], abs=0.08)
    assert np.std(readings("tails")[1]) == pytest.approx(1.0, abs=0.15)
    assert np.mean(readings("tails")[1] ** 4) > 5.0
    assert np.mean(np.abs(readings("outliers")[1]).max(axis=1) > 5.0) == pytest.approx(0.05, abs=0.015)
    log, ar = readings("ar1")
    rows = np.flatnonzero(log.truth.landmark_of == np.bincount(log.truth.landmark_of).argmax())
    next_to = np.diff(log.recorded.observations.frame[rows]) == 1
    pairs = ar[rows][:-1][next_to], ar[rows][1:][next_to]
    assert np.corrcoef(pairs[0].ravel(), pairs[1].ravel())[0, 1] == pytest.approx(0.9, abs=0.06)
    assert ar.std() == pytest.approx(1.0, abs=0.12)


def test_faults_of_motion_have_their_size():
    sound = make("warehouse", 5)
    motion = sound.recorded.increments.mean
    turned = make("warehouse", 5, "gyro-bias").recorded.increments.mean[1:, 2] - motion[1:, 2]
    assert np.degrees(turned) == pytest.approx(0.5 * np.diff(sound.recorded.time))
    step = np.hypot(*np.diff(make("warehouse", 5, "kidnapping").truth.pose[:, :2], axis=0).T)
    assert np.sum(step > 1.0) == 1
    assert step.max() == pytest.approx(1.5, abs=0.4)
    slip = make("warehouse", 5, "lateral-slip").truth.pose
    aside = se2.between(slip[:-1], slip[1:])
    straight = np.abs(aside[:, 2]) < 1e-6
    assert aside[straight, 1] / aside[straight, 0] == pytest.approx(0.02, rel=0.05)


SOUND = Case("eight", 1, "", "slam", "known")


def diagnosed(fault: str, named: str, *, objected: bool = True) -> causes.Row:
    return causes.Row(
        "eight", 1, fault, "slam", "known", 1.0, 19, nees_filter=3.0, nees_smoother=3.0, objected=objected, named=named
    )


@pytest.mark.parametrize(("named", "kind"), [
    ("systematic odometry_theta_time", causes.RIGHT),
    ("systematic odometry_theta_distance|systematic odometry_theta_time; sigma z1", causes.ONE_OF),
    ("sigma z1; systematic odometry_theta_time", causes.LATER), ("sigma z1; tails readings", causes.WRONG),
    ("", causes.UNNAMED),
])  # fmt: skip
def test_what_is_named_first_counts(named, kind):
    assert causes.kind_of(diagnosed("gyro-bias", named)) == kind
    assert causes.kind_of(diagnosed("gyro-bias", named, objected=False)) == causes.MISSED
