"""Speed of rendering, and of picture detection in frames of 640 x 480."""

import statistics
import time

from eval.benchmarks.speed import Timed
from wings.camera.detector import Detector
from wings.camera.gallery import Gallery
from wings.camera.rendering.render import Rendered


def visual_lines(quick: bool) -> list[Timed]:
    """Lines of the table about images."""
    recording = Rendered(Gallery(), 0, frames=6 if quick else 30)
    begin = time.perf_counter()
    frames = list(recording.frames())
    rendered = (time.perf_counter() - begin) / len(frames)
    detector = Detector(recording.references, recording.setup.width)
    detector.detect(frames[0].rgb, frames[0].xyz)
    taken = []
    for _ in range(1 if quick else 3):
        begin = time.perf_counter()
        found = sum(len(seen.detections) for _, seen in detector.detect_each(frames))
        taken.append((time.perf_counter() - begin) / len(frames))
    h, w = frames[0].rgb.shape[:2]
    each = found / len(frames)
    what = f"pictures found in a frame of {w} x {h}, {len(recording.references)} references ({each:.1f} found)"
    return [
        Timed(what, statistics.median(taken), 1, "frames", "", ">= 10 frames/s"),
        Timed("a frame rendered with its stereo points", rendered, 1, "frames"),
    ]
