"""Camera images with detections: outlines, corners and names of pictures."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from data.se2 import Array

YELLOW, BLACK = (240, 228, 66), (0, 0, 0)
"""Okabe and Ito's yellow; with its black edge it stands out from light and dark images, in colour and in grey."""
LEAST_WIDTH = 640  # px; smaller images are enlarged
SUBPIXEL = 4  # fractional bits of OpenCV's drawing coordinates


def outlined(rgb: NDArray[np.uint8], found: Sequence[tuple[str, Array]], bold: int = 1) -> NDArray[np.uint8]:
    """An RGB image (H, W, 3), enlarged if small, with each picture's name and corners (4, 2) px, upper left first.
    `bold`: factor of the size of lines and names, of an image that will be shown smaller.
    """
    times = max(1, -(-LEAST_WIDTH // rgb.shape[1]))
    size = (rgb.shape[1] * times, rgb.shape[0] * times)
    image = np.array(rgb if times == 1 else cv2.resize(rgb, size, interpolation=cv2.INTER_CUBIC), np.uint8)
    thick = bold * max(1, round(max(size) / 640))
    for name, corners in found:
        places = np.round(((corners + 0.5) * times - 0.5) * 2**SUBPIXEL).astype(np.int32)
        for colour, width in ((BLACK, 3 * thick), (YELLOW, thick)):
            cv2.polylines(image, [places[:, None]], True, colour, width, cv2.LINE_AA, SUBPIXEL)
            radius = (2 * thick + width // 2) << SUBPIXEL
            for u, v in places.tolist():
                cv2.circle(image, (u, v), radius, colour, cv2.FILLED, cv2.LINE_AA, SUBPIXEL)
        _name(image, name, corners[0] * times, thick)
    return image


def png_of(rgb: NDArray[np.uint8]) -> bytes:
    """An RGB image (H, W, 3) as PNG."""
    ok, data = cv2.imencode(".png", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))
    assert ok
    return bytes(data.tobytes())


def _name(image: NDArray[np.uint8], name: str, corner: Array, thick: int) -> None:
    """A name in a yellow box above a corner, or below it where the image ends."""
    scale = 0.45 * thick
    (wide, high), below = cv2.getTextSize(name, cv2.FONT_HERSHEY_SIMPLEX, scale, thick)
    pad = 2 * thick
    x = int(np.clip(corner[0], 0, max(image.shape[1] - wide - 2 * pad, 0)))
    top = int(corner[1]) - high - below - 3 * pad
    top = int(corner[1]) + 2 * pad if top < 0 else top
    box = (x, top), (x + wide + 2 * pad, top + high + below + pad)
    cv2.rectangle(image, *box, YELLOW, cv2.FILLED)
    cv2.rectangle(image, *box, BLACK, thick)
    at = (x + pad, top + high + pad)
    cv2.putText(image, name, at, cv2.FONT_HERSHEY_SIMPLEX, scale, BLACK, thick, cv2.LINE_AA)
