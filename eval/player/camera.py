"""The camera's images in a log's chunk, and the corners found in them."""

from __future__ import annotations

import base64
from typing import Any

import cv2
import numpy as np

from data.log import Log
from eval.player.pack import Pack

FINE = 0.25
"""px of the recorded image."""


def add_camera(pack: Pack, log: Log) -> dict[str, Any] | None:
    """Detections as arrays, one row each: frame, picture and corners (u, v) px; what the header says, None: no images.

    Images are small ones of some or all frames; `width` is that of the recorded image, to which the corners belong.
    """
    if log.evidence is None or not log.evidence.found.small:
        return None
    found, frames = log.evidence.found, len(log.recorded)
    kept = found.frame < frames
    pack.add("camera_frame", found.frame[kept])
    pack.add("camera_picture", found.picture[kept])
    pack.add("camera_corners", found.pixels[kept].reshape(int(np.sum(kept)), -1), FINE)
    whole = cv2.imdecode(np.frombuffer(found.tiles[0][1], np.uint8), cv2.IMREAD_GRAYSCALE)
    assert whole is not None
    images = [(k, base64.b64encode(image).decode()) for k, image in found.small if k < frames]
    return {
        "width": whole.shape[1], "frames": [k for k, _ in images], "images": [image for _, image in images],
    }  # fmt: skip
