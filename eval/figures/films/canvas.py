"""Where a film's metres fall on pixels, and what is drawn there with OpenCV, for speed."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from data.inputs import IntArray
from data.se2 import Array
from eval.figures.films.webm import Image
from eval.figures.view import View

LONGER_SIDE = 960
"""px of the picture's longer side; the scene decides the shorter one."""
SHORTER_SIDE = 480
SHIFT = 4
"""Bits of a pixel that OpenCV draws with."""

Colour = tuple[int, int, int]

WHITE, BLACK, GREY, PALE = (255, 255, 255), (0, 0, 0), (120, 120, 120), (205, 205, 205)


def bgr(colour: str) -> Colour:
    """`#rrggbb` in OpenCV's order."""
    return int(colour[5:7], 16), int(colour[3:5], 16), int(colour[1:3], 16)


@dataclass(frozen=True)
class Canvas:
    """Where metres fall on pixels: x to the right, y up, one scale for both."""

    low: Array
    scale: float
    width: int
    height: int

    def pixels(self, xy: Array) -> IntArray:
        """World points (..., 2) m as fixed-point pixels with `SHIFT` fractional bits, kept within drawing range."""
        x = (xy[..., 0] - self.low[0]) * self.scale
        y = self.height - (xy[..., 1] - self.low[1]) * self.scale
        fixed = np.clip(np.stack([x, y], axis=-1), -20000.0, 20000.0) * (1 << SHIFT)
        return np.asarray(np.round(fixed), np.int32)

    def line(self, image: Image, points: Array, colour: Colour, thickness: int = 1, closed: bool = False) -> None:
        """Lines through points (k, 2) m."""
        cv2.polylines(image, [self.pixels(points)], closed, colour, thickness, cv2.LINE_AA, SHIFT)

    def area(self, image: Image, points: Array, colour: Colour) -> None:
        """A filled polygon (k, 2) m."""
        cv2.fillPoly(image, [self.pixels(points)], colour, cv2.LINE_AA, SHIFT)

    def dot(self, image: Image, point: Array, radius: float, colour: Colour) -> None:
        """A filled circle of `radius` px."""
        x, y = self.pixels(point).tolist()
        cv2.circle(image, (x, y), round(radius * (1 << SHIFT)), colour, -1, cv2.LINE_AA, SHIFT)


def canvas_of(view: View) -> Canvas:
    """A canvas of even size that holds the view."""
    w, h = (max(float(s), 1e-3) for s in view.size)
    scale = min(LONGER_SIDE / max(w, h), 4000.0)
    width, height = (max(SHORTER_SIDE, 2 * round(scale * side / 2)) for side in (w, h))
    middle = 0.5 * (view.low + view.high)
    return Canvas(middle - 0.5 * np.array([width, height]) / scale, scale, width, height)


def blend(colour: Colour, share: float) -> Colour:
    """A colour of which only this share is left, the rest white."""
    b, g, r = (round(255 - share * (255 - part)) for part in colour)
    return b, g, r


def write(image: Image, text: str, at: tuple[int, int], colour: Colour = BLACK, size: float = 0.5) -> None:
    """A line of text, its lower left corner `at` px."""
    cv2.putText(image, text, at, cv2.FONT_HERSHEY_SIMPLEX, size, colour, 1, cv2.LINE_AA)


def scale_bar(image: Image, canvas: Canvas) -> None:
    """How long a metre is, in the lower right corner."""
    wanted = 0.18 * canvas.width / canvas.scale
    power = 10.0 ** np.floor(np.log10(wanted))
    length = max(f * power for f in (1.0, 2.0, 5.0) if f * power <= wanted)
    right, base = canvas.width - 24, canvas.height - 20
    left = right - round(length * canvas.scale)
    cv2.line(image, (left, base), (right, base), BLACK, 2)
    for x in (left, right):
        cv2.line(image, (x, base - 5), (x, base + 5), BLACK, 1)
    write(image, f"{length:g} m", (left, base - 10), size=0.45)
