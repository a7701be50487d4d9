"""A picture that is not wholly and certainly there is refused by name."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

import wings.camera.checks as checks
from tests.wings.camera.wall import (
    HEIGHT,
    PICTURE,
    PICTURES,
    WIDTH,
    found,
    hang,
    hung,
    projected,
    reason,
    texture,
    wall,
)
from wings.camera.detector import FEW_INLIERS, NOT_SEEN, SAME_PLACE, UNCERTAIN, Detector


@pytest.mark.slow
@pytest.mark.parametrize("x", [-0.95, -0.75, 0.75])
def test_a_picture_that_is_partly_outside_the_image_is_refused(textures, detector, x):
    truth = hung(1.5, 0, x=x)
    assert np.any(projected(truth) < 0) or np.any(projected(truth) > WIDTH - 1)
    scene = hang(wall(), textures[1], truth)
    result = detector.detect(scene.rgb, scene.xyz)
    assert found(result) == []
    assert reason(result, 1) in (checks.OUTSIDE, NOT_SEEN)


def test_a_mirrored_picture_is_not_found(textures, detector):
    scene = hang(wall(), np.ascontiguousarray(textures[1][:, ::-1]), hung(1.5))
    assert found(detector.detect(scene.rgb, scene.xyz)) == []


@pytest.mark.parametrize("kind", ["black", "wall", "noise"])
def test_nothing_is_found_where_nothing_hangs(detector, kind):
    rng = np.random.default_rng(5)
    image = {
        "black": np.zeros((HEIGHT, WIDTH, 3), np.uint8),
        "wall": wall().rgb,
        "noise": rng.integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8),
    }[kind]
    result = detector.detect(image, wall().xyz)
    assert found(result) == []
    assert [reason for _, reason in result.refused] == [NOT_SEEN] * PICTURES


def test_an_unknown_picture_is_not_taken_for_a_known_one(detector):
    scene = hang(wall(), texture(99), hung(1.2))
    assert found(detector.detect(scene.rgb, scene.xyz)) == []


@pytest.mark.slow
def test_of_two_pictures_at_one_place_the_better_supported_stays(textures, detector):
    pasted = textures[0].copy()
    pasted[120:240, 160:320] = cv2.resize(textures[1], (160, 120), interpolation=cv2.INTER_AREA)
    scene = hang(wall(), pasted, hung(0.9))
    result = detector.detect(scene.rgb)
    assert found(result) == [0]
    assert reason(result, 1) == SAME_PLACE
    without = Detector(textures[1:2], None).detect(scene.rgb)
    assert found(without) == [0], "the inner picture is there, and found where nothing competes"


def test_a_picture_of_which_only_a_part_can_be_seen_has_no_certain_corners(textures, sizeless):
    truth = hung(0.8)
    scene = hang(wall(), textures[0], truth)
    u, v = np.rint(projected(truth)[0]).astype(int)
    shown = np.zeros((HEIGHT, WIDTH, 1), bool)
    shown[v : v + 125, u : u + 110] = True
    result = sizeless.detect(np.where(shown, scene.rgb, wall().rgb))
    assert reason(result, 0) == UNCERTAIN


def test_a_picture_whose_pieces_are_shuffled_is_refused(textures, sizeless):
    pieces = [tile for row in np.split(textures[0], 6) for tile in np.split(row, 6, axis=1)]
    order = np.random.default_rng(0).permutation(36)
    shuffled = np.vstack([np.hstack([pieces[i] for i in row]) for row in order.reshape(6, 6)])
    result = sizeless.detect(hang(wall(), shuffled, hung(0.8)).rgb)
    assert found(result) == []


def test_a_glimpse_of_a_picture_is_not_a_sight_of_it(textures, sizeless):
    truth = hung(0.8)
    scene = hang(wall(), textures[0], truth)
    u, v = np.rint(projected(truth).mean(axis=0)).astype(int)
    for size, expected in ((30, NOT_SEEN), (60, NOT_SEEN), (80, FEW_INLIERS)):
        glimpse = wall().rgb
        glimpse[v : v + size, u : u + size] = scene.rgb[v : v + size, u : u + size]
        assert reason(sizeless.detect(glimpse), 0) == expected


def test_scattered_holes_of_the_stereo_points_do_no_harm(textures, detector):
    truth = hung(1.5, 20)
    scene = hang(wall(), textures[0], truth)
    scene.xyz[np.random.default_rng(3).random((HEIGHT, WIDTH)) < 0.6] = np.nan
    (detection,) = detector.detect(scene.rgb, scene.xyz).detections
    assert np.abs(detection.points - truth).max() < 0.03


def test_a_hole_at_a_corner_is_bridged_if_small_and_refused_if_large(textures, detector):
    truth = hung(1.5, 0)
    scene = hang(wall(), textures[0], truth)
    u, v = np.rint(projected(truth)[2]).astype(int)
    scene.xyz[v - 7 : v + 8, u - 7 : u + 8] = np.nan
    assert found(detector.detect(scene.rgb, scene.xyz)) == [0]
    scene.xyz[v - 30 : v + 30, u - 30 : u + 30] = np.nan
    assert reason(detector.detect(scene.rgb, scene.xyz), 0) == checks.NO_DEPTH


@pytest.mark.parametrize("void", [np.nan, 0.0])
def test_without_any_valid_stereo_point_the_picture_is_refused(textures, detector, void):
    scene = hang(wall(), textures[0], hung(1.5))
    result = detector.detect(scene.rgb, np.full_like(scene.xyz, void))
    assert reason(result, 0) == checks.NO_DEPTH


def test_something_in_front_of_a_corner_is_noticed(textures, detector):
    truth = hung(1.5)
    scene = hang(wall(), textures[0], truth)
    u, v = np.rint(projected(truth)[0]).astype(int)
    scene.xyz[v - 5 : v + 40, u - 5 : u + 40] *= 0.7
    assert reason(detector.detect(scene.rgb, scene.xyz), 0) == checks.NOT_PLANAR


@pytest.mark.parametrize("factor", [0.75, 1.3])
@pytest.mark.slow
def test_a_copy_of_the_wrong_size_is_refused_where_the_size_is_known(textures, detector, sizeless, factor):
    scene = hang(wall(), textures[0], hung(1.5, width=factor * PICTURE))
    assert reason(detector.detect(scene.rgb, scene.xyz), 0) == checks.WRONG_SIZE
    assert found(sizeless.detect(scene.rgb, scene.xyz)) == [0]


def test_a_picture_of_the_right_width_and_the_wrong_height_is_refused():
    points = hung(1.5)
    assert checks.size_fault(points, PICTURE, 0.75) is None
    assert checks.size_fault(points, PICTURE, 0.5) == checks.WRONG_SIZE
    assert checks.size_fault(points, 1.1 * PICTURE, 0.75) is None
    sheared = points + np.array([[0.1, 0, 0], [0.1, 0, 0], [-0.1, 0, 0], [-0.1, 0, 0]])
    assert checks.size_fault(sheared, PICTURE, 0.75) == checks.WRONG_SIZE
