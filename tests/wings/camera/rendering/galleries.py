"""Galleries with and without noise, and views of their pictures."""

from dataclasses import replace

import cv2
import numpy as np

from wings.camera.gallery import Gallery
from wings.camera.rendering.render import Rendered

DEFAULT = Gallery()
CLEAN = replace(
    DEFAULT, brightness=0.0, contrast=0.0, exposure=0.0, image_noise=0.0,
    disparity_noise=0.0, disparity_step=0.0, patches=0, edge_hole=0, least_texture=0.0,
)  # fmt: skip
SMALL = replace(DEFAULT, image_width=320, image_height=240, reference_width=120, duration=8.0)
SMALL_CLEAN = replace(CLEAN, image_width=320, image_height=240, reference_width=120)


def visible(recording, k):
    return [s.picture for s in recording.in_view(k)]


def true_pixels(recording, k):
    """Corners (4, 2) px in frame k of every picture wholly in front of the camera."""
    return {s.picture: s.pixels for s in recording.projections(k) if np.isfinite(s.pixels).all()}


def views(recording: Rendered, each: int = 3) -> list[tuple[int, int]]:
    """Frames and pictures in view: of every picture the first and the last frame that show it and some between."""
    shown: dict[int, list[int]] = {}
    for k in range(len(recording)):
        for number in visible(recording, k):
            shown.setdefault(number, []).append(k)
    assert len(shown) == 8
    return [(f[i], n) for n, f in shown.items() for i in np.linspace(0, len(f) - 1, each).astype(int)]


def averaged(recording: Rendered, frame: int, number: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A picture and what is about it, each pixel the mean of 64 places: this part of the image, the share of each pixel
    that the picture covers, and the picture's mean colour there (NaN where it covers nothing).
    """
    reference, pixels = recording.references[number], true_pixels(recording, frame)[number]
    h, w = reference.shape[:2]
    own = np.array([[-0.5, -0.5], [w - 0.5, -0.5], [w - 0.5, h - 0.5], [-0.5, h - 0.5]])
    H = cv2.getPerspectiveTransform(pixels.astype(np.float32), own.astype(np.float32))
    g = recording.gallery
    (left, top), (right, bottom) = pixels.min(axis=0).astype(int) - 4, pixels.max(axis=0).astype(int) + 5
    rows, columns = slice(max(top, 0), min(bottom, g.image_height)), slice(max(left, 0), min(right, g.image_width))
    image = recording.frame(frame).rgb[rows, columns].astype(float)
    v, u = np.mgrid[rows, columns]
    covered, colour = np.zeros(u.shape), np.zeros(image.shape)
    for i, j in np.ndindex(8, 8):
        at = np.stack([u + (i - 3.5) / 8, v + (j - 3.5) / 8, np.ones(u.shape)], axis=-1) @ H.T
        x, y = (np.rint(at[:, :, k] / at[:, :, 2]).astype(int) for k in (0, 1))
        inside = (x >= 0) & (x < w) & (y >= 0) & (y < h)
        covered += inside / 64
        colour[inside] += reference[y[inside], x[inside]] / 64
    with np.errstate(invalid="ignore"):
        return image, covered, colour / covered[:, :, None]


def ends(recording: Rendered) -> list[tuple[int, int]]:
    shown = [(k, number) for k in range(0, len(recording), 6) for number in visible(recording, k)]
    return [(end(k for k, n in shown if n == number), number) for number in {n for _, n in shown} for end in (min, max)]
