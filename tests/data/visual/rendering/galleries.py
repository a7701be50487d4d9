"""Galleries with and without noise, and views of their pictures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from data.visual.rendering.render import Rendered
from data.worlds.gallery import Gallery

DEFAULT = Gallery()
CLEAN = replace(
    DEFAULT, brightness=0.0, contrast=0.0, exposure=0.0, image_noise=0.0,
    disparity_noise=0.0, disparity_step=0.0, patches=0, edge_hole=0, least_texture=0.0,
)  # fmt: skip
SMALL = replace(DEFAULT, image_width=320, image_height=240, reference_width=120, duration=8.0)
SMALL_CLEAN = replace(CLEAN, image_width=320, image_height=240, reference_width=120)


def views(recording: Rendered, each: int = 3) -> list[tuple[int, int]]:
    """Frames and pictures in view: of every picture the first and the last frame that show it and some between."""
    shown: dict[int, list[int]] = {}
    for k in range(len(recording)):
        for number in recording.visible(k):
            shown.setdefault(number, []).append(k)
    assert len(shown) == 8
    return [(f[i], n) for n, f in shown.items() for i in np.linspace(0, len(f) - 1, each).astype(int)]
