"""Detection of surveyed pictures in a frame: SIFT, homography, corners, checks of the detection, and outlines.

A detection is checked by its quadrilateral's shape in the image and by its corners in the stereo points. Each check
returns the reason for rejection, or None. Pixels are (u right, v down), centres at whole numbers; points are in the
camera's frame (x right, y down, z ahead), m.

Descriptors are RootSIFT (Arandjelovic and Zisserman, CVPR 2012) rounded to whole numbers. Their dot products are below
2^24, exact in float32, so matching is bit-identical for any number of threads.
"""

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from data.errors import DataError
from data.pictures import CORNERS, Detection, VisualFrame
from data.se2 import Array, BoolArray

Image = NDArray[np.uint8]
Descriptors = NDArray[np.float32]
Indices = NDArray[np.intp]

UNIT = 512  # length of a descriptor: 2 (UNIT^2 - a·b) is the squared distance of two
CONTRAST = 0.02  # SIFT's threshold, half of OpenCV's default, for dim or blurred frames
FINE_SHARE = 0.5  # largest share of the finest octave (scale below about 1.6 px), which vanishes at a distance
SQUEEZE = 2.0  # Of the width in a reference's second view: SIFT fails beyond some 45 degrees (ASIFT, Morel and Yu 2009)
RATIO = 0.85  # Lowe's ratio test against the second nearest of all pictures (IJCV 2004, section 7.1 takes 0.8)
SAME_SPOT = 5.0  # px in the reference; nearer features are of one spot
GUIDED_RADIUS = 4.0  # px, largest distance of a guided match from its predicted place
GUIDED_DISTANCE = 0.75  # largest distance of unit descriptors in a guided match; unrelated ones are around 1
SCALE_NOISE = 0.1  # Localization noise of a feature, as a share of its scale, and its floor [px]
NOISE_FLOOR = 0.25
GATE = 3.5  # standard deviations within which a feature agrees with the homography


@dataclass(frozen=True, eq=False)
class Features:
    """SIFT features: place (n, 2) px, scale (n,) px (standard deviation of the blob), descriptor (n, 128)."""

    place: Array
    scale: Array
    descriptor: Descriptors

    def __len__(self) -> int:
        return len(self.place)

    def take(self, index: Indices) -> "Features":
        """The features at some indices."""
        return Features(self.place[index], self.scale[index], self.descriptor[index])


def extract(rgb: Image, limit: int, *, fine_share: float = 1.0) -> Features:
    """The `limit` strongest features of an image (H, W, 3), the finest octave limited to `fine_share`."""
    # without precise upscaling the doubled image is shifted by a quarter of a pixel
    sift = cv2.SIFT.create(nfeatures=0, contrastThreshold=CONTRAST, enable_precise_upscale=True)
    points, descriptor = sift.detectAndCompute(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), np.empty(0, np.uint8))
    if not points:
        return Features(np.empty((0, 2)), np.empty(0), np.empty((0, 128), np.float32))
    place = np.array([p.pt for p in points])
    scale = np.array([p.size for p in points]) / 2.0
    response = np.array([p.response for p in points])
    fine = np.array([p.octave & 255 for p in points]) == 255  # octave -1
    order = np.lexsort((place[:, 1], place[:, 0], -response))
    order = order[~fine[order] | (np.cumsum(fine[order]) <= fine_share * limit)][:limit]
    descriptor = descriptor[order]  # RootSIFT, rounded to whole numbers at length `UNIT`
    total = np.maximum(descriptor.sum(axis=1, keepdims=True, dtype=np.float64), 1.0)
    return Features(place[order], scale[order], np.rint(UNIT * np.sqrt(descriptor / total)).astype(np.float32))


