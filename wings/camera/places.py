"""Place recognition by camera: closures between frames of a recording that see one place, and how sure each is.

Key frames are compared by bags of visual words (Sivic and Zisserman, ICCV 2003). The most similar ones of long enough
ago are verified by an essential matrix, and located: features of the earlier key frame are triangulated with the one
before it, whose distance the odometry tells, and the later one is resected from them. The camera is level, so poses
are in the plane.
"""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from scipy import optimize

from association.expectation import gate_threshold
from data.errors import DataError
from data.inputs import Increments, IntArray
from data.motion.velocity import compose_in_place
from data.pictures import VisualFrame, VisualSetup
from data.pose_measurements import Closures
from data.se2 import Array, compose, dead_reckoned, inverse, pose_error, rotation
from wings.camera.detector import Features, extract, match, pinhole

STEP = (0.1, 0.1)  # m and rad from key frame to key frame
FEATURES = 600  # of a key frame
WORDS = 500
TRAINING = 10_000  # most descriptors that the vocabulary is trained on
TRIED = 3  # most similar key frames that are verified
BASELINE = 0.12  # m, least one of triangulation: 30 px of disparity at 2 m
EPIPOLAR = 1.5  # px from the epipolar line
INLIERS = 20  # four times the minimum of an essential matrix
PIXEL = 1.0  # px, standard deviation of a feature
VIEW = 2.0  # m; a wrong candidate is anywhere within the path's box and so much around it
SURE = 0.99  # least likelihood of a closure
GATE, AGREE = 0.9999, 0.99  # of a closure against the odometry, and of two candidates
NEIGHBOURS = 6  # key frames before and after, whose candidates must agree with a closure


class Candidate(NamedTuple):
    """Two key frames that may see one place."""

    frame1: int
    frame2: int
    similarity: float  # cosine of their bags
    inliers: int  # of the essential matrix, or of the resection
    relative: Array  # pose (3,) of frame2 in frame1 [m, m, rad]; NaN where the geometry refused it
    covariance: Array  # (3, 3) of its additive error
    likelihood: float  # that it is right, by the odometry, against the other candidates and chance


class KeyFrame(NamedTuple):
    """A frame with its features."""

    frame: int
    features: Features


class Cloud(NamedTuple):
    """Points in a camera's frame, and the features that they are of."""

    points: Array  # (n, 3) m
    feature: IntArray  # (n,)
    shifted: Array  # (3, n, 3) m, after a step of one sigma in each direction of the motion they were found with


class Camera(NamedTuple):
    """A level camera: matrix K (3, 3), and its place on the robot."""

    K: Array
    setup: VisualSetup

    def rays(self, pixels: Array) -> Array:
        """Directions (n, 3) with z = 1 of pixels (n, 2)."""
        return np.column_stack([(pixels - self.K[:2, 2]) / np.diag(self.K)[:2], np.ones(len(pixels))])

    def moved(self, relative: Array) -> tuple[Array, Array]:
        """R (3, 3) and t (3,): a point X of the camera is R X + t after the robot's motion (3,)."""
        turn = rotation(relative[2])
        T = np.array(self.setup.translation)
        flat = turn.T @ (turn @ T - T - rotation(self.setup.rotation) @ relative[:2])
        R, t = np.eye(3), np.zeros(3)
        R[np.ix_((0, 2), (0, 2))], t[[0, 2]] = turn.T, flat
        return R, t


def travelled(increments: Increments, first: int, last: int) -> tuple[Array, Array]:
    """Pose (3,) of a later frame in an earlier one, and its covariance (3, 3), by the odometry."""
    pose, P = np.zeros(3), np.zeros((3, 3))
    for z, C in zip(increments.mean[first + 1 : last + 1], increments.covariance[first + 1 : last + 1], strict=True):
        compose_in_place(pose, P, np.array(z), np.array(C), pose, P)
    return pose, P


