"""Every compiled kernel used once, on small worlds: each task, sensor, estimator and association method."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from association.decide import METHODS
from association.geometry.local_map import Scan
from association.geometry.pair_poses import candidates
from association.geometry.relocalize import relocalize
from association.scans.correlation import best_pose, pyramid
from association.scans.laser_run import SCAN
from association.scans.occupancy import occupancy_grid
from data.log import Log
from data.open_log.reader import load_folder
from data.open_log.writer import write_folder
from data.worlds.arena import Arena, simulate
from data.worlds.registry import named_log
from eval.replay.estimators import make_estimator
from eval.replay.names import BATCH, ESTIMATORS, TASKS
from eval.replay.run import compare, step_by_step
from eval.replay.settings import Setup

SENSORS = ("range_bearing", "relative_point")


def _small(sensor: str) -> Log:
    """A small arena, by way of a folder, since arrays that were read differ in layout from simulated ones."""
    log = simulate(Arena(frames=12, landmarks=6, sensor=sensor), 0, name="warm")
    with tempfile.TemporaryDirectory() as folder:
        write_folder(log, Path(folder) / "warm")
        return load_folder(Path(folder) / "warm")


def _estimators(sensor: str, task: str) -> None:
    inputs = _small(sensor).inputs(labels=True)
    for setup in (Setup(), Setup(gate_known=0.9999)):
        compare(inputs, task, ESTIMATORS, setup=setup)


def _methods(sensor: str, task: str) -> None:
    inputs = _small(sensor).inputs(labels=True)
    view = inputs if task == "localization" else inputs.without_map()
    for method in METHODS:
        compare(view, task, ("ekf",), method)
    step_by_step("ekf", view, task)
    for name in ("ekf", "isam2"):
        estimator = make_estimator(name, view)
        estimator.update(view.sightings(0), np.full(len(view.sightings(0).z), -2))
        expectation = estimator.expect(view.sightings(0))
        expectation.joint(np.arange(len(expectation.number)))
        candidates(expectation, view.sensor, np.eye(3))


def _place() -> None:
    place = _small(SENSORS[0]).recorded.map
    assert place is not None
    n = len(place.id)
    relocalize(Scan(place.xy, 1e-4 * np.eye(2 * n), tuple((i,) for i in range(n))), place)


def _laser() -> None:
    """Every back end on a short drive with loop closures, corners as landmarks, and the grid."""
    inputs = named_log("floorplan:0:frames=600").recorded
    compare(inputs, "slam", ("dead-reckoning", "ekf", "isam2", "fixed-lag", *BATCH), SCAN)
    compare(inputs, "slam", ("ekf",), "jcbb")
    # a search that a short drive does not need
    corner = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    best_pose(corner, pyramid(corner, 2.0), np.zeros(3), np.array([0.2, 0.2, 0.1]), 0.4)
    assert inputs.scans is not None
    occupancy_grid(np.zeros((1, 3)), inputs.scans.ranges[:1], inputs.scans.scanner)


PARTS: dict[str, Callable[[], None]] = {
    **{
        f"{what}, {task}, {sensor.replace('_', ' ')}": partial(part, sensor, task)
        for sensor in SENSORS
        for task in TASKS
        for what, part in (("estimators", _estimators), ("association", _methods))
    },
    "place recognition": _place,
    "laser": _laser,
}
"""What is compiled, in order."""
