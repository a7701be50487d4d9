"""Delayed initialization: where bearings and ranges from several poses meet."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from association.triangulate import triangulate
from data.sensors import Bearing, Range, Sensor

KINDS = {"bearing": Bearing(rotation=0.3, translation=(0.2, 0.1)), "range": Range(translation=(0.1, -0.2))}
VARIANCE = {"bearing": np.diag([1.0, 1e-6]), "range": np.diag([1e-4, 1.0])}
SQUARE = np.array([[0.0, 0.0, 0.1], [2.0, 0.0, 1.0], [2.5, 2.0, 2.0], [0.0, 2.0, -2.0], [-1.0, 1.0, 0.5]])


def observed(kinds: list[str], pose: np.ndarray, xy: np.ndarray) -> tuple[list[Sensor], np.ndarray, np.ndarray]:
    sensors = [KINDS[k] for k in kinds]
    z = np.array([s.predict(p, xy[None])[0] for s, p in zip(sensors, pose, strict=True)])
    return sensors, z, np.array([VARIANCE[k] for k in kinds])


@settings(max_examples=25)
@given(st.floats(2.5, 6.0), st.floats(-3.1, 3.1), st.lists(st.sampled_from(sorted(KINDS)), min_size=5, max_size=5))
def test_exact_observations_meet_at_the_landmark(distance: float, angle: float, kinds: list[str]) -> None:
    xy = np.array([1.0, 1.0]) + distance * np.array([np.cos(angle), np.sin(angle)])
    place = triangulate(*_with(kinds, SQUARE, xy))
    assert place is not None
    np.testing.assert_allclose(place.xy, xy, atol=1e-6)


def _with(kinds, pose, xy, sigma=1e-4):
    sensors, z, R = observed(kinds, pose, xy)
    return sensors, pose, sigma**2 * np.eye(3 * len(pose)), z, R


def test_an_error_that_all_poses_share_does_not_matter() -> None:
    """A robot that hardly knows where it is still knows where the landmark is beside it."""
    sensors, pose, _, z, R = _with(["bearing"] * 5, SQUARE, np.array([3.0, 3.0]))
    turned = np.zeros((15, 3))  # a common motion: also the lever of a common turn
    for i, (x, y, _) in enumerate(SQUARE):
        turned[3 * i : 3 * i + 3] = [[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]]
    assert triangulate(sensors, pose, turned @ turned.T + 1e-10 * np.eye(15), z, R) is not None


@pytest.mark.parametrize("kind", ["bearing", "range"])
def test_two_observations_or_no_parallax_determine_nothing(kind: str) -> None:
    xy = np.array([5.0, 0.5])
    sensors, pose, P, z, R = _with([kind] * 5, SQUARE, xy)
    assert triangulate(sensors[:2], pose[:2], P[:6, :6], z[:2], R[:2]) is None
    assert triangulate(*_with([kind] * 5, np.repeat(SQUARE[:1], 5, axis=0), xy)) is None


def test_ranges_along_a_line_leave_two_sides() -> None:
    line = np.array([[x, 0.0, 0.0] for x in np.linspace(-2.0, 2.0, 6)])
    centred = Range()
    z = np.array([centred.predict(p, np.array([[0.5, 3.0]]))[0] for p in line])
    given = [centred] * 6, line, 1e-8 * np.eye(18), z, np.tile(VARIANCE["range"], (6, 1, 1))
    assert triangulate(*given) is None


def test_observations_of_two_landmarks_contradict_each_other() -> None:
    sensors, z, R = observed(["range"] * 5, SQUARE, np.array([3.0, 3.0]))
    z[2, 0] += 1.5
    assert triangulate(sensors, SQUARE, 1e-8 * np.eye(15), z, R) is None
