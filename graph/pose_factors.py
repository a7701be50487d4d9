"""Measurements of the pose itself as gtsam factors: absolute fixes of a frame, and closures between two frames.

A fix's error is additive in the world frame, a closure's in the frame it is measured in, as in a filter
(`data.pose_measurements`). gtsam's errors of poses are logarithms in the body frame, with the same covariance to first
order: poses and relative poses are converted to that, headings and positions are exact.

Those of a frame are tested one after another on the joint Gaussian of the poses that they measure. Each one inside the
gate updates the few poses, as in a filter, before the next one is tested. A smoother then adds the accepted ones to its
graph at once.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from association.expectation import gate_threshold
from data import pose_measurements
from data.inputs import IntArray
from data.se2 import Array, compose, inverse, world_from_body, worlds_from_bodies
from graph.factors import Factor, invertible_roots, noise, pose2, relative_factors, with_loss


def in_turn(
    mean: Array, P: Array, measured: Sequence[pose_measurements.GaussianMeasurement | None], gate: float | None
) -> pose_measurements.PoseUpdated:
    """Test measurements (f,) of poses with mean (q,) and covariance P (q, q), world frame; None: it cannot be used."""
    done = pose_measurements.not_used([3 if m is None else len(m.entries) for m in measured])
    for i, m in enumerate(measured):
        if m is None:
            continue
        nu, H = m.innovation(mean)
        S = H @ P @ H.T + m.R
        L = np.linalg.cholesky(S)
        white = np.linalg.solve(L, nu)
        done.nis[i] = white @ white
        done.white[i, list(m.entries)] = white
        done.S[i][np.ix_(m.entries, m.entries)] = S
        done.used[i] = done.nis[i] < gate_threshold(gate, len(m.entries))
        if done.used[i]:
            W = np.linalg.solve(L, H @ P)
            mean, P = mean + W.T @ white, P - W.T @ W
    return done


def closures_of(
    closures: pose_measurements.Closures, frames: IntArray
) -> list[pose_measurements.GaussianMeasurement | None]:
    """The closures (c) of a frame as measurements of the poses of `frames` (k,), stacked; None: a frame is missing."""
    place, size = {frame: 3 * i for i, frame in enumerate(frames.tolist())}, 3 * len(frames)
    ends = zip(closures.frame1.tolist(), closures.frame2.tolist(), closures.relative, closures.covariance, strict=True)
    return [
        pose_measurements.closure_of(relative, C, place[first], place[second], size)
        if first in place and second in place else None for first, second, relative, C in ends
    ]  # fmt: skip


@dataclass(frozen=True)
class PoseFactor:
    """One fix or closure (d dimensions) as a factor."""

    frames: tuple[int, ...]  # of a fix: its own; of a closure: frame1 and frame2
    row: int  # in the log's fixes or closures
    factor: Factor
    unwhiten: Array  # (d, d): times the factor's whitened error, the measurement minus its expectation
    entries: tuple[int, ...]  # measured ones (d,) of x, y, theta
    used: bool = True  # False: it takes part in no estimate, but its innovation is formed

    @property
    def closure(self) -> bool:
        """Whether it ties two frames."""
        return len(self.frames) == 2

    def left_out(self) -> "PoseFactor":
        """The same without a part in the estimate."""
        return replace(self, used=False)


def fix_factors(
    frames: list[int], fixes: pose_measurements.Fixes, sources: tuple[pose_measurements.FixSource, ...],
    loss: str = "gaussian",
) -> list[PoseFactor]:  # fmt: skip
    """Fixes (f) of frames (f,). Raises DataError for a singular covariance."""
    found = []
    for i, (frame, kind) in enumerate(zip(frames, fixes.kind.tolist(), strict=True)):
        source, entries = sources[int(fixes.source[i])], pose_measurements.MEASURED[pose_measurements.FixKind(kind)]
        z, C = fixes.z[i], fixes.covariance[i][np.ix_(entries, entries)]
        turn = -np.eye(len(entries))
        if kind == pose_measurements.FixKind.POSE:
            # the pose of the robot, and what a small motion of it in its own frame changes
            z = compose(z, inverse(np.array([*source.lever, source.rotation])))
            turn = -pose_measurements.expected_fix(z, kind, source)[1] @ world_from_body(float(z[2]))
        back = np.linalg.inv(turn)
        named = partial("fix of {} at frame {}".format, source.name, frame)
        (root,), _ = invertible_roots((back @ C @ back.T)[None], named, "its inverse")
        model, key = with_loss(noise.Gaussian.SqrtInformation(root), loss), X(frame)
        if kind == pose_measurements.FixKind.POSE:
            factor: Factor = gtsam.PriorFactorPose2(key, pose2(z), model)
        elif kind == pose_measurements.FixKind.HEADING:
            factor = gtsam.PoseRotationPrior2D(key, gtsam.Rot2(float(z[2]) - source.rotation), model)
        elif source.lever == (0.0, 0.0):
            factor = gtsam.PoseTranslationPrior2D(key, z[:2], model)
        else:
            factor = gtsam.CustomFactor(model, [key], _antenna(key, z[:2].copy(), source))
        found.append(PoseFactor((frame,), int(fixes.row[i]), factor, turn @ np.linalg.inv(root), entries))
    return found


def _antenna(
    key: int, z: Array, source: pose_measurements.FixSource
) -> Callable[[gtsam.CustomFactor, gtsam.Values, list[Array] | None], Array]:
    """The position of a source off the robot's centre: gtsam has this factor in space only."""
    lever = np.array(source.lever)

    def residual(_: gtsam.CustomFactor, values: gtsam.Values, H: list[Array] | None) -> Array:
        pose = values.atPose2(key)
        if H is not None:
            R = pose.rotation().matrix()
            arm = R @ lever
            H[0] = np.column_stack([R, [-arm[1], arm[0]]])
        return np.asarray(pose.transformFrom(lever) - z)

    return residual


def closure_factors(closures: pose_measurements.Closures, loss: str = "gaussian") -> list[PoseFactor]:
    """Closures (c) as factors. Raises DataError for a singular covariance."""
    first, second = closures.frame1.tolist(), closures.frame2.tolist()
    turn = worlds_from_bodies(closures.relative[:, 2])  # the error in frame1's frame, from gtsam's in frame2's

    def named(i: int) -> str:
        return f"closure of {closures.sources[closures.source[i]]} between frames {first[i]} and {second[i]}"

    c = closures
    factors, _, roots = relative_factors(c.frame1, c.frame2, c.relative, c.covariance, named, loss)
    each = zip(first, second, c.row.tolist(), factors, -turn @ np.linalg.inv(roots), strict=True)
    return [PoseFactor((a, b), row, factor, back, (0, 1, 2)) for a, b, row, factor, back in each]
