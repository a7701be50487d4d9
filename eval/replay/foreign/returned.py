"""What a foreign estimator returns, in our types: what may be left out is filled in, what cannot be used is said."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from association.expectation import Expectation
from data.inputs import IntArray, Sightings
from data.result import Finished, MapState, PoseEstimate, Trajectory, Updated
from data.se2 import BoolArray, wrap_angle
from eval.replay.foreign.guard import ForeignError, array, call, kind, whole
from eval.replay.foreign.samples import Samples

BLANK = np.full((3, 3), np.nan)
BLANK.setflags(write=False)
TOLERANCE = 1e-9
"""Asymmetry of a covariance, and how negative its least eigenvalue may be, as a share of the trace: rounding."""


def pose_of(who: str, given: Any) -> PoseEstimate:
    """A pose: (mean, covariance), (mean, None), a mean (3,) alone, or `Samples`; the heading is wrapped."""
    if isinstance(given, Samples):
        given = call(who, given.estimate)
    if isinstance(given, tuple):
        if len(given) != 2:
            raise ForeignError(f"{who} returned a tuple of {len(given)}; (mean, covariance) is needed, or Samples")
        mean, covariance = given
    else:
        mean, covariance = given, None
    if mean is None:
        raise ForeignError(f"{who} returned None; (mean, covariance) is needed, or Samples")
    pose = array(who, mean, (3,), "the mean")
    if not -math.pi <= pose[2] <= math.pi:
        pose[2] = wrap_angle(float(pose[2]))
    if covariance is None:
        return PoseEstimate(pose, BLANK)
    P = array(who, covariance, (3, 3), "the covariance")
    check_covariance(who, P)
    return PoseEstimate(pose, P)


def check_covariance(who: str, P: Any) -> None:
    """Raises ForeignError for a matrix that is no covariance, rounding aside."""
    size = max(float(np.trace(P)), 0.0)
    off = float(np.abs(P - P.T).max())
    if off > TOLERANCE * size:
        raise ForeignError(f"{who}: the covariance is not symmetric: two elements differ by {off:.3g}")
    least = float(np.linalg.eigvalsh(0.5 * (P + P.T))[0])
    if least < -TOLERANCE * size:
        raise ForeignError(f"{who}: the covariance is not positive semidefinite: an eigenvalue is {least:.3g}")


def expectation_of(who: str, given: Any, sightings: Sightings) -> Expectation:
    """An expectation of the present observations, whose functions are guarded, too."""
    if not isinstance(given, Expectation):
        raise ForeignError(f"{who} returned {kind(given)}; an association.expectation.Expectation is needed")
    n, m = len(given.number), len(sightings.z)
    number = whole(who, given.number, n, "number")
    if len(np.unique(number)) != n or (number < 0).any():
        raise ForeignError(f"{who}: number {number.tolist()}: a candidate is named twice, or by a negative number")
    joint, elsewhere = given.joint, given.elsewhere

    def guarded(indices: IntArray) -> Any:
        k = len(indices)
        return array(f"{who}: joint", call(f"{who}: joint", joint, indices), (2 * k, 2 * k), "what it returned")

    def moved(pose: Any) -> Expectation:
        assert elsewhere is not None
        return expectation_of(who, call(f"{who}: elsewhere", elsewhere, pose), sightings)

    return replace(
        given,
        number=number,
        z_hat=array(who, given.z_hat, (n, 2), "z_hat"),
        HPHt=array(who, given.HPHt, (n, 2, 2), "HPHt"),
        frame=whole(who, given.frame, n, "frame"),
        z=array(who, given.z, (m, 2), "z"),
        R=array(who, given.R, (m, 2, 2), "R"),
        observed_frame=whole(who, given.observed_frame, m, "observed_frame"),
        joint=guarded,
        elsewhere=None if elsewhere is None else moved,
    )


def updated_of(who: str, given: Any, decisions: IntArray, new: BoolArray, created: int) -> Updated:
    """What an update did. None, or a mapping of some of the fields of `Updated`: all that was decided was done.

    Args:
        who: names it in errors.
        given: what it returned.
        decisions: (m,) what it was told.
        new: (m,) which of them were to initialize a landmark.
        created: how many landmarks it had initialized before.
    """
    m = len(decisions)
    numbers = np.where(new, created + np.cumsum(new) - 1, -1)
    said = given._asdict() if isinstance(given, Updated) else {} if given is None else given
    if not isinstance(said, Mapping) or set(said) - set(Updated._fields):
        raise ForeignError(
            f"{who} returned {kind(given)}; None, a data.result.Updated, or a dict with some of its fields "
            f"({', '.join(Updated._fields)}) is needed"
        )
    used = decisions >= 0
    if said.get("used") is not None:
        found = np.asarray(said["used"])
        if found.shape != (m,) or found.dtype != np.bool_:
            raise ForeignError(f"{who}: used is {found.dtype} {found.shape}; bool {(m,)} is needed")
        used = found & used
    if said.get("created") is not None:
        made = whole(who, said["created"], m, "created")
        wanted = np.where(made >= 0, created + np.cumsum(made >= 0) - 1, -1)
        if (made != wanted).any() or (made >= 0)[~new].any():
            raise ForeignError(
                f"{who}: created is {made.tolist()}; landmarks are numbered in the order of their creation, which "
                f"would be {numbers.tolist()}"
            )
        numbers = made
    white = said.get("white")
    return Updated(
        used,
        numbers.astype(np.int64),
        float(said.get("nis", math.nan)),
        int(said.get("dof", 2 * int(used.sum()))),
        float(said.get("log_likelihood", math.nan)),
        None if white is None else array(who, white, (m, 2), "white", finite=False),
    )


def map_of(who: str, given: Any) -> MapState:
    """A map: number (L,), xy (L, 2) and covariance (L, 2, 2), which may be None."""
    if not isinstance(given, tuple) or len(given) != 3:
        raise ForeignError(f"{who} returned {kind(given)}; (number, xy, covariance) is needed, covariance may be None")
    n = len(given[0])
    covariance = np.full((n, 2, 2), np.nan) if given[2] is None else array(who, given[2], (n, 2, 2), "the covariance")
    return MapState(whole(who, given[0], n, "number"), array(who, given[1], (n, 2), "xy"), covariance)


def finished_of(who: str, given: Any) -> Finished:
    """The end of a run: a final trajectory or None, and a map or None."""
    if not isinstance(given, Finished):
        raise ForeignError(f"{who} returned {kind(given)}; a data.result.Finished is needed, or no `finish` at all")
    final = given.final
    if final is not None and not isinstance(final, Trajectory):
        raise ForeignError(f"{who}: final is {kind(final)}; a data.result.Trajectory is needed, or None")
    return given._replace(map=None if given.map is None else map_of(who, given.map))
