"""Constants of delayed initialization, halved and doubled: what they do to consistency, accuracy and the map.

    python -m tests.research.delayed SEEDS [--estimator ekf-fej]

Worlds: a circle among trees observed by bearings alone, and by ranges alone (those of
`tests.eval.replay.test_several_sensors`). Printed by constant: NEES of the last pose, RMSE, landmarks begun and their
RMSE, failed runs.
"""

from __future__ import annotations

import sys
from typing import NamedTuple
from unittest.mock import patch

import numpy as np

from association import triangulate
from data.command import Parser
from data.se2 import Array, wrap_angle
from data.sensors import Range
from eval.replay import frontend
from eval.replay.run import compare
from tests.eval.replay.test_several_sensors import CAMERA, drive

FRAMES = 100
WORLDS = {"bearings": CAMERA, "ranges": Range(label="radio")}
AS_THEY_ARE = "as they are"
VARIED: dict[str, tuple[object, str, float]] = {
    AS_THEY_ARE: (frontend, "MOST", frontend.MOST),
    "MOST 8": (frontend, "MOST", 8),
    "MOST 32": (frontend, "MOST", 32),
    "SECOND_ORDER 0.125": (triangulate, "SECOND_ORDER", 0.125),
    "SECOND_ORDER 0.5": (triangulate, "SECOND_ORDER", 0.5),
    "RIVAL, odds 32": (triangulate, "RIVAL", 0.5 * triangulate.RIVAL),
    "RIVAL, odds 10^6": (triangulate, "RIVAL", 2.0 * triangulate.RIVAL),
    "GATE 0.998": (triangulate, "GATE", 0.998),
    "GATE 0.9995": (triangulate, "GATE", 0.9995),
}


class Row(NamedTuple):
    """One run: NEES of the last pose (3 expected), squared position error [m^2] over frames, landmarks begun and there
    were, squared landmark errors [m^2] summed.
    """

    nees: float
    squared: float
    begun: int
    seen: int
    landmark: float


def row(estimator: str, world: str, seed: int) -> Row | None:
    """A run, or None if it failed."""
    log = drive(seed, (WORLDS[world],), frames=FRAMES)
    (run,) = compare(log.inputs(labels=True), "slam", [estimator], "known")
    if run.failure is not None or run.online is None or run.map is None:
        return None
    truth, of = log.truth.pose, log.truth.landmark_of
    off: Array = run.online.pose - truth
    off[:, 2] = wrap_angle(off[:, 2])
    nees = float(off[-1] @ np.linalg.solve(run.online.covariance[-1], off[-1]))
    names = [int(of[np.flatnonzero(run.created == n)[0]]) for n in run.map.number.tolist()]
    away = run.map.xy - log.truth.landmarks.positions(np.array(names, np.int64))
    squared = float(np.mean(np.sum(off[:, :2] ** 2, axis=1)))
    return Row(nees, squared, len(names), len(np.unique(of)), float(np.sum(away**2)))


def main() -> None:
    """Print a line of a Markdown table for each world and constant."""
    parser = Parser(prog="python -m tests.research.delayed", description="Constants of delayed initialization.")
    parser.add_argument("seeds", type=int)
    parser.add_argument("--estimator", default="ekf-fej")
    asked = parser.parse_args()
    for world in WORLDS:
        for name, (where, constant, value) in VARIED.items():
            with patch.object(where, constant, value):
                found = [row(asked.estimator, world, seed) for seed in range(asked.seeds)]
            rows = [r for r in found if r is not None]
            nees, squared, begun, seen, landmark = np.array(rows).T
            cells = [
                world, name, f"{nees.mean():.2f} ± {nees.std(ddof=1) / np.sqrt(len(rows)):.2f}",
                f"{np.sqrt(squared.mean()):.3f}", f"{begun.sum():.0f} of {seen.sum():.0f}",
                f"{np.sqrt(landmark.sum() / begun.sum()):.3f}", f"{len(found) - len(rows)}",
            ]  # fmt: skip
            sys.stdout.write("| " + " | ".join(cells) + " |\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
