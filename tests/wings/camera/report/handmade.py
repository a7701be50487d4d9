"""Pictures on walls and detections of them, written out by hand."""

import cv2
import numpy as np

from data.pictures import Evidence, Found, InView, VisualSetup
from tests.eval.handmade import FRAMES, circle_log

# figures
CORNERS = np.array([
    [[-2.0, 6.0], [-1.0, 6.0], [-1.0, 6.0], [-2.0, 6.0]],
    [[6.0, 1.0], [6.0, 0.0], [6.0, 0.0], [6.0, 1.0]],
    [[1.0, -6.0], [0.0, -6.0], [0.0, -6.0], [1.0, -6.0]],
])  # fmt: skip


SQUARE = np.array([[10.0, 20.0], [40.0, 20.0], [40.0, 50.0], [10.0, 50.0]])
GREY = np.full((90, 120, 3), 90, np.uint8)


# statistics
def evidence(*, truth: bool = True) -> Evidence:
    """Pictures 0 and 1 in view in frames 0 to 3, side by side; what was found is written out below."""
    places = {0: SQUARE, 1: SQUARE + (60.0, 0.0)}
    rows = [  # frame, claimed picture, where
        (0, 0, places[0] + 0.3), (0, 1, places[1]),
        (1, 0, places[1]),  # lies on the other one
        (2, 0, places[0] + (0.0, 0.5)), (2, 1, places[1] + (0.0, 30.0)),  # off its place, at nothing
        (5, 0, places[0]),  # nothing in view by the truth
    ]  # fmt: skip
    frame, picture = np.array([r[0] for r in rows]), np.array([r[1] for r in rows])
    ok, image = cv2.imencode(".png", np.dstack([GREY[..., 0] * 0 + c for c in (30, 20, 200)]))
    assert ok
    found = Found(
        100.0 + 0.5 * np.arange(FRAMES), np.zeros(FRAMES), np.zeros(FRAMES), frame, picture,
        np.array([40, 60, 50, 41, 62, 90]), np.array([r[2] for r in rows]), np.zeros((len(rows), 4, 3)),
        ({"no depth": 1}, {}, {}), ((2, image.tobytes()), (3, image.tobytes())), focal=500.0,
        pixel_noise=0.7, depth_noise=0.004,
    )  # fmt: skip
    seen = InView(np.repeat(np.arange(4), 2), np.tile([0, 1], 4), np.tile(np.stack([places[0], places[1]]), (4, 1, 1)))
    prior = circle_log().recorded.prior
    return Evidence(VisualSetup(np.pi / 2, (0.0, 0.1), CORNERS, prior), found, seen if truth else None)
