"""`slamref detect` finds the print in a photo, says where, and outlines it."""

import re

import cv2
import numpy as np
import pytest

from wings.camera.detect import main


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
