"""Small inputs with known results: a linear world, a mildly nonlinear one, an arena as it is or with changes."""

from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from data.inputs import CLUTTER, Increments, Inputs, LabelledObservations, LandmarkMap, Prior
from data.log import Log
from data.se2 import Array, between, compose, rotation, wrap_angle
from data.sensors import RangeBearing, RelativePoint
from data.worlds import arena

FRAMES = 16
SEED = 3
SILENT = slice(6, 10)  # frames that see nothing, in the log with empty frames


class Small(NamedTuple):
    """A small world: its size, and sigmas of a position or step [m], a heading or turn [rad], and of observations."""

    size: float
    position: float
    heading: float
    seen: tuple[float, float]


LINEAR, MILD = "linear", "mild"
SMALL = {
    # the heading is known; only products of its error with another one are neglected, some 1e-7 of a sigma
    LINEAR: Small(1.0, 0.2, 3e-6, (0.2, 0.1)),
    # sound approximations are within 3 % of a sigma; a smoother's limits in metres need a large world
    MILD: Small(60.0, 0.24, 0.0013, (0.24, 0.0013)),
}
BEHIND = ((4, 11), (7, 9))  # landmarks straight behind the robot in a frame: bearings on both sides of pi
EMPTY = (1, 7)  # frames that see nothing: there the prediction alone is reported


@lru_cache(maxsize=2)
def small(world: str) -> Inputs:
    """Labelled inputs of a small world, in which a Kalman filter is exact (`LINEAR`) or nearly so (`MILD`).

    Covariances are full and differ; the robot turns, its heading crosses pi; landmarks appear late and return; ids are
    neither consecutive nor in order; some observations are false alarms.
    """
    w, sensor = SMALL[world], RelativePoint() if world == LINEAR else RangeBearing()
    rng = np.random.default_rng([SEED, len(world)])
    n = 14
    step = np.array([1.3, 0.2, 0.45])
    pose = np.empty((n, 3))
    pose[0] = 1.0, -2.0, 2.3
    for k in range(1, n):
        pose[k] = compose(pose[k - 1], step + np.array([0.3, 0.2, 0.1]) * np.sin([k, 2.0 * k, 3.0 * k]))
    centre = pose[:, :2].mean(axis=0)
    angle, radius = 2.4 * np.arange(9), np.array([0.2, 4.9, 5.2, 0.9, 5.5, 5.8, 1.2, 6.1, 6.4])
    xy = w.size * (centre + np.column_stack([np.cos(angle), np.sin(angle)]) * radius[:, None])
    pose[:, :2] *= w.size
    for row, k in BEHIND:
        xy[row] = pose[k, :2] - 3.0 * w.size * np.array([np.cos(pose[k, 2]), np.sin(pose[k, 2])])
    known = LandmarkMap(np.array([2, 3, 7, 8, 12, 20, 21, 35, 36]), xy)
    sigma = np.array([w.position, w.position, w.heading])
    M = _covariances(rng, sigma, n)
    motion = np.zeros((n, 3))
    motion[1:] = between(pose[:-1], pose[1:]) + drawn(rng, M[1:])
    M[0] = 0.0
    P0 = _covariances(rng, sigma, 1)
    frame, label = [], []
    for k in (k for k in range(n) if k not in EMPTY):
        ids = rng.permutation(known.id[np.hypot(*(xy - pose[k, :2]).T) < w.size * (3.2 if k < 5 else 4.6)])[:5].tolist()
        ids += [i for i in known.id[[row for row, _ in BEHIND]].tolist() if k > 5 and i not in ids]
        ids += [CLUTTER] if k % 4 == 3 else []
        label += ids
        frame += [k] * len(ids)
    R = _covariances(rng, np.array(w.seen), len(frame))
    z = sensor.predict(pose[frame], known.positions(np.where(np.array(label) >= 0, label, known.id[0]))) + drawn(rng, R)
    if world == MILD:
        z[:, 1] = wrap_angle(z[:, 1])
    z[np.array(label) == CLUTTER] += 0.7 * w.size * np.array([1.0, 0.1])
    observations = LabelledObservations(np.array(frame), z, R, np.array(label))
    prior = Prior(pose[0] + drawn(rng, P0)[0], P0[0])
    return Inputs(prior, np.arange(float(n)), Increments(motion, M), observations, sensor, known)


