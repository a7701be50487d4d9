"""What a stereo camera makes of exact depths: points with noise that grows with the square of the depth, and holes.

A disparity d = f b / z is read with an error of sigma_d px, which neighbouring pixels share in part, and is rounded;
z = f b / d then has a standard deviation of z^2 sigma_d / (f b), and x and y err along the ray.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from data.se2 import Array
from data.visual.rendering.textures import Image
from data.worlds.gallery_parameters import Gallery

WINDOW = 11
"""px, side of the square over which texture is judged."""
HOLE_SIZE = (4.0, 30.0)
"""px, half axes of a random hole."""


def stereo_points(
    g: Gallery,
    depth: NDArray[np.float32],
    rgb: Image,
    outlines: Sequence[Array],
    noise: np.random.Generator,
    holes: np.random.Generator,
) -> NDArray[np.float32]:
    """Points (H, W, 3) m in the camera's frame, NaN where stereo finds none.

    Args:
        g: its camera and stereo parameters.
        depth: (H, W) m, exact.
        rgb: (H, W, 3), the image whose texture is matched.
        outlines: of the pictures, (4, 2) pixels each.
        noise: draws the errors of disparities.
        holes: draws the random holes.
    """
    disparity = np.float32(g.focal * g.baseline) / depth
    if g.disparity_noise > 0:
        disparity += np.float32(g.disparity_noise) * smeared_noise(depth.shape, g.smear, noise)
    if g.disparity_step > 0:
        step = np.float32(g.disparity_step)
        disparity = step * np.rint(disparity / step)
    lost = _lost(g, rgb, outlines, holes) | (disparity <= 0)
    disparity[lost] = np.nan
    h, w = depth.shape
    xyz = np.empty((h, w, 3), np.float32)
    z = np.float32(g.focal * g.baseline) / disparity
    across = (np.arange(w, dtype=np.float32) - np.float32(0.5 * (w - 1))) / np.float32(g.focal)
    down = (np.arange(h, dtype=np.float32) - np.float32(0.5 * (h - 1))) / np.float32(g.focal)
    xyz[:, :, 0] = across * z
    xyz[:, :, 1] = down[:, None] * z
    xyz[:, :, 2] = z
    return xyz


def smeared_noise(shape: tuple[int, ...], smear: float, rng: np.random.Generator) -> NDArray[np.float32]:
    """Normal noise (H, W) of variance 1 everywhere; white, smoothed by a Gaussian of `smear` px (0: left white)."""
    reach = int(np.ceil(3.0 * smear))
    white = rng.standard_normal((shape[0] + 2 * reach, shape[1] + 2 * reach), dtype=np.float32)
    if reach == 0:
        return white
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / smear) ** 2)
    kernel /= np.linalg.norm(kernel)  # a sum of independent values keeps the variance
    smooth = cv2.sepFilter2D(white, cv2.CV_32F, kernel, kernel)
    # the rim mixes values twice: it was drawn to be cut off
    return np.asarray(smooth[reach:-reach, reach:-reach], np.float32)


def _lost(g: Gallery, rgb: Image, outlines: Sequence[Array], rng: np.random.Generator) -> NDArray[np.bool_]:
    """Pixels (H, W) without depth: random patches, borders between surfaces, and surfaces without texture."""
    h, w = rgb.shape[:2]
    lost = np.zeros((h, w), np.uint8)
    for _ in range(g.patches):
        middle = rng.uniform(0.0, 1.0, 2) * np.array([w, h])
        axes, angle = rng.uniform(*HOLE_SIZE, 2), rng.uniform(0.0, 180.0)
        cv2.ellipse(lost, (int(middle[0]), int(middle[1])), (int(axes[0]), int(axes[1])), angle, 0.0, 360.0, 1, -1)
    if g.edge_hole > 0:
        for corners in outlines:
            cv2.polylines(lost, [np.rint(corners).astype(np.int32)], True, 1, 2 * g.edge_hole)
    if g.least_texture > 0:
        grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
        slope = cv2.absdiff(grey[:, 1:], grey[:, :-1])
        mean = cv2.boxFilter(slope, cv2.CV_32F, (WINDOW, WINDOW))
        lost[:, 1:] |= (mean < g.least_texture).astype(np.uint8)
    return lost.astype(bool)