def squeezed_view(rgb: Image, limit: int) -> Features:
    """Features of an oblique view: the width is squeezed by `SQUEEZE`; places are those of the picture itself."""
    h, w = rgb.shape[:2]
    width = max(1, round(w / SQUEEZE))
    narrow = np.asarray(cv2.resize(rgb, (width, h), interpolation=cv2.INTER_AREA), np.uint8)
    view = extract(narrow, limit, fine_share=FINE_SHARE)
    place = view.place.copy()
    place[:, 0] = (place[:, 0] + 0.5) * (w / width) - 0.5
    return Features(place, view.scale * np.sqrt(w / width), view.descriptor)  # the blob covers w / width times the area


def match(scene: Features, references: list[Features]) -> list[tuple[Indices, Indices]]:
    """Pairs (feature of the picture, feature of the scene) per picture, one to one: the nearest among all pictures by
    the ratio test against the second nearest, and mutual.
    """
    n = len(scene)
    if n == 0:
        return [(np.empty(0, np.intp), np.empty(0, np.intp)) for _ in references]
    best, index = np.full((len(references), n), -1.0), np.zeros((len(references), n), np.intp)
    rows = np.arange(n)
    room = np.empty((n, max(len(reference) for reference in references)), np.float32)
    for p, reference in enumerate(references):
        similar = np.matmul(scene.descriptor, reference.descriptor.T, out=room[:, : len(reference)])
        index[p] = similar.argmax(axis=1)
        best[p] = similar[rows, index[p]]
    winner = best.argmax(axis=0)
    nearest = best[winner, rows]
    best[winner, rows] = -1.0
    passed = _distinct(nearest, best.max(axis=0))
    pairs = []
    for p, reference in enumerate(references):
        candidate = np.flatnonzero(passed & (winner == p))
        chosen = index[p][candidate]
        similar = scene.descriptor[candidate] @ reference.descriptor.T
        # the same spot at another scale or in another view is no competitor
        gap = np.abs(reference.place[chosen][:, None] - reference.place)
        similar[(gap[..., 0] < SAME_SPOT) & (gap[..., 1] < SAME_SPOT)] = -1.0
        good = _distinct(nearest[candidate], similar.max(axis=1))
        candidate, chosen = candidate[good], chosen[good]
        mutual = (scene.descriptor @ reference.descriptor[chosen].T).argmax(axis=0) == candidate
        pairs.append((chosen[mutual], candidate[mutual]))
    return pairs


def _distinct(nearest: Array, second: NDArray[Any]) -> BoolArray:
    """The ratio test, on dot products."""
    return np.asarray(UNIT**2 - nearest < RATIO**2 * (UNIT**2 - second.astype(np.float64)))


def guided_match(H: Array, reference: Features, scene: Features) -> tuple[Indices, Indices]:
    """Pairs (picture, scene) of features near their place by `H`, of similar scale and descriptor; mutual nearest."""
    at, stretch = project(H, reference.place), magnification(H, reference.place)
    low, high = at.min(axis=0) - GUIDED_RADIUS, at.max(axis=0) + GUIDED_RADIUS
    near = np.flatnonzero(np.all((scene.place >= low) & (scene.place <= high), axis=1))
    off_x, off_y = (np.abs(at[:, k : k + 1] - scene.place[near, k]) for k in (0, 1))
    i, j = np.nonzero((off_x < GUIDED_RADIUS) & (off_y < GUIDED_RADIUS))
    ratio = scene.scale[near[j]] / (stretch * reference.scale)[i]
    close = (np.linalg.norm(at[i] - scene.place[near[j]], axis=1) < GUIDED_RADIUS) & (ratio > 0.6) & (ratio < 1 / 0.6)
    i, j = i[close], j[close]
    if not len(i):
        return i, j
    similar = np.full((len(reference), len(near)), -1.0, np.float32)
    similar[i, j] = np.einsum("ij,ij->i", reference.descriptor[i], scene.descriptor[near[j]])
    choice = similar.argmax(axis=1)
    row = np.arange(len(reference))
    keep = similar[row, choice] > UNIT**2 * (1.0 - GUIDED_DISTANCE**2 / 2.0)
    keep &= similar.argmax(axis=0)[choice] == row
    return row[keep], near[choice[keep]]


