"""From images to a log: corners of detected pictures as observations, commands as odometry; detections are cached."""

import hashlib
import json
import math
import zipfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from data import pictures
from data.digest import program_digest
from data.errors import UsageError
from data.inputs import CLUTTER, Observations
from data.log import Log
from data.se2 import Array
from data.sensors import RelativePoint
from data.truth import Truth
from data.whole import whole_file
from wings.camera.detector import Detector, encoded
from wings.camera.gallery import inputs_of

SIGMA = (0.02, 0.05)  # m, of a corner to the right and ahead of the camera: the lab's constants
ENOUGH = 20  # fewest sides of pictures to measure noise from
NOISES = ("lab", "depth")
TILES = 12  # frames kept for the report
MOST_SMALL, SMALL_WIDTH = 500, 240  # most frames kept for the player, and their width [px]
PACKAGES = ("data", "wings")  # code that detections depend on
LIBRARIES = ("numba", "numpy", "opencv-python-headless", "scipy")


def find_pictures(recording: pictures.VisualRecording) -> pictures.Found:
    """Detect pictures in every frame of a recording. DataError for a reference image without features."""
    detector = Detector(recording.references, recording.setup.width)
    time, commands, rows = [], [], []
    refused = [Counter[str]() for _ in recording.references]
    candidates: list[tuple[int, int, bytes]] = []
    small: list[tuple[int, bytes]] = []
    n = len(recording)
    every, every_small = max(1, n // (4 * TILES)), -(-n // MOST_SMALL)
    for k, (f, seen) in enumerate(detector.detect_each(recording.frames())):
        time.append(f.time)
        commands.append((f.v, f.omega))
        for picture, reason in seen.refused:
            refused[picture][reason] += 1
        rows += [(k, d) for d in seen.detections]
        if k % every == 0:
            candidates.append((len(seen.detections), k, encoded(f.rgb, 80)))
        if k % every_small == 0:
            size = (SMALL_WIDTH, max(1, round(f.rgb.shape[0] * SMALL_WIDTH / f.rgb.shape[1])))
            small.append((k, encoded(cv2.resize(f.rgb, size, interpolation=cv2.INTER_AREA), 60)))
    with_some = [c for c in candidates if c[0]] or candidates
    chosen = [with_some[i] for i in np.unique(np.linspace(0, len(with_some) - 1, TILES).round().astype(int))]
    pixels = np.array([d.pixels for _, d in rows], float).reshape(-1, pictures.CORNERS, 2)
    points = np.array([d.points for _, d in rows], float).reshape(-1, pictures.CORNERS, 3)
    focal, pixel_noise, depth_noise = measure_noise(pixels, points)
    v, omega = np.array(commands, float).reshape(-1, 2).T
    return pictures.Found(
        time=np.array(time, float), v=v, omega=omega, frame=np.array([k for k, _ in rows], np.int64),
        picture=np.array([d.picture for _, d in rows], np.int64),
        inliers=np.array([d.inliers for _, d in rows], np.int64), pixels=pixels, points=points,
        refused=tuple(dict(sorted(each.items())) for each in refused),
        tiles=tuple((k, image) for _, k, image in chosen), focal=focal, pixel_noise=pixel_noise,
        depth_noise=depth_noise, small=tuple(small),
    )  # fmt: skip


def measure_noise(pixels: Array, points: Array) -> tuple[float, float, float]:
    """Focal length [px], sigma of a corner [px], k [1/m] of sigma_z = k z^2 (NaN: unknown), of pixels and points (D, 4,
    .) of at least `ENOUGH` sides: in a level camera a side's corners have one u and z, so differences about the median
    are noise. Noise common to all corners of a picture is not included.
    """
    p, q = points.reshape(-1, 3), pixels.reshape(-1, 2)
    known = np.isfinite(p).all(axis=1)
    if known.sum() < 2 * ENOUGH:
        return math.nan, math.nan, math.nan
    A = np.stack([p[known, 0] / p[known, 2], np.ones(known.sum())], axis=1)
    focal = float(np.linalg.lstsq(A, q[known, 0], rcond=None)[0][0])
    upper, lower = [0, 1], [3, 2]
    z = points[..., 2]
    depth = ((z[:, upper] - z[:, lower]) / (0.5 * (z[:, upper] + z[:, lower])) ** 2).ravel()
    side = (pixels[:, upper, 0] - pixels[:, lower, 0]).ravel()
    return focal, _spread(side) / math.sqrt(2.0), _spread(depth) / math.sqrt(2.0)


def _spread(values: Array) -> float:
    """Robust standard deviation: 1.4826 times the median distance from the median."""
    finite = values[np.isfinite(values)]
    return float(1.4826 * np.median(np.abs(finite - np.median(finite)))) if len(finite) else math.nan


def noise_of(found: pictures.Found, noise: str) -> Array:
    """Covariances (D, 4, 2, 2) of the corners (right, ahead): `lab` constants, or from the measured depth noise.

    `depth`: x = z (u - c) / f with sigma_u and sigma_z = k z^2 of `measure_noise`, so a depth error moves a corner
    along its ray: R = J diag(sigma_u^2, sigma_z^2) J', J = [z / f, x / z; 0, 1]. UsageError with too few detections.
    """
    x, z = found.points[..., 0], found.points[..., 2]
    R = np.zeros((*x.shape, 2, 2))
    if noise == "lab":
        R[..., 0, 0], R[..., 1, 1] = SIGMA[0] ** 2, SIGMA[1] ** 2
        return R
    if not math.isfinite(found.depth_noise):
        raise UsageError(f"--corner-noise depth: {len(found.frame)} detections are too few to measure the noise")
    variance = (found.depth_noise * z**2) ** 2
    R[..., 0, 0] = (found.pixel_noise * z / found.focal) ** 2 + (x / z) ** 2 * variance
    R[..., 0, 1] = R[..., 1, 0] = x / z * variance
    R[..., 1, 1] = variance
    return R


def log_of(
    setup: pictures.VisualSetup, found: pictures.Found, name: str, *, noise: str = "lab", pose: Array | None = None,
    in_view: pictures.InView | None = None, source: dict[str, object] | None = None, notes: tuple[str, ...] = (),
) -> Log:  # fmt: skip
    """The log: a map of corners (id 4 * picture + corner), an observation for every corner found, labels by picture. A
    command holds until the next frame. `pose` (N, 3) and `in_view` are the truth where known.
    """
    corner = np.tile(np.arange(pictures.CORNERS), len(found.frame))
    label = pictures.CORNERS * np.repeat(found.picture, pictures.CORNERS) + corner
    z = found.points[..., [0, 2]].reshape(-1, 2)
    R = noise_of(found, noise).reshape(-1, 2, 2)
    usable = np.isfinite(z).all(axis=1)
    observations = Observations(np.repeat(found.frame, pictures.CORNERS)[usable], z[usable], R[usable])
    sensor = RelativePoint(rotation=setup.rotation, translation=setup.translation)
    inputs = inputs_of(setup, found.time, np.stack([found.v, found.omega], 1), observations, sensor)
    true_id = None
    if in_view is not None:
        picture = np.repeat(pictures.true_pictures(found, in_view), pictures.CORNERS)
        true_id = np.where(picture < 0, CLUTTER, pictures.CORNERS * picture + corner)[usable]
    return Log(
        name, inputs, Truth(pose, inputs.map, true_id), label=label[usable], labels_are_sensed=True,
        source={"kind": "visual", "corner_noise": noise, **(source or {})}, notes=notes,
        evidence=pictures.Evidence(setup, found, in_view),
    )  # fmt: skip


def cached(folder: Path, key: str, find: Callable[[], pictures.Found]) -> tuple[pictures.Found, str | None]:
    """Detections from `folder`, or made now and kept there; and a note where they could not be kept."""
    digest = hashlib.sha256((key + program_digest(PACKAGES, LIBRARIES)).encode())
    path = folder / f".detections-{digest.hexdigest()[:16]}.npz"
    kept = _load(path)
    if kept is not None:
        return kept, None
    found = find()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _save(path, found)
    except OSError as fault:
        return found, f"Detections could not be kept in {folder.name} ({fault.strerror}); the next run looks again."
    return found, None


ARRAYS = ("time", "v", "omega", "frame", "picture", "inliers", "pixels", "points")
IMAGES = ("tiles", "small")


def _save(path: Path, found: pictures.Found) -> None:
    arrays: dict[str, Any] = {name: getattr(found, name) for name in ARRAYS}
    arrays |= {f"{kind}_{k}": np.frombuffer(image, np.uint8) for kind in IMAGES for k, image in getattr(found, kind)}
    others = {name: getattr(found, name) for name in ("refused", "focal", "pixel_noise", "depth_noise")}
    arrays["others"] = np.frombuffer(json.dumps(others).encode(), np.uint8)
    with whole_file(path) as partial:
        np.savez(partial, **arrays)


def _load(path: Path) -> pictures.Found | None:
    try:
        with path.open("rb") as file, np.load(file) as kept:
            values: dict[str, Any] = {name: kept[name] for name in ARRAYS} | json.loads(kept["others"].tobytes())
            for kind in IMAGES:
                own = [name for name in kept.files if name.startswith(f"{kind}_")]
                values[kind] = tuple((int(name.partition("_")[2]), kept[name].tobytes()) for name in own)
            return pictures.Found(**values | {"refused": tuple(values["refused"])})
    except (OSError, zipfile.BadZipFile, KeyError, TypeError, ValueError, EOFError):
        return None
