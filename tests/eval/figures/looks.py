"""How figures look: colours as colour-blind readers see them, boxes on the paper, and a figure as it is saved."""

from pathlib import Path

import numpy as np
from matplotlib.colors import to_rgb

from eval.figures.map import map_figure
from eval.figures.style import save
from tests.eval.handmade import circle_log, run_with_error

# Machado, Oliveira, Fernandes 2009, severity 1.0, on linear RGB
SEEN_BY = {
    "all cones": np.eye(3),
    "no red cones": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "no green cones": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "no blue cones": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}


def lab(colour, seen):
    rgb = np.array(to_rgb(colour))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    linear = np.clip(seen @ linear, 0.0, 1.0)
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    t = to_xyz @ linear / np.array([0.9505, 1.0, 1.089])
    f = np.where(t > (6 / 29) ** 3, np.cbrt(t), t / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def within(box, paper) -> bool:
    return bool(np.all(box.min >= paper.min - 1.0) and np.all(box.max <= paper.max + 1.0))


def pictures(folder: Path) -> dict[str, bytes]:
    runs = [run_with_error(np.array([0.1, 0.0, 0.02])), run_with_error(np.zeros(3), estimator="batch")]
    written = save(map_figure(circle_log(), runs), folder, "map")
    return {p.name: p.read_bytes() for p in written}
