"""The kernels of laser logs, compiled by a short drive."""

import numpy as np

from association.names import SCAN
from data.worlds.registry import named_log
from eval.compare import compare
from eval.replay.settings import BATCH
from wings.laser.scans.corners import corners
from wings.laser.scans.matching import best_pose, pyramid
from wings.laser.scans.occupancy import occupancy_grid


def warm() -> None:
    """Every back end on a short drive with loop closures, the grid, and corners."""
    inputs = named_log("floorplan:0:frames=600").recorded
    compare(inputs, "slam", ("ekf", "isam2", "fixed-lag", *BATCH), SCAN)
    corner = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])  # a search that a short drive does not reach
    best_pose(corner, pyramid(corner, 2.0), np.zeros(3), np.array([0.2, 0.2, 0.1]), 0.4)
    assert inputs.scans is not None
    occupancy_grid(np.zeros((1, 3)), inputs.scans.ranges[:1], inputs.scans.scanner)
    corners(inputs.scans.ranges[0], inputs.scans.scanner)
    few = named_log("floorplan:0:frames=60").recorded
    compare(few, "slam", ("dead-reckoning",), SCAN)
    compare(few, "slam", ("ekf",), "jcbb")