def project(H: Array, points: Array) -> Array:
    """Points (n, 2) through a homography (3, 3)."""
    mapped = points @ H[:, :2].T + H[:, 2]
    return np.asarray(mapped[:, :2] / mapped[:, 2:])


def magnification(H: Array, points: Array) -> Array:
    """Growth of lengths at points (n, 2), the square root of the Jacobian's determinant |det H| / w^3."""
    return np.asarray(np.sqrt(np.abs(np.linalg.det(H) / (points @ H[2, :2] + H[2, 2]) ** 3)))


@dataclass(frozen=True, eq=False)
class Fit:
    """A homography of pairs: H (3, 3) from picture to scene with H[2, 2] = 1, inliers (n,), covariance (8, 8)."""

    H: Array
    inlier: BoolArray
    covariance: Array


def first_homography(source: Array, target: Array, threshold: float) -> Array | None:
    """MAGSAC++ (Barath et al., CVPR 2020) over pairs (n, 2), n >= 4, reproducible; None where it finds none."""
    H, _ = cv2.findHomography(source, target, cv2.USAC_MAGSAC, threshold, maxIters=2000, confidence=0.999)
    return None if H is None or abs(H[2, 2]) < 1e-12 else np.asarray(H / H[2, 2], float)


def refine(H: Array, source: Features, target: Features, rounds: int = 10) -> Fit:
    """Gauss-Newton over paired features, with noise by their scales; pairs beyond `GATE` sigmas are dropped (and may
    return), the covariance is scaled by the residuals, never below the noise. np.linalg.LinAlgError: no homography.
    """
    h = H.ravel()[:8] / H[2, 2]
    x, y = source.place.T
    zero, one = np.zeros_like(x), np.ones_like(x)
    for _ in range(rounds):
        H = np.append(h, 1.0).reshape(3, 3)
        stretch = magnification(H, source.place)
        sigma = np.maximum(SCALE_NOISE * np.hypot(target.scale, stretch * source.scale), NOISE_FLOOR)
        w = x * h[6] + y * h[7] + 1.0
        predicted = project(H, source.place)
        u, v = predicted.T
        gap = target.place - predicted
        inlier = np.einsum("ij,ij->i", gap, gap) < (GATE * sigma) ** 2
        rows_u = np.stack([x, y, one, zero, zero, zero, -u * x, -u * y], axis=1) / w[:, None]
        rows_v = np.stack([zero, zero, zero, x, y, one, -v * x, -v * y], axis=1) / w[:, None]
        weight = np.where(inlier, 1.0 / sigma, 0.0)[:, None]
        J = np.concatenate([rows_u * weight, rows_v * weight])
        r = np.concatenate([gap[:, :1] * weight, gap[:, 1:] * weight])[:, 0]
        size = np.linalg.norm(J, axis=0)
        if inlier.sum() < 4 or not np.all(size > 0):
            raise np.linalg.LinAlgError("too few features agree")
        Q, R = np.linalg.qr(J / size)
        step = np.linalg.solve(R, Q.T @ r) / size
        h = h + step
        if np.abs(step * size).max() < 1e-6 * np.sqrt(len(r)):
            break
    inverse = np.linalg.inv(R) / size[:, None]
    variance = max(1.0, float(r @ r) / max(2 * int(inlier.sum()) - 8, 1))
    return Fit(np.append(h, 1.0).reshape(3, 3), inlier, variance * inverse @ inverse.T)


def corner_sigma(fit: Fit, corners: Array, pixels: Array) -> Array:
    """Largest standard deviation (n,) px of projected points in any direction; corners, pixels (n, 2)."""
    out = np.empty(len(corners))
    for i, ((x, y), (u, v)) in enumerate(zip(corners, pixels, strict=True)):
        w = x * fit.H[2, 0] + y * fit.H[2, 1] + 1.0
        J = np.array([[x, y, 1, 0, 0, 0, -u * x, -u * y], [0, 0, 0, x, y, 1, -v * x, -v * y]]) / w
        out[i] = np.sqrt(np.linalg.eigvalsh(J @ fit.covariance @ J.T)[-1])
    return out