def bags(keys: Sequence[KeyFrame]) -> Array:
    """Bags of words (K, words) of length 1, weighted by inverse document frequency; the vocabulary is theirs."""
    everything = np.concatenate([key.features.descriptor for key in keys])
    training = everything[:: -(-len(everything) // TRAINING)]
    cv2.setRNGSeed(0)
    stop = (cv2.TERM_CRITERIA_MAX_ITER, 8, 0.0)
    _, _, words = cv2.kmeans(training, min(WORDS, len(training)), np.empty(0, np.int32), stop, 1, cv2.KMEANS_PP_CENTERS)
    tree = 0.5 * np.einsum("ij,ij->i", words, words)
    counts = np.array([
        np.bincount((key.features.descriptor @ words.T - tree).argmax(axis=1), minlength=len(words)) for key in keys
    ], float)  # fmt: skip
    weighted = counts * np.log(len(keys) / np.maximum((counts > 0).sum(axis=0), 1))
    return np.asarray(weighted / np.maximum(np.linalg.norm(weighted, axis=1, keepdims=True), 1e-12))


def cloud_of(camera: Camera, key: KeyFrame, other: KeyFrame, increments: Increments) -> Cloud | None:
    """Points of a key frame by one before it; their motion is that of the images and of the odometry together."""
    back, P = travelled(increments, other.frame, key.frame)
    ((i, j),) = match(other.features, [key.features])
    if len(i) < INLIERS:
        return None
    x, y = camera.rays(key.features.place[i]), camera.rays(other.features.place[j])
    focal, whiten = camera.K[0, 0], np.linalg.inv(np.linalg.cholesky(P))

    def off(motion: Array) -> Array:
        """First-order distances (n,) px from the epipolar lines (Sampson)."""
        R, t = camera.moved(inverse(motion))
        E = np.cross(np.eye(3), t) @ R
        a, b = x @ E.T, y @ E
        return np.asarray(focal * np.einsum("ij,ij->i", y, a) / np.sqrt((a[:, :2] ** 2 + b[:, :2] ** 2).sum(axis=1)))

    def both(motion: Array) -> Array:
        return np.concatenate([off(motion) / PIXEL, whiten @ (motion - back)])

    fit = optimize.least_squares(both, back, loss="soft_l1", x_scale=np.sqrt(np.diag(P)))
    near = np.abs(off(fit.x)) < EPIPOLAR
    if near.sum() < INLIERS:
        return None

    def depths(motion: Array) -> tuple[Array, Array]:
        """Depths d and e (n,) m of the features in both: d R x + t = e y."""
        R, t = camera.moved(inverse(motion))
        A = np.stack([x[near] @ R.T, -y[near]], axis=2)
        d, e = np.linalg.solve(A.transpose(0, 2, 1) @ A, (A.transpose(0, 2, 1) @ -t)[..., None])[..., 0].T
        return d, e

    depth, behind = depths(fit.x)
    distance = float(np.linalg.norm(camera.moved(inverse(fit.x))[1]))
    good = (depth > 0.3) & (behind > 0.0) & (depth < 0.5 * focal * distance)
    if good.sum() < INLIERS:
        return None
    J, ray = np.asarray(fit.jac), x[near][good]
    sigma = np.linalg.cholesky(np.linalg.inv(J.T @ J)).T
    shifted = np.array([ray * depths(fit.x + step)[0][good, None] for step in sigma])
    return Cloud(ray * depth[good, None], i[near][good], shifted)


def verified(camera: Camera, key: KeyFrame, cloud: Cloud, later: KeyFrame) -> tuple[int, Array, Array]:
    """Inliers of the essential matrix of two key frames; pose (3,) of the later one, and its covariance (3, 3)."""
    unknown = np.full(3, np.nan), np.full((3, 3), np.nan)
    ((i, j),) = match(later.features, [key.features])
    if len(i) < INLIERS:
        return len(i), *unknown
    pixels = key.features.place[i], later.features.place[j]
    cv2.setRNGSeed(0)
    E, mask = cv2.findEssentialMat(*pixels, camera.K, cv2.RANSAC, 0.999, EPIPOLAR)
    if E is None or E.shape != (3, 3):
        return 0, *unknown
    _, R, _, _ = cv2.recoverPose(E, *pixels, camera.K, mask=mask.copy())
    agree = mask.ravel() > 0
    _, of_cloud, of_match = np.intersect1d(cloud.feature, i[agree], return_indices=True)
    if len(of_cloud) < INLIERS:
        return len(of_cloud), *unknown
    points, seen = cloud.points[of_cloud], camera.rays(later.features.place[j[agree][of_match]])
    focal = camera.K[0, 0]

    def off(relative: Array, points: Array = points) -> Array:
        """Reprojection errors (2 n,) px."""
        R, t = camera.moved(relative)
        moved = points @ R.T + t
        return np.asarray(focal * (moved[:, :2] / np.maximum(moved[:, 2:], 0.1) - seen[:, :2])).ravel()

    start = [0.0, 0.0, math.atan2(R[0, 2] - R[2, 0], R[0, 0] + R[2, 2])]
    fit = optimize.least_squares(off, start, loss="soft_l1", f_scale=2.0 * PIXEL)
    residual = off(fit.x)
    near = (np.abs(residual).reshape(-1, 2) < 3.0 * EPIPOLAR).all(axis=1)
    if near.sum() < INLIERS:
        return int(near.sum()), *unknown
    rows = np.repeat(near, 2)
    inverted = np.linalg.pinv(np.asarray(fit.jac)[rows])
    # features by themselves, and the motion that all points share
    own = max(PIXEL**2, float(np.mean(residual[rows] ** 2))) * inverted @ inverted.T
    steps = np.array([inverted @ (off(fit.x, shifted[of_cloud]) - residual)[rows] for shifted in cloud.shifted])
    return int(near.sum()), fit.x, own + steps.T @ steps


def key_frames(frames: Iterable[VisualFrame], setup: VisualSetup) -> tuple[Camera, list[KeyFrame], Array, Array]:
    """The camera, key frames, and time (N,) and commands (N, 2) of all frames; DataError without stereo points."""
    keys, times, commands, lines = list[KeyFrame](), list[float](), list[tuple[float, float]](), None
    moved = np.full(2, np.inf)
    for frame in frames:
        if times:
            moved += (frame.time - times[-1]) * np.abs(commands[-1])
        if (moved >= STEP).any():
            keys.append(KeyFrame(len(times), extract(frame.rgb, FEATURES)))
            moved = np.zeros(2)
        times.append(frame.time)
        commands.append((frame.v, frame.omega))
        lines = pinhole(frame.xyz) if lines is None else lines
    if lines is None:
        raise DataError("no frame has stereo points, which tell the camera's focal length and centre")
    K = np.eye(3)
    K[[0, 1], [0, 1]], K[:2, 2] = 1.0 / lines[:, 0], -lines[:, 1] / lines[:, 0]
    return Camera(K, setup), keys, np.array(times), np.array(commands)


def candidates(
    camera: Camera, keys: Sequence[KeyFrame], time: Array, increments: Increments, apart: float
) -> list[Candidate]:
    """Candidates of all key frames, at least `apart` s before each; `time` (N,) s."""
    frame = np.array([key.frame for key in keys], np.int64)
    path = dead_reckoned(np.zeros(3), increments.mean)
    chance = 1.0 / (2.0 * math.pi * float(np.prod(np.ptp(path[:, :2], axis=0) + 2.0 * VIEW)))
    clouds = [_cloud(camera, keys[: k + 1], increments) for k in range(len(keys))]
    located = np.array([cloud is not None for cloud in clouds])
    bag = bags(keys)
    found = list[Candidate]()
    for k, later in enumerate(keys):
        old = np.flatnonzero(located & (time[frame] <= time[later.frame] - apart))
        similarity = bag[old] @ bag[k]
        own, density = list[Candidate](), list[float]()
        for row in np.argsort(-similarity, kind="stable")[:TRIED]:
            key, cloud = keys[old[row]], clouds[old[row]]
            assert cloud is not None
            inliers, relative, covariance = verified(camera, key, cloud, later)
            density.append(0.0)
            if np.isfinite(relative).all():
                expected, P = travelled(increments, key.frame, later.frame)
                off, S = pose_error(relative, expected), P + covariance
                d2 = float(off @ np.linalg.solve(S, off))
                if d2 < gate_threshold(GATE, 3):
                    density[-1] = math.exp(-0.5 * d2) / math.sqrt(float(np.linalg.det(2.0 * math.pi * S)))
            own.append(Candidate(key.frame, later.frame, float(similarity[row]), inliers, relative, covariance, 0.0))
        shares = _likelihoods(own, density, chance, increments)
        found += [c._replace(likelihood=share) for c, share in zip(own, shares, strict=True)]
    return found


def _cloud(camera: Camera, keys: Sequence[KeyFrame], increments: Increments) -> Cloud | None:
    """Points of the last key frame by the nearest one before it that the camera has moved `BASELINE` from."""
    for other in reversed(keys[-7:-1]):
        back, _ = travelled(increments, other.frame, keys[-1].frame)
        if np.linalg.norm(camera.moved(inverse(back))[1]) >= BASELINE:
            return cloud_of(camera, keys[-1], other, increments)
    return None


def _likelihoods(own: Sequence[Candidate], density: Sequence[float], chance: float, motion: Increments) -> list[float]:
    """That each candidate of a key frame is right, against chance and those that place it elsewhere."""
    shares = []
    for one, d in zip(own, density, strict=True):
        against = sum(e for other, e in zip(own, density, strict=True) if e > 0.0 and _apart(one, other, motion))
        shares.append(d / (d + chance + against))
    return shares


def _apart(one: Candidate, other: Candidate, increments: Increments) -> bool:
    """Whether two located candidates contradict each other, by the motion between their frames."""
    S, pose = one.covariance + other.covariance, other.relative
    for first, last, ahead in ((one.frame1, other.frame1, True), (other.frame2, one.frame2, False)):
        motion, P = travelled(increments, min(first, last), max(first, last))
        motion = motion if first <= last else inverse(motion)
        S, pose = S + P, compose(motion, pose) if ahead else compose(pose, motion)
    off = pose_error(one.relative, pose)
    return bool(off @ np.linalg.solve(S, off) >= gate_threshold(AGREE, 3))


def closures_of(found: Sequence[Candidate], keys: Sequence[KeyFrame], increments: Increments) -> Closures | None:
    """The most likely candidate of each later frame, if it is sure and its neighbours confirm it; None: there is none.
    Sure candidates between neighbouring key frames see the same places in other images; most must agree with it.
    """
    row = {key.frame: k for k, key in enumerate(keys)}
    sure = [c for c in found if c.likelihood >= SURE]
    best = {c.frame2: c for c in sorted(sure, key=lambda c: c.likelihood)}
    kept = list[Candidate]()
    for one in (best[k] for k in sorted(best)):
        apart = [
            _apart(one, other, increments) for other in sure if other is not one
            and all(abs(row[a] - row[b]) <= NEIGHBOURS for a, b in zip(one[:2], other[:2], strict=True))
        ]  # fmt: skip
        if 2 * sum(apart) < len(apart):
            kept.append(one)
    if not kept:
        return None
    frames = np.array([(c.frame1, c.frame2) for c in kept], np.int64)
    relative, P = np.array([c.relative for c in kept]), np.array([c.covariance for c in kept])
    return Closures(frames[:, 0], frames[:, 1], relative, P, np.zeros(len(kept), np.int64), ("camera",))
