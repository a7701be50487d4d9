"""`python -m eval.warm`: compile every kernel once, into the cache, so that no first run has to wait for it."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

PROG = "python -m eval.warm"


def main(argv: Sequence[str] | None = None, prog: str = PROG) -> int:
    """Compile everything; returns the exit status."""
    argparse.ArgumentParser(
        prog=prog, description="Compile every kernel once, into the cache, so that no first run has to wait for it."
    ).parse_args(argv)
    warm()
    return 0


def warm() -> None:
    """Every estimator on a small arena; one pass in each task, with each sensor, from memory and from a folder."""
    import tempfile
    from pathlib import Path

    import numpy as np

    from association.decide import METHODS
    from association.geometry.local_map import Scan
    from association.geometry.pair_poses import candidates
    from association.geometry.relocalize import relocalize
    from data.open_log.reader import load_folder
    from data.open_log.writer import write_folder
    from data.worlds.arena import Arena, simulate
    from eval.replay.estimators import make_estimator
    from eval.replay.names import ESTIMATORS
    from eval.replay.run import compare, step_by_step
    from eval.replay.settings import Setup

    for sensor in ("range_bearing", "relative_point"):
        log = simulate(Arena(frames=12, landmarks=6, sensor=sensor), 0, name="warm")
        with tempfile.TemporaryDirectory() as folder:
            write_folder(log, Path(folder) / "warm")
            log = load_folder(Path(folder) / "warm")
        inputs = log.inputs(labels=True)
        for task, view in (("localization", inputs), ("slam", inputs.without_map())):
            compare(inputs, task, ESTIMATORS, setup=Setup(gate_known=0.9999))
            for method in METHODS:
                compare(view, task, ("ekf",), method)
            step_by_step("ekf", view, task)
            for name in ("ekf", "isam2"):
                estimator = make_estimator(name, view)
                estimator.update(view.sightings(0), np.full(len(view.sightings(0).z), -2))
                expectation = estimator.expect(view.sightings(0))
                expectation.joint(np.arange(len(expectation.number)))
                candidates(expectation, view.sensor, np.eye(3))
        place = inputs.map
        if place is not None:
            n = len(place.id)
            relocalize(Scan(place.xy, 1e-4 * np.eye(2 * n), tuple((i,) for i in range(n))), place)
    _warm_laser()


def _warm_laser() -> None:
    """Every back end on a short drive with loop closures, corners as landmarks, and the grid."""
    import numpy as np

    from association.scans.correlation import best_pose, pyramid
    from association.scans.laser_run import SCAN
    from association.scans.occupancy import occupancy_grid
    from data.worlds.registry import named_log
    from eval.replay.names import BATCH
    from eval.replay.run import compare

    inputs = named_log("floorplan:0:frames=600").recorded
    compare(inputs, "slam", ("dead-reckoning", "ekf", "isam2", "fixed-lag", *BATCH), SCAN)
    compare(inputs, "slam", ("ekf",), "jcbb")
    # a search that a short drive does not need
    corner = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    best_pose(corner, pyramid(corner, 2.0), np.zeros(3), np.array([0.2, 0.2, 0.1]), 0.4)
    if inputs.scans is not None:
        occupancy_grid(np.zeros((1, 3)), inputs.scans.ranges[:1], inputs.scans.scanner)


if __name__ == "__main__":
    sys.exit(main())
