"""Map server files: read back as map_server and nav2_map_server define them, they give the grid's cells again."""

import numpy as np
import pytest

from wings.laser.report import write_map
from wings.laser.scans.occupancy import Grid


def loaded(folder):
    """Cells (H, W) with row 0 in the south, -1 unknown, 0 free, 100 occupied; resolution and origin. As the loader: p =
    (255 - pixel) / 255, occupied above occupied_thresh, free below free_thresh.
    """
    said = dict(line.split(": ", 1) for line in (folder / "map.yaml").read_text().splitlines())
    magic, size, most, body = (folder / said["image"]).read_bytes().split(b"\n", 3)
    assert (magic, most, said["negate"], said["mode"]) == (b"P5", b"255", "0", "trinary")
    width, height = map(int, size.split())
    p = (255 - np.frombuffer(body, np.uint8).reshape(height, width)[::-1].astype(float)) / 255.0
    cells = np.full(p.shape, -1)
    cells[p > float(said["occupied_thresh"])] = 100
    cells[p < float(said["free_thresh"])] = 0
    origin = [float(v) for v in said["origin"].strip("[]").split(",")]
    return cells, float(said["resolution"]), origin


@pytest.fixture
def grid():
    p = np.array([[0.9, 0.5, 0.1], [0.5, 0.64, 0.1], [0.66, 0.36, 0.34], [0.5, 0.5, 0.97]])
    return Grid(np.array([-3.2, 1.15]), 0.05, np.log(p / (1.0 - p)))


def test_cells_are_read_back_as_they_were(grid, tmp_path):
    write_map(grid, tmp_path)
    cells, resolution, origin = loaded(tmp_path)
    assert cells.tolist() == [[100, -1, 0], [-1, -1, 0], [100, -1, 0], [-1, -1, 100]]
    assert (resolution, origin) == (0.05, [-3.2, 1.15, 0.0])


def test_same_grid_same_bytes_and_these_pixels(grid, tmp_path):
    first = [p.read_bytes() for p in write_map(grid, tmp_path / "a")]
    assert first == [p.read_bytes() for p in write_map(grid, tmp_path / "b")]
    # north comes first; 254 free, 0 occupied, 205 unknown
    assert first[0] == b"P5\n3 4\n255\n" + bytes([205, 205, 0, 0, 205, 254, 205, 205, 254, 0, 205, 254])
    assert b"occupied_thresh: 0.65\nfree_thresh: 0.196\n" in first[1]