Points = NDArray[np.float32]

MIRRORED = "mirrored"
NOT_CONVEX = "not convex"
IMPLAUSIBLE_SHAPE = "implausible shape"
OUTSIDE = "outside the image"
NO_DEPTH = "no depth"
NOT_PLANAR = "not planar"
WRONG_SIZE = "wrong size"

MIN_SIDE = 16.0  # px, shortest side of a picture with usable corners
MAX_TAPER = 3.0  # ratio of opposite sides, of a picture much nearer than its size
MAX_SQUEEZE = 4.0  # ratio of foreshortened to other side: obliquity of about 75 degrees
MIN_ANGLE = 20.0  # degrees, of a corner in the image
MAX_SIZE_ERROR = 0.15  # relative error of sides and diagonals against the survey
MAX_OFF_PLANE = 0.06  # Relative error of depths against the fitted plane: three sigma of stereo at a few metres
MIN_VALID = 0.2  # share of the picture's pixels with depth
MIN_ON_PLANE = 0.6  # share of those on the plane
WINDOW = (2, 4, 7, 12)  # px, half widths of the window of depths at a corner, widened until enough points are valid
MAX_SAMPLES = 2000  # most points of the plane's fit


def shape_fault(pixels: Array, size: tuple[int, int], aspect: float) -> str | None:
    """The fault of corners (4, 2) in an image of `size` (height, width); `aspect` is the picture's height/width.

    All corners turn alike if and only if no line within the picture is mapped to infinity: the sign of each turn is
    that of det H w_i w_j w_k.
    """
    side = np.roll(pixels, -1, axis=0) - pixels
    turn = side[:, 0] * np.roll(side[:, 1], -1) - side[:, 1] * np.roll(side[:, 0], -1)
    if np.all(turn < 0):
        return MIRRORED
    if not np.all(turn > 0):
        return NOT_CONVEX
    length = np.linalg.norm(side, axis=1)
    sine = turn / (length * np.roll(length, -1))
    width, height = np.sqrt(length[0] * length[2]), np.sqrt(length[1] * length[3])
    squeeze = height / width / aspect
    taper = max(max(length[i], length[i + 2]) / min(length[i], length[i + 2]) for i in (0, 1))
    small = length.min() < MIN_SIDE or sine.min() < np.sin(np.radians(MIN_ANGLE))
    if small or taper > MAX_TAPER or not 1 / MAX_SQUEEZE < squeeze < MAX_SQUEEZE:
        return IMPLAUSIBLE_SHAPE
    # a pixel extends half a pixel beyond its centre
    return OUTSIDE if np.any(pixels < -0.5) or np.any(pixels > np.array([size[1], size[0]]) - 0.5) else None


def pinhole(xyz: Points, step: int = 8) -> Array | None:
    """The camera of points (H, W, 3), x/z = a u + b, y/z = a v + b by every `step`-th pixel: rows of a, b, or None."""
    sample = xyz[::step, ::step].astype(np.float64)
    v, u = np.mgrid[0 : xyz.shape[0] : step, 0 : xyz.shape[1] : step]
    valid = np.isfinite(sample).all(axis=2) & (sample[..., 2] > 0)
    if len(np.unique(u[valid])) < 3 or len(np.unique(v[valid])) < 3:
        return None
    x, y, z = sample[valid].T
    return np.array([np.polyfit(u[valid], x / z, 1), np.polyfit(v[valid], y / z, 1)])


