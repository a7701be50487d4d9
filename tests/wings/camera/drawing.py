"""Corners of the pictures drawn with known noise, without images."""

import numpy as np

from data.log import Log
from data.se2 import Array
from wings.camera.calibration import Sightings
from wings.camera.gallery import Gallery, gallery, in_view, simulate


def true_camera(g: Gallery) -> Array:
    """K (3,) of the rendered camera."""
    return np.array([g.focal, 0.5 * (g.image_width - 1), 0.5 * (g.image_height - 1)])


USUAL, HALF = Gallery(), Gallery(duration=30.0, rate=3.0)
"""The rendered world, and half its loop in 90 frames."""


def drawn(seed: int, sigma: float = 0.3, g: Gallery = USUAL) -> tuple[Log, Array, Sightings]:
    """A log without images, the pictures' corners in the plan, and their pixels with noise."""
    scene, rng = gallery(g, seed), np.random.default_rng([seed, 1])
    rows = [(k, s.picture, s.pixels) for k, pose in enumerate(scene.pose) for s in in_view(g, scene.corners, pose)]
    pixels = np.array([row[2] for row in rows])
    frame, picture = (np.array([row[i] for row in rows], np.int64) for i in (0, 1))
    noisy = pixels + sigma * rng.standard_normal(pixels.shape)
    return simulate(g, seed), scene.setup.corners, Sightings(frame, picture, noisy, sigma)
