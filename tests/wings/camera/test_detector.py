"""Pictures are found in rendered and photographed scenes, with the right identity and corners."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from threadpoolctl import threadpool_limits

import wings.camera.checks as checks
from data.errors import DataError
from tests.wings.camera.wall import CENTRE, FOCAL, HEIGHT, PICTURE, PICTURES, WIDTH, found, hang, hung, projected, wall
from wings.camera.detector import NOT_SEEN, Detector

# --- what is found ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_every_picture_is_found_with_its_own_name_and_corners_within_a_pixel(textures, detector):
    offsets, plane_errors, window_errors, hits, views = [], [], [], 0, 0
    for i, (distance, yaw) in enumerate(((1.5, -30), (2.0, 50), (3.0, 0), (3.0, -50))):
        for picture, image in [*enumerate(textures)][i % 2 :: 2]:
            truth = hung(distance, yaw, x=0.1 * (picture - 1.5))
            scene = hang(wall(picture), image, truth, seed=picture)
            result = detector.detect(scene.rgb, scene.xyz)
            assert set(found(result)) <= {picture}
            views += 1
            for detection in result.detections:
                hits += 1
                offsets.append(detection.pixels - projected(truth))
                plane_errors.append(detection.points - truth)
                windows = checks.corner_windows(detection.pixels, scene.xyz)
                window_errors.append(
                    np.column_stack([(detection.pixels - CENTRE) / FOCAL, np.ones(4)]) * windows[1][:, None] - truth
                )
    assert hits >= views - 1
    errors = np.linalg.norm(offsets, axis=2)
    assert np.median(errors) < 0.5
    assert np.percentile(errors, 95) < 2.0
    assert np.abs(np.median(offsets, axis=(0, 1))).max() < 0.08, "no common shift"
    # the corner on the fitted plane is nearer than the depth of a window beside the corner
    plane, window = (np.sqrt(np.mean(np.square(e), axis=(0, 1))) for e in (plane_errors, window_errors))
    assert plane[0] < 0.01
    assert plane[2] < 0.01
    assert plane[2] < 0.6 * window[2]


@pytest.mark.slow
def test_several_pictures_in_one_frame_are_all_found(textures, detector):
    scene = wall()
    places = {2: hung(2.2, 20, x=-0.85), 0: hung(2.2, 0, x=0.0), 3: hung(2.2, -20, x=0.85)}
    for picture, corners in places.items():
        scene = hang(scene, textures[picture], corners)
    result = detector.detect(scene.rgb, scene.xyz)
    assert found(result) == [0, 2, 3]
    assert result.refused == [(1, NOT_SEEN)]
    for detection in result.detections:
        assert np.abs(detection.points - places[detection.picture]).max() < 0.03


@pytest.mark.parametrize("harm", ["slight blur", "smear", "glare"])
def test_a_spoilt_picture_is_found_or_refused_but_never_misplaced(textures, detector, harm):
    truth = hung(1.5, 20)
    scene = hang(wall(), textures[2], truth)
    if harm == "glare":  # saturates, which moves edges
        spoilt = np.clip(1.6 * scene.rgb.astype(float), 0, 255).astype(np.uint8)
    else:
        spoilt = cv2.blur(scene.rgb, ({"slight blur": 5, "smear": 25}[harm], 1))
    result = detector.detect(spoilt, scene.xyz)
    assert set(found(result)) <= {2}
    assert harm != "slight blur" or found(result) == [2]
    for detection in result.detections:
        assert np.linalg.norm(detection.pixels - projected(truth), axis=1).max() < 5.0


@pytest.mark.slow
def test_a_large_reference_is_scaled_down_and_its_corners_stay_its_corners(textures):
    large = [cv2.resize(t, None, fx=3.1, fy=3.1, interpolation=cv2.INTER_CUBIC) for t in textures[:2]]
    truth = hung(1.5, 15)
    scene = hang(wall(), large[0], truth)
    (detection,) = Detector(large, None).detect(scene.rgb, scene.xyz).detections
    assert np.linalg.norm(detection.pixels - projected(truth), axis=1).max() < 1.0


@pytest.mark.slow
def test_the_same_frame_gives_the_same_bits_with_any_number_of_threads(textures, detector):
    scene = hang(hang(wall(), textures[0], hung(2, 30, -0.4)), textures[3], hung(2, -30, 0.4))
    expected = detector.detect(scene.rgb, scene.xyz)
    before = cv2.getNumThreads()
    try:
        cv2.setNumThreads(1)
        fresh = Detector(textures, np.full(PICTURES, PICTURE))
        again = []
        for threads in (1, 3):
            cv2.setNumThreads(threads)
            cv2.setRNGSeed(threads)
            with threadpool_limits(threads):
                again.append(fresh.detect(scene.rgb, scene.xyz))
    finally:
        cv2.setNumThreads(before)
    assert found(expected) == [0, 3]
    for result in again:
        assert result.refused == expected.refused
        for one, other in zip(expected.detections, result.detections, strict=True):
            np.testing.assert_array_equal(one.pixels, other.pixels)
            np.testing.assert_array_equal(one.points, other.points)
            assert one.inliers == other.inliers


@pytest.mark.slow
def test_frames_looked_at_together_come_in_order_with_what_each_alone_gives(textures, detector):
    frames = [hang(wall(), textures[i], hung(2, 0, 0.0)) for i in (0, 3, 1)]
    seen = list(detector.detect_each(frames))
    assert [f for f, _ in seen] == frames
    for frame, together in seen:
        alone = detector.detect(frame.rgb, frame.xyz)
        assert found(together) == found(alone) != []
        np.testing.assert_array_equal(together.detections[0].points, alone.detections[0].points)


# --- bad input and counting -------------------------------------------------------------------------------------------


def test_a_blank_reference_is_an_error_that_names_it(textures):
    blank = np.full((300, 400, 3), 200, np.uint8)
    with pytest.raises(DataError, match="reference image 2 of 2: 0 features"):
        Detector([textures[0], blank], None)


def test_input_of_the_wrong_kind_is_an_error(textures, detector):
    with pytest.raises(DataError, match="no reference images"):
        Detector([], None)
    with pytest.raises(DataError, match="3 widths for 4 reference images"):
        Detector(textures, np.ones(3))
    with pytest.raises(DataError, match="reference image 1: float64"):
        Detector([textures[0] / 255.0], None)
    with pytest.raises(DataError, match="frame: uint8 array"):
        detector.detect(np.zeros((HEIGHT, WIDTH), np.uint8))
    with pytest.raises(DataError, match="do not fit the image"):
        detector.detect(wall().rgb, wall().xyz[::2])


# --- photographs ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def lab(shared_data: Path) -> tuple[Path, Detector]:
    folder = shared_data / "lab_vision"
    if not folder.is_dir():
        pytest.skip("no photographs (../shared/data/lab_vision)")
    return folder, Detector([read(path) for path in sorted(folder.glob("object_*.jpg"))], None)


def read(path: Path) -> np.ndarray:
    return np.ascontiguousarray(cv2.imread(str(path), cv2.IMREAD_COLOR)[..., ::-1])


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["example_01", "example_02", "example_03"])
def test_in_a_photograph_the_listed_print_is_found_and_nothing_else(lab, scene):
    folder, detector = lab
    place, name = (folder / f"{scene}.sol").read_text().split("\n")[:2]
    row, column = (float(n) for n in place.split())
    result = detector.detect(read(folder / f"{scene}.png"))
    assert found(result) == [int(name.strip().removeprefix("object_")) - 1]
    (detection,) = result.detections
    assert np.linalg.norm(detection.pixels[0] - [column, row]) < 10.0
    assert detection.inliers > 78
