"""Detection of surveyed pictures in a frame: SIFT, homography, corners, and checks of the detection."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

import cv2
import numpy as np
from threadpoolctl import ThreadpoolController

from data.errors import DataError
from data.pictures import CORNERS, Detection, VisualFrame
from data.se2 import Array
from wings.camera.checks import OUTSIDE, Points, corner_points, overlap, pinhole, shape_fault, size_fault
from wings.camera.features import (
    FINE_SHARE,
    Features,
    Image,
    Indices,
    corner_sigma,
    extract,
    first_homography,
    guided_match,
    join,
    match,
    project,
    refine,
    squeezed_view,
)

NOT_SEEN = "not seen"
FEW_INLIERS = "too few inliers"
UNCERTAIN = "uncertain corners"
SAME_PLACE = "same place as a better one"

REFERENCE_SIDE = 480  # px, longer side of scaled references: about their size in a frame
REFERENCE_FEATURES = (500, 300)  # strongest features of the frontal view and of the squeezed one
SCENE_FEATURES = 1500
MIN_REFERENCE_FEATURES = 40  # fewest features of the frontal view
MIN_MATCHES = 8  # fewer matches are chance
GUIDED_PASSES = 2
MIN_INLIERS = 16  # after guided matching: four times the minimum of a homography
MIN_INLIER_SHARE = 0.25  # share of a picture's unguided matches that agree with the final homography
THRESHOLD = 3.0  # px, upper bound of the matches' noise for MAGSAC++
MAX_CORNER_SIGMA = 2.0  # px, largest standard deviation of the worst corner
MAX_OVERLAP = 0.1  # largest overlap of two pictures in the image, as a share of the smaller
AT_ONCE = 2  # frames processed together: OpenCV's own threads leave half of two cores idle; results are bit-identical


@dataclass(frozen=True, eq=False)
class Detected:
    """Detections in a frame, by picture, and (picture, reason) of each other picture."""

    detections: list[Detection]
    refused: list[tuple[int, str]]


class Detector:
    """Detects the pictures of a set of reference images.

    Args:
        references: RGB images (h, w, 3) uint8, each exactly one picture.
        widths: (L,) m, as surveyed; None if unknown, then sizes are not checked.

    Raises:
        DataError: no reference image, one with too few features, or a wrong number of widths.
    """

    def __init__(self, references: list[Image], widths: Array | None = None) -> None:
        if not references:
            raise DataError("no reference images; at least one is needed")
        if widths is not None and np.shape(widths) != (len(references),):
            raise DataError(f"{np.size(widths)} widths for {len(references)} reference images")
        self.widths = widths
        self._pools = ThreadpoolController()
        self.aspects: list[float] = []
        self.corners: list[Array] = []
        self.features: list[Features] = []
        for number, reference in enumerate(references, start=1):
            _require_rgb(reference, f"reference image {number}")
            small = shrunk(reference, REFERENCE_SIDE)
            frontal = extract(small, REFERENCE_FEATURES[0], fine_share=FINE_SHARE)
            if len(frontal) < MIN_REFERENCE_FEATURES:
                what = f"reference image {number} of {len(references)}: {len(frontal)} features, at least "
                raise DataError(f"{what}{MIN_REFERENCE_FEATURES} are needed; use a picture with more texture")
            h, w = small.shape[:2]
            # outer edge of the outer pixels
            self.corners.append(np.array([[0, 0], [w, 0], [w, h], [0, h]], float) - 0.5)
            self.aspects.append(reference.shape[0] / reference.shape[1])
            self.features.append(join(frontal, squeezed_view(small, REFERENCE_FEATURES[1])))

    def detect(self, rgb: Image, xyz: Points | None = None) -> Detected:
        """Pictures wholly visible in a frame (H, W, 3) uint8; DataError for images of wrong type or size.

        `xyz` (H, W, 3) m are stereo points, NaN (or z <= 0) where there is none; without, corners get NaN points.
        """
        _require_rgb(rgb, "frame")
        if xyz is not None and xyz.shape != rgb.shape:
            raise DataError(f"stereo points {xyz.shape} do not fit the image {rgb.shape}")
        # one thread of linear algebra, for reproducible bits, and no threads that compete with OpenCV's
        with self._pools.limit(limits=1, user_api="blas"):
            return self._detect(rgb, xyz)

    def detect_each(
        self, frames: Iterable[VisualFrame], at_once: int = AT_ONCE
    ) -> Iterator[tuple[VisualFrame, Detected]]:
        """Each frame and its detections, in order, `at_once` frames at a time."""
        waiting = deque[tuple[VisualFrame, Future[Detected]]]()
        with self._pools.limit(limits=1, user_api="blas"), ThreadPoolExecutor(at_once) as pool:
            for frame in frames:
                waiting.append((frame, pool.submit(self.detect, frame.rgb, frame.xyz)))
                if len(waiting) > at_once:
                    first, found = waiting.popleft()
                    yield first, found.result()
            for first, found in waiting:
                yield first, found.result()

    def _detect(self, rgb: Image, xyz: Points | None) -> Detected:
        scene = extract(rgb, SCENE_FEATURES)
        camera = None if xyz is None else pinhole(xyz)
        outcomes = [self._find(k, scene, pairs, rgb.shape[:2]) for k, pairs in enumerate(match(scene, self.features))]
        if xyz is not None:
            outcomes = [o if isinstance(o, str) else self._locate(o, xyz, camera) for o in outcomes]
        found = [o for o in outcomes if isinstance(o, Detection)]
        refused = [(picture, o) for picture, o in enumerate(outcomes) if isinstance(o, str)]
        kept: list[Detection] = []
        for one in sorted(found, key=lambda d: (-d.inliers, d.picture)):
            if any(overlap(one.pixels, other.pixels) > MAX_OVERLAP for other in kept):
                refused.append((one.picture, SAME_PLACE))
            else:
                kept.append(one)
        return Detected(sorted(kept, key=lambda d: d.picture), sorted(refused))

    def _find(
        self, picture: int, scene: Features, pairs: tuple[Indices, Indices], size: tuple[int, int]
    ) -> Detection | str:
        """The picture in the image from its matches, or the reason for rejection."""
        if len(pairs[0]) < MIN_MATCHES:
            return NOT_SEEN
        reference = self.features[picture]
        H = first_homography(reference.place[pairs[0]], scene.place[pairs[1]], THRESHOLD)
        if H is None:
            return FEW_INLIERS
        try:
            for _ in range(GUIDED_PASSES):
                # a collapsed homography cannot guide
                fault = shape_fault(project(H, self.corners[picture]), size, self.aspects[picture])
                if fault is not None and fault != OUTSIDE:
                    return fault
                guided = guided_match(H, reference, scene)
                fit = refine(H, reference.take(guided[0]), scene.take(guided[1]))
                H = fit.H
        except np.linalg.LinAlgError:
            return FEW_INLIERS
        pixels = project(H, self.corners[picture])
        fault = shape_fault(pixels, size, self.aspects[picture])
        if fault is not None:
            return fault
        inliers = int(fit.inlier.sum())
        gap = np.linalg.norm(project(H, reference.place[pairs[0]]) - scene.place[pairs[1]], axis=1)
        if inliers < MIN_INLIERS or np.mean(gap < 2 * THRESHOLD) < MIN_INLIER_SHARE:
            return FEW_INLIERS
        worst = float(corner_sigma(fit, self.corners[picture], pixels).max())
        if worst > MAX_CORNER_SIGMA:
            return UNCERTAIN
        agreeing = reference.place[guided[0]][fit.inlier], scene.place[guided[1]][fit.inlier]
        off = np.linalg.norm(project(H, agreeing[0]) - agreeing[1], axis=1)
        rms = float(np.sqrt(np.mean(off**2)))
        return Detection(picture, pixels, np.full((CORNERS, 3), np.nan), inliers, rms, worst)

    def _locate(self, detection: Detection, xyz: Points, camera: Array | None) -> Detection | str:
        """The detection with its corners in the camera's frame, or the reason why stereo contradicts it."""
        points = corner_points(detection.pixels, xyz, camera)
        if isinstance(points, str):
            return points
        if self.widths is not None:
            fault = size_fault(points, float(self.widths[detection.picture]), self.aspects[detection.picture])
            if fault is not None:
                return fault
        return replace(detection, points=points)


def shrunk(image: Image, side: int) -> Image:
    """The image with its longer side at most so many px."""
    scale = side / max(image.shape[:2])
    if scale >= 1.0:
        return image
    size = (max(1, round(image.shape[1] * scale)), max(1, round(image.shape[0] * scale)))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def _require_rgb(image: Image, name: str) -> None:
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3 or 0 in image.shape:
        raise DataError(f"{name}: {image.dtype} array {image.shape}; an RGB image is uint8 (height, width, 3)")