def _covariances(rng: np.random.Generator, sigma: Array, count: int) -> Array:
    """Full covariances (count, d, d) with about these sigmas (d,)."""
    d = len(sigma)
    A = np.eye(d) + rng.uniform(-0.6, 0.6, (count, d, d))
    full = A @ A.transpose(0, 2, 1)
    scale = sigma / np.sqrt(np.einsum("nii->ni", full)) * rng.uniform(0.8, 1.25, (count, d))
    found = np.asarray(scale[:, :, None] * full * scale[:, None, :])
    if d == 3 and sigma[2] < 1e-4:
        found[:, 2, :2], found[:, :2, 2] = 0.0, 0.0
    return found


def drawn(rng: np.random.Generator, C: Array) -> Array:
    """A draw (n, d) from each C (n, d, d)."""
    return np.asarray(np.einsum("nij,nj->ni", np.linalg.cholesky(C), rng.standard_normal(C.shape[:2])))


def arena_log() -> Log:
    """A robot surrounded by landmarks, with bearings across +-pi."""
    return arena.simulate(arena.Arena(frames=FRAMES, landmarks=14, side=18.0), SEED)


def noise_free(log: Log) -> Log:
    """The same without noise; the covariances stay as stated."""
    r, t = log.recorded, log.truth
    assert t.pose is not None
    assert t.landmarks is not None
    assert t.landmark_of is not None
    mean = np.zeros_like(r.increments.mean)
    mean[1:] = between(t.pose[:-1], t.pose[1:])
    o = r.observations
    z = r.sensor.predict(t.pose[o.frame], t.landmarks.positions(t.landmark_of))
    moved, prior = Increments(mean, r.increments.covariance), Prior(t.pose[0], r.prior.covariance)
    return replace(log, recorded=replace(r, prior=prior, increments=moved, observations=replace(o, z=z)))


def straight(log: Log) -> Log:
    """The same with a true step of no turn, and one of no motion after it; observations and increments stay."""
    pose = log.truth.pose
    assert pose is not None
    moved, k = pose.copy(), FRAMES // 2
    moved[k] = moved[k + 1] = compose(pose[k - 1], np.array([0.5, 0.0, 0.0]))
    moved[k + 2 :] = compose(moved[k], between(pose[k + 1], pose[k + 2 :]))
    return replace(log, truth=replace(log.truth, pose=moved))


def silent(log: Log, frames: slice) -> Log:
    """The same without the observations of some frames."""
    r, t = log.recorded, log.truth
    assert t.landmark_of is not None
    seen = ~np.isin(r.observations.frame, np.arange(len(r))[frames])
    r = replace(r, observations=r.observations.only(seen))
    return replace(log, recorded=r, truth=replace(t, landmark_of=t.landmark_of[seen]))


def turned(inputs: Inputs, angle: float) -> Inputs:
    """The same inputs in a world rotated about its origin by an angle [rad]."""
    R = np.eye(3)
    R[:2, :2] = rotation(angle)
    prior = Prior(compose(np.array([0.0, 0.0, angle]), inputs.prior.mean), R @ inputs.prior.covariance @ R.T)
    known = None if inputs.map is None else LandmarkMap(inputs.map.id, inputs.map.xy @ R[:2, :2].T)
    return replace(inputs, prior=prior, map=known)


def turned_back(poses: Array, angle: float) -> Array:
    """Poses (N, 3) in the world before its rotation."""
    back = np.array(poses)
    back[:, :2] = back[:, :2] @ rotation(angle)
    back[:, 2] = wrap_angle(back[:, 2] - angle)
    return back
