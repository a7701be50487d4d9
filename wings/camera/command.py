"""`slamref camera LOG`: the camera's calibration from the pictures' pixels, estimated in one graph with the path."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from data.errors import DataError, UsageError
from data.terminal import counted, ended
from eval.plan.flags import command_of

if TYPE_CHECKING:
    from data.log import Log
    from data.se2 import Array
    from wings.camera.calibration import Belief, CameraEstimate

PROG = "slamref camera"
SIZES = (0.5, 0.05)
"""Standard deviations of the prior over the image's size: of the focal length, which is about the width, and of the
centre, which is about the middle."""


def main(argv: Sequence[str] | None = None, prog: str = PROG) -> int:
    """The command `prog`; returns its exit status."""
    parser = command_of(prog, PROG, "camera")
    return ended(lambda: print(_camera(**vars(parser.read(argv)))))


def _camera(log: str, pixel_sigma: float, camera_translation: str, camera_reading: str, *, trust_pickle: bool) -> str:
    """The lines about the estimate; ± is 3σ."""
    import io

    import numpy as np
    from PIL import Image

    from data.logs import Reading, open_scored
    from eval.referee.errors import position_distance, rms
    from wings.camera.calibration import Belief
    from wings.camera.opening import parse_name

    reading = Reading(camera_translation, camera_reading, trust_pickle=trust_pickle)
    opened = open_scored(log, reading, lambda text: print(text, file=sys.stderr))
    if opened.evidence is None:
        raise UsageError(f"log {opened.name!r} has no images; visual:SEED and folders of the visual lab have")
    found = opened.evidence.found
    if not len(found.frame):
        raise DataError(f"log {opened.name!r}: no picture was found in any image, so nothing tells the camera's K")
    with Image.open(io.BytesIO(found.tiles[0][1])) as image:  # the prior of K is from the size of the images alone
        width, height = image.size
    share, middle = SIZES
    mean = np.array([width, 0.5 * (width - 1), 0.5 * (height - 1)])
    before = Belief(mean, np.array([share * width, middle * width, middle * height]))
    made, truth = _estimate(opened, before, pixel_sigma), None
    if log.startswith("visual:"):
        g, _, _ = parse_name(log)
        truth = np.array([g.focal, 0.5 * (g.image_width - 1), 0.5 * (g.image_height - 1)])
    spread: Array = 3.0 * np.sqrt(np.diag(made.covariance))
    lines = [f"{opened.name}: {counted(len(found.frame), 'picture')} in {counted(len(found.time), 'frame')}, ± is 3σ"]
    for i, name in enumerate(("focal length", "centre u", "centre v")):
        prior = f"prior {before.mean[i]:.1f} ± {3.0 * before.sigma[i]:.0f}"
        true = "" if truth is None else f", rendered with {truth[i]:.2f}"
        lines.append(f"{name:<13}{made.mean[i]:8.2f} ± {spread[i]:.2f} px ({prior}{true})")
    if np.isfinite(found.focal):
        lines.append(f"the stereo points imply a focal length of {found.focal:.2f} px")
    lines.append(f"residuals: RMS {made.residual:.2f} of the stated σ")
    if truth is not None:
        e = made.mean - truth
        lines.append(f"NEES of K: {float(e @ np.linalg.solve(made.covariance, e)):.2f} (expected 3)")
    if opened.truth.pose is not None:
        error = rms(position_distance(made.pose, opened.truth.pose))
        lines.append(f"position RMSE of the path in the same graph: {error:.4f} m")
    return "\n".join(lines)


def _estimate(log: Log, before: Belief, sigma: float) -> CameraEstimate:
    """K and path of a log made from images; the search starts at the filter's path."""
    from eval.replay.run import compare
    from graph.factors import UnderConstrained
    from wings.camera.calibration import Sightings, estimate_camera

    assert log.evidence is not None
    found, inputs = log.evidence.found, log.inputs(labels=True)
    (ekf,) = compare(inputs, "localization", ("ekf",), "known")
    if ekf.online is None or ekf.failure is not None:
        raise DataError(f"log {log.name!r}: the filter that gives the first path failed")
    seen = Sightings(found.frame, found.picture, found.pixels, sigma)
    try:
        return estimate_camera(inputs, log.evidence.setup.corners, seen, before, ekf.online.pose)
    except UnderConstrained as error:
        raise DataError(f"log {log.name!r}: {error}") from None