def inside(pixels: Array, shape: tuple[int, int]) -> NDArray[np.intp]:
    """Pixels (n, 2) as (row, column) within a convex quadrilateral (4, 2)."""
    start = np.maximum(np.floor(pixels.min(axis=0)).astype(int), 0)
    stop = np.minimum(np.ceil(pixels.max(axis=0)).astype(int) + 1, (shape[1], shape[0]))
    mask = np.zeros((stop[1] - start[1], stop[0] - start[0]), np.uint8)
    cv2.fillConvexPoly(mask, np.rint((pixels - start) * 16).astype(np.int32), 1, shift=4)
    return np.asarray(np.argwhere(mask) + start[::-1])


def fit_plane(pixels: Array, depth: Array) -> Array:
    """1/z = a u + b v + c (3,) through pixels (n, 2) with depth (n,) m: linear, with nearly constant stereo noise.
    Least absolute deviations, then Tukey's biweight tolerate a third of wrong depths.
    """
    centre = pixels.mean(axis=0)
    A = np.column_stack([pixels - centre, np.ones(len(pixels))])
    inverse = 1.0 / depth
    plane = np.array([0.0, 0.0, np.median(inverse)])
    for round_ in range(15):
        r = inverse - A @ plane
        scale = max(1.4826 * float(np.median(np.abs(r))), 1e-9)
        if round_ < 10:
            weight = 1.0 / np.maximum(np.abs(r), 0.1 * scale)
        else:
            weight = np.maximum(1.0 - (r / (4.685 * scale)) ** 2, 0.0) ** 2
        weighted = A * weight[:, None]
        plane = np.linalg.lstsq(weighted.T @ A, weighted.T @ inverse, rcond=None)[0]
    return np.array([plane[0], plane[1], plane[2] - plane[:2] @ centre])


def corner_windows(pixels: Array, xyz: Points) -> tuple[Array, Array] | None:
    """Centre (4, 2) px and median depth (4,) m of a small window near each corner; None: too few points."""
    towards = pixels.mean(axis=0) - pixels
    distance = np.linalg.norm(towards, axis=1)
    centres, depths = np.empty((4, 2)), np.empty(4)
    for i in range(4):
        for half in WINDOW:
            centre = np.rint(pixels[i] + towards[i] / distance[i] * min(1.5 * half + 1.0, 0.4 * distance[i]))
            column, row = (int(c) for c in centre)
            z = xyz[max(row - half, 0) : row + half + 1, max(column - half, 0) : column + half + 1, 2]
            z = z[np.isfinite(z) & (z > 0)]
            if z.size >= (2 * WINDOW[0] + 1) ** 2 // 2:
                break
        else:
            return None
        centres[i], depths[i] = centre, np.median(z.astype(np.float64))
    return centres, depths


