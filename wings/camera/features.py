"""Features of pictures and frames, their matches, and the homography of the matches.

Descriptors are RootSIFT (Arandjelovic and Zisserman, CVPR 2012) rounded to whole numbers. Their dot products are below
2^24, exact in float32, so matching is bit-identical for any number of threads.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from data.se2 import Array, BoolArray

Image = NDArray[np.uint8]
Descriptors = NDArray[np.float32]
Indices = NDArray[np.intp]

UNIT = 512  # length of a descriptor: 2 (UNIT^2 - a·b) is the squared distance of two
CONTRAST = 0.02  # SIFT's threshold, half of OpenCV's default, for dim or blurred frames
FINE_SHARE = 0.5  # largest share of the finest octave (scale below about 1.6 px), which vanishes at a distance
SQUEEZE = 2.0
"""Squeeze of the width in a reference's second view: SIFT fails beyond about 45 degrees (ASIFT, Morel and Yu 2009)."""
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

    def take(self, index: Indices) -> Features:
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
    rank_fine = np.cumsum(fine[order])
    order = order[~fine[order] | (rank_fine <= fine_share * limit)][:limit]
    return Features(place[order], scale[order], root_sift(descriptor[order]))


def join(first: Features, second: Features) -> Features:
    """All features of both."""
    place, scale = np.concatenate([first.place, second.place]), np.concatenate([first.scale, second.scale])
    return Features(place, scale, np.concatenate([first.descriptor, second.descriptor]))


def squeezed_view(rgb: Image, limit: int) -> Features:
    """Features of an oblique view: the width is squeezed by `SQUEEZE`; places are those of the picture itself."""
    h, w = rgb.shape[:2]
    width = max(1, round(w / SQUEEZE))
    narrow = np.asarray(cv2.resize(rgb, (width, h), interpolation=cv2.INTER_AREA), np.uint8)
    view = extract(narrow, limit, fine_share=FINE_SHARE)
    place = view.place.copy()
    place[:, 0] = (place[:, 0] + 0.5) * (w / width) - 0.5
    # the blob covers w / width times the area
    return Features(place, view.scale * np.sqrt(w / width), view.descriptor)


def root_sift(descriptor: Any) -> Descriptors:
    """RootSIFT of SIFT descriptors (n, 128), rounded to whole numbers at length `UNIT`."""
    total = descriptor.sum(axis=1, keepdims=True, dtype=np.float64)
    return np.asarray(np.rint(UNIT * np.sqrt(descriptor / np.maximum(total, 1.0))), np.float32)


def match(scene: Features, references: list[Features]) -> list[tuple[Indices, Indices]]:
    """Pairs (feature of the picture, feature of the scene) per picture, each feature in at most one pair.

    A scene's feature is paired with its nearest among all pictures if it passes the ratio test against the second
    nearest, and is in turn the nearest of that feature (mutual).
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
    place, stretch = project(H, reference.place), magnification(H, reference.place)
    low, high = place.min(axis=0) - GUIDED_RADIUS, place.max(axis=0) + GUIDED_RADIUS
    near = np.flatnonzero(np.all((scene.place >= low) & (scene.place <= high), axis=1))
    i, j = np.nonzero(
        (np.abs(place[:, :1] - scene.place[near, 0]) < GUIDED_RADIUS)
        & (np.abs(place[:, 1:] - scene.place[near, 1]) < GUIDED_RADIUS)
    )
    ratio = scene.scale[near[j]] / (stretch * reference.scale)[i]
    close = (
        (np.linalg.norm(place[i] - scene.place[near[j]], axis=1) < GUIDED_RADIUS) & (ratio > 0.6) & (ratio < 1 / 0.6)
    )
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
    """Weighted least squares over paired features (Gauss-Newton), with noise by their scales.

    Pairs beyond `GATE` standard deviations are dropped (and may return); the covariance is scaled by the residuals,
    never below the assumed noise. np.linalg.LinAlgError where the pairs do not fix a homography.
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
