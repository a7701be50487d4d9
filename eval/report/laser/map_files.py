"""An occupancy grid as map servers read it: `map.pgm` (a picture) and `map.yaml` (where it lies, how it is meant).

Format: ROS map_server and nav2_map_server. A pixel v means occupied with (255 - v) / 255, against two thresholds; the
first row of the picture is the northernmost, and `origin` is the pose of its lower left corner.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from association.scans.occupancy import Grid

FREE_PIXEL, OCCUPIED_PIXEL, UNKNOWN_PIXEL = 254, 0, 205
"""As map_saver writes them."""
OCCUPIED_ABOVE, FREE_BELOW = 0.65, 0.35
"""Probabilities by which a cell is called occupied or free: map_saver's for the one, and as sure for the other, which
one beam more that crossed than ended here is not."""
YAML = """\
image: {image}
mode: trinary
resolution: {resolution!r}
origin: [{x!r}, {y!r}, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""


def pixels(grid: Grid) -> NDArray[np.uint8]:
    """The picture (H, W), north up."""
    p = grid.probability
    cells = np.full(p.shape, UNKNOWN_PIXEL, np.uint8)
    cells[p > OCCUPIED_ABOVE] = OCCUPIED_PIXEL
    cells[p < FREE_BELOW] = FREE_PIXEL
    return cells[::-1]


def write_map(grid: Grid, folder: Path, stem: str = "map") -> list[Path]:
    """Write `stem.pgm` and `stem.yaml`; same grid, same bytes."""
    picture, text = folder / f"{stem}.pgm", folder / f"{stem}.yaml"
    rows = pixels(grid)
    folder.mkdir(parents=True, exist_ok=True)
    picture.write_bytes(f"P5\n{rows.shape[1]} {rows.shape[0]}\n255\n".encode("ascii") + rows.tobytes())
    x, y = (float(each) for each in grid.origin)
    text.write_text(YAML.format(image=picture.name, resolution=float(grid.resolution), x=x, y=y), encoding="utf-8")
    return [picture, text]
