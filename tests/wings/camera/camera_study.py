"""Normalized error of the estimated camera matrix over many runs: corners drawn with known noise, or found in images.

    python -m tests.wings.camera.camera_study RUNS                 drawn, with noise of 0.3 px
    python -m tests.wings.camera.camera_study RUNS --frames 24     found in that many rendered frames of each run

The prior of K is drawn about the truth, 80 px off in the focal length and 20 px in the centre.
"""

from __future__ import annotations

import sys
from typing import NamedTuple

import numpy as np

from data.command import Parser
from data.log import Log
from data.logs import open_log
from data.se2 import Array, pose_error
from eval.replay.run import compare
from wings.camera.calibration import Belief, CameraEstimate, Sightings, estimate_camera
from wings.camera.gallery import Gallery, gallery, in_view, simulate

PRIOR = np.array([80.0, 20.0, 20.0])
"""px, standard deviations of f, c_u and c_v."""
RATE = 0.75
"""Hz of the rendered frames: a few of them see most of the loop."""
DRAWN = 0.3
"""px, noise of a drawn corner."""
STATED = (0.08, 0.2)
"""px, noise that is stated of found corners: as measured in a frame, and what holds for the whole."""


class Row(NamedTuple):
    """One run: error (3,) of K [px] and its standard deviations (3,), NEES of K, mean pose NEES, position RMSE [m]."""

    sigma: float
    error: Array
    stated: Array
    nees: float
    pose: float
    rmse: float


def true_camera(g: Gallery) -> Array:
    """K (3,) of the rendered camera."""
    return np.array([g.focal, 0.5 * (g.image_width - 1), 0.5 * (g.image_height - 1)])


USUAL, HALF = Gallery(), Gallery(duration=30.0, rate=3.0)
"""The rendered world, and the one that is drawn: half the loop in 90 frames."""


def drawn(seed: int, sigma: float = DRAWN, g: Gallery = USUAL) -> tuple[Log, Array, Sightings]:
    """A log without images, the pictures' corners in the plan, and their pixels with noise."""
    scene, rng = gallery(g, seed), np.random.default_rng([seed, 1])
    rows = [(k, s.picture, s.pixels) for k, pose in enumerate(scene.pose) for s in in_view(g, scene.corners, pose)]
    pixels = np.array([row[2] for row in rows])
    frame, picture = (np.array([row[i] for row in rows], np.int64) for i in (0, 1))
    noisy = pixels + sigma * rng.standard_normal(pixels.shape)
    return simulate(g, seed), scene.setup.corners, Sightings(frame, picture, noisy, sigma)


def found(seed: int, frames: int, sigma: float) -> tuple[Log, Array, Sightings]:
    """A rendered log and what was found in its images."""
    log = open_log(f"visual:{seed}:rate={RATE}+frames={frames}")
    assert log.evidence is not None
    f = log.evidence.found
    return log, log.evidence.setup.corners, Sightings(f.frame, f.picture, f.pixels, sigma)


def estimated(log: Log, corners: Array, seen: Sightings, truth: Array, rng: np.random.Generator) -> CameraEstimate:
    """The estimate from a prior drawn about the truth, started at the filter's path."""
    inputs = log.inputs(labels=True)
    (ekf,) = compare(inputs, "localization", ("ekf",), "known")
    before = Belief(truth + PRIOR * rng.standard_normal(3), PRIOR)
    return estimate_camera(inputs, corners, seen, before, ekf.trajectory("online").pose)


def row(log: Log, seen: Sightings, truth: Array, made: CameraEstimate) -> Row:
    """What the estimate is worth."""
    assert log.truth.pose is not None
    e, off = made.mean - truth, pose_error(made.pose, log.truth.pose)
    pose = [float(d @ np.linalg.solve(P, d)) for d, P in zip(off, made.pose_covariance, strict=True)]
    rmse = float(np.sqrt(np.mean(np.sum(off[:, :2] ** 2, axis=1))))
    nees = float(e @ np.linalg.solve(made.covariance, e))
    return Row(seen.sigma, e, np.sqrt(np.diag(made.covariance)), nees, float(np.mean(pose)), rmse)


def rows_of(seed: int, frames: int | None) -> list[Row]:
    """The rows of one run, one for each stated noise."""
    truth, made = true_camera(USUAL), []
    given = [drawn(seed, DRAWN, HALF)] if frames is None else [found(seed, frames, STATED[0])]
    log, corners, seen = given[0]
    for sigma in (seen.sigma,) if frames is None else STATED:
        stated = seen._replace(sigma=sigma)
        made.append(row(log, stated, truth, estimated(log, corners, stated, truth, np.random.default_rng([seed, 2]))))
    return made


def main() -> None:
    """Print a line per run, and means with their standard errors."""
    parser = Parser(prog="python -m tests.wings.camera.camera_study", description="NEES of K over many runs.")
    parser.add_argument("runs", type=int)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--frames", type=int)
    asked = parser.parse_args()
    kept: dict[float, list[Row]] = {}
    for seed in range(asked.first, asked.first + asked.runs):
        for r in rows_of(seed, asked.frames):
            kept.setdefault(r.sigma, []).append(r)
            numbers = [*r.error, *r.stated, r.nees, r.pose, 1000.0 * r.rmse]
            sys.stdout.write(f"{seed} {r.sigma} " + " ".join(f"{v:.4f}" for v in numbers) + "\n")
            sys.stdout.flush()
    for sigma, rows in kept.items():
        nees = np.array([r.nees for r in rows])
        off = np.sqrt(np.mean([r.error**2 for r in rows], axis=0))
        sys.stdout.write(
            f"{sigma} px, {len(rows)} runs: NEES of K {nees.mean():.2f} +- {nees.std() / np.sqrt(len(rows)):.2f} "
            f"(median {np.median(nees):.2f}), RMSE {off.round(3).tolist()} px, "
            f"pose NEES {np.mean([r.pose for r in rows]):.2f}\n"
        )


if __name__ == "__main__":
    main()
