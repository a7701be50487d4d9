"""Pictures are found with identity and corners; one that is not wholly and certainly there is refused by name.

`slamref detect` finds the print in a photo, says where, and outlines it.
"""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from threadpoolctl import threadpool_limits

import wings.camera.detector as checks
from data.errors import DataError
from tests.wings.camera.wall import (
    CENTRE,
    FOCAL,
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
from wings.camera.detect import main
from wings.camera.detector import FEW_INLIERS, NOT_SEEN, SAME_PLACE, UNCERTAIN, Detector


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


def test_input_of_the_wrong_kind_is_an_error(textures, detector):
    with pytest.raises(DataError, match="reference image 2 of 2: 0 features"):
        Detector([textures[0], np.full((300, 400, 3), 200, np.uint8)], None)
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


@pytest.mark.slow
@pytest.mark.parametrize("x", [-0.95, -0.75, 0.75])
def test_a_picture_that_is_partly_outside_the_image_is_refused(textures, detector, x):
    truth = hung(1.5, 0, x=x)
    assert np.any(projected(truth) < 0) or np.any(projected(truth) > WIDTH - 1)
    scene = hang(wall(), textures[1], truth)
    result = detector.detect(scene.rgb, scene.xyz)
    assert found(result) == []
    assert reason(result, 1) in (checks.OUTSIDE, NOT_SEEN)


@pytest.mark.parametrize("kind", ["black", "wall", "noise"])
def test_nothing_is_found_where_nothing_hangs(detector, kind):
    noise = np.random.default_rng(5).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    image = {"black": np.zeros((HEIGHT, WIDTH, 3), np.uint8), "wall": wall().rgb, "noise": noise}[kind]
    result = detector.detect(image, wall().xyz)
    assert found(result) == []
    assert [reason for _, reason in result.refused] == [NOT_SEEN] * PICTURES


def test_neither_an_unknown_picture_nor_a_mirrored_one_is_taken_for_a_known_one(textures, detector):
    for image, distance in ((texture(99), 1.2), (np.ascontiguousarray(textures[1][:, ::-1]), 1.5)):
        scene = hang(wall(), image, hung(distance))
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


def test_a_picture_of_which_only_a_part_can_be_seen_has_no_certain_corners_and_a_glimpse_is_no_sight(
    textures, sizeless
):
    truth = hung(0.8)
    scene = hang(wall(), textures[0], truth)
    u, v = np.rint(projected(truth)[0]).astype(int)
    shown = np.zeros((HEIGHT, WIDTH, 1), bool)
    shown[v : v + 125, u : u + 110] = True
    assert reason(sizeless.detect(np.where(shown, scene.rgb, wall().rgb)), 0) == UNCERTAIN
    u, v = np.rint(projected(truth).mean(axis=0)).astype(int)
    for size, expected in ((30, NOT_SEEN), (60, NOT_SEEN), (80, FEW_INLIERS)):
        glimpse = wall().rgb
        glimpse[v : v + size, u : u + size] = scene.rgb[v : v + size, u : u + size]
        assert reason(sizeless.detect(glimpse), 0) == expected


def test_a_picture_whose_pieces_are_shuffled_is_refused(textures, sizeless):
    pieces = [tile for row in np.split(textures[0], 6) for tile in np.split(row, 6, axis=1)]
    order = np.random.default_rng(0).permutation(36)
    shuffled = np.vstack([np.hstack([pieces[i] for i in row]) for row in order.reshape(6, 6)])
    assert found(sizeless.detect(hang(wall(), shuffled, hung(0.8)).rgb)) == []


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
    for xyz in (scene.xyz, np.full_like(scene.xyz, np.nan), np.zeros_like(scene.xyz)):
        assert reason(detector.detect(scene.rgb, xyz), 0) == checks.NO_DEPTH


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


SIZE = (400, 500)
SHAPES = {
    "as it hangs": ([[100, 100], [300, 110], [290, 250], [105, 240]], None),
    "upside down": ([[300, 250], [100, 250], [100, 100], [300, 100]], None),
    "mirrored": ([[300, 100], [100, 100], [100, 250], [300, 250]], checks.MIRRORED),
    "crossed": ([[100, 100], [300, 100], [100, 250], [300, 250]], checks.NOT_CONVEX),
    "one corner inside": ([[100, 100], [300, 100], [150, 140], [100, 250]], checks.NOT_CONVEX),
    "tiny": ([[100, 100], [115, 100], [115, 112], [100, 112]], checks.IMPLAUSIBLE_SHAPE),
    "a sliver": ([[100, 100], [130, 100], [130, 300], [100, 300]], checks.IMPLAUSIBLE_SHAPE),
    "a triangle": ([[190, 100], [210, 100], [300, 250], [100, 250]], checks.IMPLAUSIBLE_SHAPE),
    "a kite": ([[100, 200], [260, 150], [420, 200], [260, 210]], checks.IMPLAUSIBLE_SHAPE),
    "cut off": ([[-20, 100], [180, 100], [180, 250], [-20, 250]], checks.OUTSIDE),
    "below the frame": ([[100, 300], [300, 300], [300, 420], [100, 420]], checks.OUTSIDE),
}


@pytest.mark.parametrize("name", SHAPES)
def test_a_quadrilateral_is_judged_by_its_shape(name):
    pixels, expected = SHAPES[name]
    assert checks.shape_fault(np.array(pixels, float), SIZE, 0.8) == expected


def test_overlap_is_the_share_of_the_smaller_one():
    square = np.array([[0.0, 0], [10, 0], [10, 10], [0, 10]])
    assert checks.overlap(square, square + [5.0, 0.0]) == pytest.approx(0.5)
    assert checks.overlap(square, 0.5 * square + 1.0) == pytest.approx(1.0)
    assert checks.overlap(square, square + [20.0, 0.0]) == 0.0


def test_the_camera_is_read_off_its_stereo_points():
    camera = checks.pinhole(wall().xyz)
    pixels = np.array([[0.0, 0], [639, 479], [12.5, 300]])
    np.testing.assert_allclose(camera[:, 0] * pixels + camera[:, 1], (pixels - CENTRE) / FOCAL, atol=1e-6)
    assert checks.pinhole(np.full((HEIGHT, WIDTH, 3), np.nan, np.float32)) is None


def test_a_third_of_wrong_depths_does_not_move_the_plane():
    rng = np.random.default_rng(8)
    pixels = rng.uniform(100, 300, (600, 2))
    plane = np.array([4e-4, -2e-4, 0.4])
    depth = 1 / (pixels @ plane[:2] + plane[2])
    depth[:200] *= rng.uniform(1.3, 2.0, 200)
    np.testing.assert_allclose(checks.fit_plane(pixels, depth), plane, rtol=1e-6)


def test_refinement_finds_the_exact_homography_despite_wrong_pairs():
    rng = np.random.default_rng(2)
    truth = np.array([[0.5, 0.05, 120.0], [-0.03, 0.45, 90.0], [2e-4, -1e-4, 1.0]])
    place = rng.uniform(0, 480, (60, 2))
    source = checks.Features(place, np.full(60, 3.0), np.zeros((60, 128), np.float32))
    seen = checks.project(truth, place)
    seen[:10] += 8.0
    target = checks.Features(seen, np.full(60, 1.5), source.descriptor)
    fit = checks.refine(truth + np.array([[0, 0, 0.5], [0, 0, -0.5], [0, 0, 0]]), source, target)
    np.testing.assert_allclose(fit.H, truth, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(fit.inlier, np.arange(60) >= 10)


def test_the_stated_uncertainty_of_corners_is_their_scatter():
    rng = np.random.default_rng(4)
    truth = np.array([[0.5, 0.05, 120.0], [-0.03, 0.45, 90.0], [2e-4, -1e-4, 1.0]])
    place, scale = rng.uniform(150, 480, (40, 2)), np.full(40, 4.0)
    corners = np.array([[0.0, 0.0], [480, 360]])
    source = checks.Features(place, scale, np.zeros((40, 128), np.float32))
    sigma = 0.1 * np.hypot(2.0, checks.magnification(truth, place) * 4.0)
    errors, stated = [], []
    for _ in range(300):
        seen = checks.project(truth, place) + rng.normal(size=(40, 2)) * np.maximum(sigma, 0.25)[:, None]
        fit = checks.refine(truth, source, checks.Features(seen, np.full(40, 2.0), source.descriptor))
        pixels = checks.project(fit.H, corners)
        errors.append(pixels - checks.project(truth, corners))
        stated.append(checks.corner_sigma(fit, corners, pixels))
    scatter = [np.sqrt(np.linalg.eigvalsh(np.cov(np.array(errors)[:, i].T))[-1]) for i in range(2)]
    np.testing.assert_allclose(np.mean(stated, axis=0), scatter, rtol=0.2)
    assert scatter[0] > 2 * scatter[1], "the corner beyond the features is the uncertain one"


def corners(text: str) -> np.ndarray:
    return np.array([[float(v) for v in pair] for pair in re.findall(r"\((-?[\d.]+), (-?[\d.]+)\)", text)])


def test_the_print_in_a_photo_is_found_where_its_solution_has_it(shared_data, tmp_path, capsys):
    folder, out = shared_data / "lab_vision", tmp_path / "found.png"
    names = ["object_03.jpg", "object_02.jpg"]
    assert main([str(folder / "example_01.png"), *(str(folder / n) for n in names), "--out", str(out)]) == 0
    lines = capsys.readouterr().out.rstrip().split("\n")
    assert lines[0] == "example_01.png: 1 of 2 pictures found"
    assert lines[1].startswith("object_02.jpg: corners")
    assert re.fullmatch(r"object_03\.jpg: [a-z ]+", lines[2]), "why it was not"
    row, column = (float(v) for v in (folder / "example_01.sol").read_text().split()[:2])
    found = corners(lines[1])
    assert found[0] == pytest.approx([column, row], abs=10.0)  # the solution is good to about 10 px
    features, rms, sigma = (float(v) for v in re.findall(r"px; (\d+) .*?RMS ([\d.]+) px.*?σ ([\d.]+) px", lines[1])[0])
    assert features > 50
    assert 0.1 < rms < 2.0
    assert 0.05 < sigma < 2.0
    before, after = cv2.imread(str(folder / "example_01.png")), cv2.imread(str(out))
    assert after.shape[:2] == (2 * before.shape[0], 2 * before.shape[1]), "small photos are enlarged"
    yellow = np.all(np.abs(after.astype(int) - [66, 228, 240]) < 30, axis=2)
    for u, v in (2 * (found + 0.5) - 0.5).round().astype(int):
        assert yellow[v - 2 : v + 3, u - 2 : u + 3].any()


@pytest.mark.slow
def test_corners_are_in_the_photo_s_own_pixels_however_large_it_is(shared_data, tmp_path, capsys):
    folder = shared_data / "lab_vision"
    photo = cv2.imread(str(folder / "example_01.png"))
    cv2.imwrite(str(tmp_path / "large.png"), cv2.resize(photo, None, fx=4.0, fy=4.0, interpolation=cv2.INTER_CUBIC))
    found = []
    for path in (folder / "example_01.png", tmp_path / "large.png"):
        assert main([str(path), str(folder / "object_02.jpg")]) == 0
        found.append(corners(capsys.readouterr().out))
    assert found[1] == pytest.approx(4.0 * (found[0] + 0.5) - 0.5, abs=8.0)


@pytest.mark.parametrize(("make", "words"), [
    (lambda p: (p / "a.png").write_text("x"), "not an image"), (lambda p: None, "cannot be read"),
])  # fmt: skip
def test_what_is_no_image_is_said_in_a_line(make, words, tmp_path, refused):
    make(tmp_path)
    assert words in refused(main, [str(tmp_path / "a.png"), str(tmp_path / "a.png")])


def test_a_picture_goes_into_a_png(tmp_path, refused):
    assert "a file name that ends in .png" in refused(main, ["a.jpg", "b.jpg", "--out", str(tmp_path / "c.jpg")])