def corner_points(pixels: Array, xyz: Points, camera: Array | None) -> Array | str:
    """Corners (4, 3) m of the picture with corners (4, 2) px by a `pinhole`, or the reason for rejection.

    The corner's ray is intersected with the plane fitted to all valid points. The median depth at a corner
    (`corner_windows`) is several times noisier and, on an oblique picture, biased; it serves as a check that each
    corner has depth, on the plane.
    """
    windows = corner_windows(pixels, xyz)
    if camera is None or windows is None:
        return NO_DEPTH
    middle = pixels.mean(axis=0)
    rows = inside(middle + 0.95 * (pixels - middle), xyz.shape[:2])
    rows = rows[:: max(1, len(rows) // MAX_SAMPLES)]
    z = xyz[rows[:, 0], rows[:, 1], 2].astype(np.float64)
    valid = np.isfinite(z) & (z > 0)
    if valid.sum() < max(MIN_VALID * len(z), 20):
        return NO_DEPTH
    places, z = rows[valid][:, ::-1].astype(np.float64), z[valid]
    plane = fit_plane(places, z)
    near = np.abs((places @ plane[:2] + plane[2]) * z - 1.0) < MAX_OFF_PLANE
    centres, depths = windows
    off = np.abs((centres @ plane[:2] + plane[2]) * depths - 1.0)
    inverse = pixels @ plane[:2] + plane[2]
    if near.mean() < MIN_ON_PLANE or off.max() > MAX_OFF_PLANE or inverse.min() <= 0:
        return NOT_PLANAR
    return np.asarray(np.column_stack([camera[:, 0] * pixels + camera[:, 1], np.ones(len(pixels))]) / inverse[:, None])


def size_fault(points: Array, width: float, aspect: float) -> str | None:
    """Whether corners (4, 3) m are those of a rectangle of `width` m and height `aspect` x width."""
    side = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)
    diagonal = np.linalg.norm(points[2:] - points[:2], axis=1)
    height = aspect * width
    expected = np.array([width, height, width, height, np.hypot(width, height), np.hypot(width, height)])
    wrong = np.abs(np.concatenate([side, diagonal]) / expected - 1.0) > MAX_SIZE_ERROR
    return WRONG_SIZE if wrong.any() else None


def overlap(first: Array, second: Array) -> float:
    """Shared area of two convex quadrilaterals (4, 2), over the smaller one."""
    area, _ = cv2.intersectConvexConvex(first.astype(np.float32), second.astype(np.float32))
    smaller = min(cv2.contourArea(first.astype(np.float32)), cv2.contourArea(second.astype(np.float32)))
    return float(area / max(smaller, 1e-9))


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
    """Detects the pictures of reference images (h, w, 3), RGB, uint8, each exactly one picture, `widths` (L,) [m] as
    surveyed (None: unknown, not checked). DataError: no image, one with too few features, or a wrong number of widths.
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
            self.corners.append(np.array([[0, 0], [w, 0], [w, h], [0, h]], float) - 0.5)  # edge of the outer pixels
            self.aspects.append(reference.shape[0] / reference.shape[1])
            both = frontal, squeezed_view(small, REFERENCE_FEATURES[1])
            place, scale, descriptor = ([getattr(f, name) for f in both] for name in ("place", "scale", "descriptor"))
            self.features.append(Features(np.concatenate(place), np.concatenate(scale), np.concatenate(descriptor)))

    def detect(self, rgb: Image, xyz: Points | None = None) -> Detected:
        """Pictures wholly visible in a frame (H, W, 3) uint8; DataError for images of wrong type or size. `xyz` (H, W,
        3) m are stereo points, NaN (or z <= 0) where there is none; without, corners get NaN points.
        """
        _require_rgb(rgb, "frame")
        if xyz is not None and xyz.shape != rgb.shape:
            raise DataError(f"stereo points {xyz.shape} do not fit the image {rgb.shape}")
        # one thread of linear algebra, for reproducible bits, and no threads that compete with OpenCV's
        with self._pools.limit(limits=1, user_api="blas"):
            return self._detect(rgb, xyz)

    def detect_each(self, frames: Iterable[VisualFrame]) -> Iterator[tuple[VisualFrame, Detected]]:
        """Each frame and its detections, in order, `AT_ONCE` frames at a time."""
        waiting = deque[tuple[VisualFrame, Future[Detected]]]()
        with self._pools.limit(limits=1, user_api="blas"), ThreadPoolExecutor(AT_ONCE) as pool:
            for frame in frames:
                waiting.append((frame, pool.submit(self.detect, frame.rgb, frame.xyz)))
                if len(waiting) > AT_ONCE:
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
        rms = float(np.sqrt(np.mean(np.linalg.norm(project(H, agreeing[0]) - agreeing[1], axis=1) ** 2)))
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


def encoded(rgb: Any, quality: int | None = None) -> bytes:
    """An RGB image (H, W, 3) as PNG, or as JPEG of a quality in percent."""
    kind, how = (".png", []) if quality is None else (".jpg", [cv2.IMWRITE_JPEG_QUALITY, quality])
    ok, data = cv2.imencode(kind, cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), how)
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
    cv2.putText(image, name, (x + pad, top + high + pad), cv2.FONT_HERSHEY_SIMPLEX, scale, BLACK, thick, cv2.LINE_AA)
