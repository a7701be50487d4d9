"""Logs with several sensors, and with bearings or ranges alone."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from data.inputs import Inputs, LandmarkMap, Observations
from data.log import Log
from data.se2 import compose, pose_error
from data.sensors import Bearing, Range, RangeBearing, RelativePoint, Sensor
from data.truth import Truth
from eval.referee import consistency
from eval.referee.score import confusion_of
from eval.replay.batch import _chordal, batch
from eval.replay.run import compare, step_by_step
from tests.builders.logs import increments_of, inputs_of
from tests.quick import slow

LIDAR = RangeBearing(max_range=12.0, translation=(-0.2, 0.0), label="lidar", sees="tree")
CAMERA = Bearing(rotation=0.1, label="camera")
TAGS = RelativePoint(max_range=6.0, translation=(0.1, 0.05), label="tags", sees="tree")
RADIO = Range(label="radio", sees="beacon")
SIGMA = {"lidar": (0.1, 0.01), "camera": (1.0, 0.01), "tags": (0.05, 0.05), "radio": (0.1, 1.0)}


def drive(seed: int, sensors: tuple[Sensor, ...], frames: int = 60) -> Log:
    """A circle among trees and two beacons, observed with all of these sensors."""
    rng = np.random.default_rng(seed)
    around, away = rng.uniform(-np.pi, np.pi, 12), rng.choice([-1.0, 1.0], 12) * rng.uniform(1.5, 4.0, 12)
    trees = np.stack([(5.0 + away) * np.cos(around), 5.0 + (5.0 + away) * np.sin(around)], 1)  # beside the path
    known = LandmarkMap(
        np.arange(14), np.concatenate([trees, [[-9.0, 12.0], [9.0, -3.0]]]), ("tree",) * 12 + ("beacon",) * 2
    )
    step, spread = np.array([0.3, 0.0, 0.06]), np.diag([0.02, 0.01, 0.01]) ** 2
    pose = [rng.multivariate_normal(np.zeros(3), np.diag([0.05, 0.05, 0.02]) ** 2)]
    for _ in range(frames - 1):
        pose.append(compose(pose[-1], step))
    path = np.array(pose)
    mean = np.tile(step, (frames, 1)) + rng.multivariate_normal(np.zeros(3), spread, frames)
    frame, z, R, which, true = [], [], [], [], []
    for k in range(frames):
        for i, sensor in enumerate(sensors):
            sigma = np.array(SIGMA[sensor.label])
            here = sensor.predict(path[k], known.xy)
            kinds = np.array([not sensor.sees or kind == sensor.sees for kind in known.kind])
            for n in np.flatnonzero(sensor.in_view(here) & kinds & (rng.random(14) < 0.6)):
                noise = rng.standard_normal(2) * sigma * [q in sensor.measures for q in (0, 1)]
                frame.append(k)
                z.append(here[n] + noise)
                R.append(np.diag(np.where([q in sensor.measures for q in (0, 1)], sigma**2, 1.0)))
                which.append(i)
                true.append(n)
    several = len(sensors) > 1
    seen = Observations(
        np.array(frame), np.array(z), np.array(R), sensor=np.array(which, np.int64) if several else None
    )
    inputs = inputs_of(
        increments_of(mean, spread), seen, sensors[0], known, time=0.1 * np.arange(frames),
        spread=np.diag([0.05, 0.05, 0.02]) ** 2, sensors=sensors if several else (),
    )  # fmt: skip
    return Log("drive", inputs, Truth(path, known, np.array(true)))


ALL = (LIDAR, CAMERA, TAGS, RADIO)


@pytest.mark.parametrize("sensors", [(CAMERA,), (RADIO,), ALL], ids=["bearings", "ranges", "all"])
@pytest.mark.parametrize(
    "name", ["ekf", "isam2", *map(slow, ["ekf-iterated", "ekf-fej", "ekf-invariant", "fixed-lag", "batch"])]
)
def test_localization_is_consistent(sensors, name):
    """The NIS has as many degrees of freedom as numbers were measured, and errors fit their covariance."""
    nis, dof, nees = 0.0, 0, []
    for seed in range(2):
        log = drive(seed, sensors, frames=40)
        inputs = log.inputs(labels=True)
        (run,) = compare(inputs, "localization", [name], "known")
        assert run.failure is None
        if run.total_nis is not None:  # fixed-lag has no cost of the whole run
            assert run.total_nis[1] == int(inputs.measured().sum())
            nis, dof = nis + run.total_nis[0], dof + run.total_nis[1]
        path = run.trajectory(run.phases[-1])
        nees.append(consistency.nees(path.pose, path.covariance, log.truth.pose, "pose").mean())
    assert abs(nis - dof) <= 4.0 * np.sqrt(2.0 * dof)
    assert np.mean(nees) < 6.0


def test_landmarks_of_ranges_begin_where_all_of_them_meet():
    log = drive(0, (RADIO,))
    number = log.truth.landmark_of - 12
    first = np.where(np.isin(np.arange(len(number)), [number.tolist().index(n) for n in (0, 1)]), number, -1)
    start = _chordal(replace(log.recorded, map=None), first, number)
    assert np.abs(start.landmark - log.recorded.map.xy[12:]).max() < 0.6
    fronts = [step_by_step("ekf", inputs := log.inputs(labels=True).without_map(), "slam")]
    fronts.append(replace(fronts[0], map=replace(fronts[0].map, xy=fronts[0].map.xy + 5.0)))
    fronts.append(replace(fronts[0], final_decisions=np.append(fronts[0].final_decisions[:-1], -2)))
    notes = [[n.code.value for n in batch("batch", inputs, front).notes] for front in fronts]
    assert notes == [["decided-by", *more] for more in ([], ["began-astray"], ["observations-unused"])]


@pytest.mark.parametrize(("name", "method"), [("ekf", "nn"), ("ekf", "jcbb"), slow("ekf", "gnn"), ("isam2", "jcbb")])
def test_landmarks_of_another_kind_are_no_candidates(name, method):
    log = drive(2, ALL)
    run = step_by_step(name, log.inputs().without_labels(), "localization", method)
    assert run.failure is None
    which = log.recorded.observations.sensor
    paired = run.decisions >= 0
    assert (run.decisions[paired & ((which == 0) | (which == 2))] < 12).all()
    assert (run.decisions[paired & (which == 3)] >= 12).all()
    assert (run.decisions == log.truth.landmark_of)[which != 1].mean() > 0.9


def test_slam_of_sensors_that_locate_landmarks_uses_the_others_too():
    log = drive(3, (LIDAR, CAMERA, TAGS))
    ekf, batch = compare(log.inputs(labels=True), "slam", ["ekf", "batch"], "known")
    assert ((ekf.decisions >= 0) & (log.recorded.observations.sensor == 1)).sum() > 50
    assert np.abs(batch.final.pose - log.truth.pose)[:, :2].max() < 1.0


def test_slam_without_labels_of_bearings_alone_is_refused():
    run = compare(drive(4, (CAMERA,)).inputs(), "slam", ["ekf"], "jcbb")[0]
    assert run.failure is not None
    assert "does not locate a new landmark" in run.failure.text


@pytest.mark.parametrize(("name", "sensors"), [
    ("ekf-fej", (CAMERA,)), ("isam2", (RADIO,)), ("batch", (CAMERA, RADIO)), slow("ekf-invariant", (CAMERA,)),
    slow("ekf-invariant", (RADIO,)), slow("isam2", (CAMERA, RADIO)), slow("ekf-fej", (CAMERA, RADIO)),
])  # fmt: skip
def test_slam_begins_landmarks_once_their_observations_locate_them(sensors, name):
    """All observations of a landmark are used, also those before it began; the path is consistent."""
    log = drive(1, sensors, frames=100)
    inputs = log.inputs(labels=True)
    (run,) = compare(inputs, "slam", [name], "known")
    assert run.failure is None
    assert len(run.map) == len(np.unique(log.truth.landmark_of))
    used = (run.final_decisions >= 0) | (run.created >= 0)
    assert used.mean() > 0.95
    numbers = [set(log.truth.landmark_of[(run.final_decisions == n) | (run.created == n)]) for n in run.map.number]
    assert all(len(each) == 1 for each in numbers)
    if run.total_nis is not None:
        nis, dof = run.total_nis
        assert dof == int(inputs.measured()[used].sum()) - 2 * len(run.map)
        assert abs(nis - dof) < 4.0 * np.sqrt(2.0 * dof)
    assert confusion_of(run, log, run.phases[-1]).fp == 0
    path = run.trajectory(run.phases[-1])
    off = pose_error(path.pose[-1], log.truth.pose[-1])
    assert off @ np.linalg.solve(path.covariance[-1], off) < 16.3


@pytest.mark.slow
@pytest.mark.parametrize("sensors", [(CAMERA,), (RADIO,), (CAMERA, RADIO)], ids=["bearings", "ranges", "both"])
@pytest.mark.parametrize("name", ["ekf-fej", "ekf-invariant"])
def test_delayed_initialization_is_consistent(sensors, name):
    """The mean NEES of the last pose over 100 runs is inside the 99 % interval, unlike the plain EKF's: 6.1 with
    bearings (Huang, Mourikis and Roumeliotis, IJRR 2010).
    """
    squared = []
    for seed in range(100):
        log = drive(seed, sensors, frames=100)
        (run,) = compare(log.inputs(labels=True), "slam", [name], "known")
        off = pose_error(run.online.pose[-1], log.truth.pose[-1])
        squared.append(off @ np.linalg.solve(run.online.covariance[-1], off))
    low, high = chi2.ppf([0.005, 0.995], 300) / 100
    assert low < np.mean(squared) < high


OFF_CENTRE: dict[str, tuple[Sensor, ...]] = {
    "bearings": (Bearing(rotation=0.1, translation=(0.4, -0.3), label="camera"),),
    "ranges": (Range(translation=(0.4, -0.3), label="radio"),),
    "both kinds": (LIDAR, Bearing(rotation=0.1, translation=(0.4, -0.3), label="camera")),
}
"""Sensors with a lever arm, whose factors are evaluated in Python."""


def mislabelled(log: Log, share: float) -> tuple[Inputs, np.ndarray]:
    """Inputs with labels, and which of them (M,) name another landmark of the same kind."""
    inputs = log.inputs(labels=True)
    o = inputs.observations
    wrong = (np.random.default_rng(0).random(len(o.label)) < share) & (o.label < 12)
    return replace(inputs, observations=replace(o, label=np.where(wrong, (o.label + 5) % 12, o.label))), wrong


@pytest.mark.parametrize("task", ["localization", slow("slam")])
@pytest.mark.parametrize("name", ["bearings", *map(slow, [*OFF_CENTRE][1:])])
def test_gnc_finds_wrong_labels_of_sensors_with_a_lever_arm(task, name):
    inputs, wrong = mislabelled(drive(3, OFF_CENTRE[name], frames=40), 0.08)
    inputs = inputs if task == "localization" else inputs.without_map()
    (run,) = compare(inputs, task, ("gnc",), "known")
    assert run.failure is None
    left = run.final_decisions < 0
    assert wrong.sum() > 15
    assert (wrong & ~left).sum() <= 2
    if name == "bearings":
        c = chi2.ppf(0.99, 1)
        assert run.gated_final[0] == pytest.approx(chi2.cdf(c, 3) / chi2.cdf(c, 1))
    if task == "localization":
        assert (left & ~wrong).mean() < 0.03
    else:  # those that wait for their landmark's beginning are no pairings
        assert ((run.decisions >= 0) & left & ~wrong).mean() < 0.05
