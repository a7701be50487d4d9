"""The lab's folder, read and written: images in their order, missing files, the digest, nothing half done."""

import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import scipy.io

from data.errors import DataError, UsageError
from data.inputs import Prior
from tests.wings.camera.lab import handmade
from wings.camera.lab.folder import is_lab, open_lab, write_lab


def test_reference_images_come_as_rgb_in_the_natural_order_of_their_names(tmp_path: Path) -> None:
    config = handmade.configuration()
    config["landmark"] = {"xpos": np.zeros((11, 4)), "ypos": np.tile([1.0, 0.0, 0.0, 1.0], (11, 1))}
    folder = handmade.lab(tmp_path / "lab", config)
    for i in range(11):
        blue_green_red = np.full((3, 4, 3), (7, 100, 10 * (i + 1)), np.uint8)
        cv2.imwrite(str(folder / "landmark" / f"landmark{i + 1}.png"), blue_green_red)
    (folder / "landmark" / "Thumbs.db").write_bytes(b"not an image")
    (folder / "landmark" / "._landmark1.png").write_bytes(b"left by a Mac")
    recording = open_lab(folder)
    assert [r[0, 0].tolist() for r in recording.references] == [[10 * (i + 1), 100, 7] for i in range(11)]
    assert "Thumbs.db" in recording.notes[1]


def test_an_image_that_cannot_be_read_and_a_wrong_number_of_images_are_named(tmp_path: Path) -> None:
    folder = handmade.lab(tmp_path / "lab")
    for content in (b"", b"no image at all"):
        (folder / "landmark" / "landmark2.png").write_bytes(content)
        handmade.refuse(folder, "landmark2.png: not an image that can be read")
    (folder / "landmark" / "landmark2.png").unlink()
    handmade.refuse(folder, r"settings.mat: landmark.xpos: 2 rows, but .*landmark holds 1 images \(landmark1.png\)")
    (folder / "landmark" / "landmark1.png").unlink()
    (folder / "landmark").rmdir()
    handmade.refuse(folder, r"landmark: missing; a folder with one reference image per picture")


def test_a_lab_folder_is_known_by_what_it_holds_be_it_reference_images_or_a_log_alone(tmp_path: Path) -> None:
    folder = handmade.lab(tmp_path / "lab")
    assert is_lab(folder)
    assert not is_lab(tmp_path / "nowhere")
    assert not is_lab(tmp_path)
    other = tmp_path / "other"
    other.mkdir()
    scipy.io.savemat(other / "x.mat", {"x": 1.0})
    np.save(other / "y.npy", np.zeros(3))
    np.savez(other / "z.npz", z=np.zeros(3))
    (other / "broken.mat").write_bytes(b"broken")
    assert not is_lab(other)
    (folder / "settings.mat").rename(other / "a.mat")
    assert is_lab(other)
    assert is_lab(folder)
    pictures, log, neither = tmp_path / "pictures", tmp_path / "log", tmp_path / "neither"
    (pictures / "landmark").mkdir(parents=True)
    assert is_lab(pictures)
    handmade.refuse(pictures, r"no configuration found \(there: no files\)")
    log.mkdir()
    np.savez(log / "seen.npz", **handmade.log_arrays())  # type: ignore[arg-type]
    assert is_lab(log)
    neither.mkdir()
    (neither / "landmark").write_text("a file of that name is no folder of images")
    assert not is_lab(neither)
    assert not is_lab(neither / "landmark")


def test_missing_and_doubled_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="nowhere: not a folder"):
        open_lab(tmp_path / "nowhere")
    folder = handmade.lab(tmp_path / "lab")
    (folder / "again.mat").write_bytes((folder / "settings.mat").read_bytes())
    handmade.refuse(folder, r"again.mat, settings.mat each hold a configuration; one")
    (folder / "again.mat").unlink()
    np.savez(folder / "second.npz", **handmade.log_arrays())  # type: ignore[arg-type]
    handmade.refuse(folder, r"log.mat:log, second.npz each hold a log; one")
    (folder / "second.npz").unlink()
    (folder / "log.mat").rename(tmp_path / "log.mat")
    logs = dict.fromkeys(("log", "log2"), handmade.as_structs(handmade.log_arrays()))
    scipy.io.savemat(folder / "both.mat", logs)
    handmade.refuse(folder, "both.mat:log, both.mat:log2 each hold a log; one per folder is needed")
    (folder / "both.mat").unlink()
    handmade.refuse(
        folder, r"no log found \(there: settings.mat\); a .mat with the struct array log, or a .npy or .npz"
    )
    (tmp_path / "log.mat").rename(folder / "log.mat")
    (folder / "settings.mat").unlink()
    handmade.refuse(folder, r"no configuration found \(there: log.mat\); a .mat, .npy or .npz with camera_to_body")


def test_a_file_that_does_not_open_is_named_only_if_one_is_missing(tmp_path: Path) -> None:
    folder = handmade.lab(tmp_path / "lab")
    (folder / "extra.mat").write_bytes(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + bytes(500))
    assert len(handmade.all_frames(open_lab(folder))) == handmade.FRAMES
    (folder / "extra.mat").rename(folder / "log.mat")
    handmade.refuse(folder, r"log.mat: (damaged|MATLAB 7.3 .* needs the package h5py)")


@pytest.mark.parametrize("form", handmade.LOGS)
def test_the_digest_depends_on_configuration_log_and_images_alone(tmp_path: Path, form: str) -> None:
    folder = handmade.lab(tmp_path / "lab", form=form)
    digest = open_lab(folder).digest()
    (folder / "other.txt").write_text("beside")
    folder = folder.rename(tmp_path / "moved")
    assert open_lab(folder, translation_unit="m").digest() == digest
    for name in ("settings.mat", form, "landmark/landmark2.png"):
        path = folder / name
        content = path.read_bytes()
        at = 20 if name.endswith(".mat") else len(content) - 30
        recording = open_lab(folder)
        path.write_bytes(content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :])
        assert recording.digest() != digest, name
        path.write_bytes(content)
    assert open_lab(folder).digest() == digest


@pytest.mark.parametrize(("part", "field", "value", "said"), [
    ("camera_to_body", "R", [[0, 1], [1, 0]], r"R: \[\[0.0, 1.0\], \[1.0, 0.0\]\] mirrors \(det -1\)"),
    ("camera_to_body", "R", [[0, -1.1], [1, 0]], r"R: .*-1.1.* is no rotation; R R' = I is needed"),
    ("camera_to_body", "R", np.eye(3), r"R: size 3x3; a rotation matrix, 2x2"),
    ("camera_to_body", "R", [[np.nan, 1], [1, 0]], r"R: nan is not a number.* \(element 1,1\)"),
    ("camera_to_body", "T", [1.0, 2.0, 3.0], r"T: size 1x3; 2 numbers are needed"),
    ("camera_to_body", "T", [1.0, np.inf], r"T: inf is not a number.* \(element 1,2\)"),
    ("camera_to_body", "T", None, r"camera_to_body: no field T; R, T are needed"),
    ("landmark", "xpos", np.zeros((4, 2)), r"landmark.xpos: size 4x2; a row of 4 corners per picture"),
    ("landmark", "ypos", np.zeros((3, 4)), r"landmark.ypos: size 3x4, but xpos has size 2x4"),
    ("landmark", "ypos", [[1, 0, 0, 1], [1, 0, np.nan, 1]], r"landmark.ypos: nan is not a number.* \(element 2,3\)"),
    ("landmark", "ypos", [[1, 0, 0, 1], [1, 1, 0, 0]], r"xpos\(2,:\), ypos\(2,:\): a picture without width"),
    ("landmark", "ypos", None, r"landmark: no field ypos"),
    ("landmark", "xpos", "text", r"landmark.xpos: text; numbers are needed"),
    ("landmark", "xpos", {"a": 1}, r"landmark.xpos: a struct; numbers are needed"),
    ("pose_init", "theta0", np.nan, r"theta0: nan"), ("pose_init", "x0", [1, 2], r"x0: size 1x2; one number is needed"),
    ("pose_init", "sigma_y", -3.0, r"sigma_y: -3; a standard deviation is not negative"),
    ("pose_init", "sigma_theta", None, r"no field sigma_theta; x0, y0, theta0, sigma_x, sigma_y, sigma_theta"),
    ("pose_init", None, None, r"no struct pose_init; camera_to_body, landmark, pose_init are needed"),
    ("landmark", None, [1, 2, 3], r"landmark: numbers of size 1x3; one struct is needed"),
])  # fmt: skip
def test_faults_of_the_configuration_name_field_value_and_what_would_be_right(tmp_path, part, field, value, said):
    config: dict[str, Any] = handmade.configuration()
    table, key = (config, part) if field is None else (config[part], field)
    if value is None:
        del table[key]
    else:
        table[key] = value
    handmade.refuse(handmade.lab(tmp_path / "lab", config), "settings.mat: .*" + said)


def test_a_matrix_typed_with_four_digits_is_a_rotation(tmp_path: Path) -> None:
    config = handmade.configuration()
    config["camera_to_body"]["R"] = np.array([[0.2675, -0.9636], [0.9636, 0.2675]])
    assert open_lab(handmade.lab(tmp_path / "lab", config)).setup.rotation == pytest.approx(1.3, abs=1e-4)


def check_written(folder: Path, made: handmade.Made) -> None:
    recording = open_lab(folder)
    np.testing.assert_allclose(recording.setup.rotation, made.setup.rotation, rtol=1e-14)
    np.testing.assert_allclose(recording.setup.translation, made.setup.translation, rtol=1e-14)
    np.testing.assert_allclose(recording.setup.corners, made.setup.corners, rtol=1e-14)
    np.testing.assert_allclose(recording.setup.prior.mean, made.setup.prior.mean, rtol=1e-14)
    np.testing.assert_allclose(recording.setup.prior.covariance, made.setup.prior.covariance, rtol=1e-14)
    assert len(recording.references) == 12
    for read, written in zip(recording.references, made.references):
        np.testing.assert_array_equal(read, written)
    for got, given in zip(recording.frames(), made.frames(), strict=True):
        assert (got.time, got.v, got.omega) == (given.time, given.v, given.omega)
        np.testing.assert_array_equal(got.rgb, given.rgb)
        np.testing.assert_allclose(got.xyz, given.xyz, rtol=3e-7)


@pytest.mark.parametrize("form", ["mat", "npy", "npz"])
def test_what_is_written_is_read(tmp_path: Path, form: str) -> None:
    write_lab(tmp_path / "out" / "lab", handmade.Made(), form=form)
    assert sorted(p.name for p in (tmp_path / "out" / "lab").iterdir()) == ["config.mat", "landmark", f"log.{form}"]
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["lab"]
    check_written(tmp_path / "out" / "lab", handmade.Made())
    (tmp_path / "empty").mkdir()
    write_lab(tmp_path / "empty", handmade.Made(), form=form)


def test_what_is_written_is_what_scipy_and_numpy_read_in_the_files_units(tmp_path: Path) -> None:
    made = handmade.Made()
    given = list(made.frames())
    for form in ("mat", "npy", "npz"):
        write_lab(tmp_path / form, made, form=form)
    mat = scipy.io.loadmat(tmp_path / "mat" / "log.mat")["log"]
    assert mat.shape == (1, handmade.FRAMES)
    assert mat.dtype.names == ("timestamp", "commands", "rgb", "xyz")
    npy, npz = np.load(tmp_path / "npy" / "log.npy"), np.load(tmp_path / "npz" / "log.npz")
    for i, frame in enumerate(given):
        mm = np.nan_to_num(frame.xyz * np.float32(1000.0))
        element = mat[0, i]
        assert (element["rgb"].dtype, element["xyz"].dtype) == (np.uint8, np.float32)
        assert element["timestamp"].shape == (1, 1)
        for rgb, xyz, time, commands in (
            (element["rgb"], element["xyz"], element["timestamp"], element["commands"]),
            (npy["rgb"][i], npy["xyz"][i], npy["timestamp"][i], npy["commands"][i]),
            (npz["rgb"][i], npz["xyz"][i], npz["timestamp"][i], npz["commands"][i]),
        ):
            np.testing.assert_array_equal(rgb, frame.rgb)
            np.testing.assert_allclose(xyz, mm, rtol=3e-7)
            assert time == frame.time
            np.testing.assert_array_equal(np.ravel(commands), [frame.v, frame.omega])
    config = scipy.io.loadmat(tmp_path / "mat" / "config.mat", squeeze_me=True)
    c, s = math.cos(1.2), math.sin(1.2)
    np.testing.assert_allclose(config["camera_to_body"]["R"].item(), [[c, -s], [s, c]])
    np.testing.assert_allclose(config["camera_to_body"]["T"].item(), [3.0, -20.0])
    np.testing.assert_allclose(config["landmark"]["xpos"].item(), made.setup.corners[..., 0] * 100)
    pose = config["pose_init"]
    got = [pose[name].item() for name in ("x0", "y0", "theta0", "sigma_x", "sigma_y", "sigma_theta")]
    np.testing.assert_allclose(got, [100, 200, -540 / math.pi, 100 / 3, 100 / 3, 60 / math.pi])


def test_writing_refuses_a_folder_in_use_an_unknown_form_and_a_correlated_prior(tmp_path: Path) -> None:
    (tmp_path / "used").mkdir()
    (tmp_path / "used" / "thesis.tex").write_text("long work")
    with pytest.raises(DataError, match="used: exists and is not an empty folder; name another one"):
        write_lab(tmp_path / "used", handmade.Made())
    assert (tmp_path / "used" / "thesis.tex").read_text() == "long work"
    with pytest.raises(UsageError, match="'hdf5'; known: mat, npy, npz"):
        write_lab(tmp_path / "new", handmade.Made(), form="hdf5")
    correlated = Prior(np.zeros(3), np.eye(3) + 0.1)
    with pytest.raises(DataError, match="prior's covariance is not diagonal"):
        write_lab(tmp_path / "new", handmade.Made(prior=correlated))
    assert [p.name for p in tmp_path.iterdir()] == ["used"]


@pytest.mark.parametrize("form", ["mat", "npy", "npz"])
def test_a_recording_with_more_or_fewer_frames_than_it_says_leaves_nothing_behind(tmp_path: Path, form: str) -> None:
    with pytest.raises(DataError, match="has 4 frames; the stated 5"):
        write_lab(tmp_path / "lab", handmade.Made(says=5), form=form)
    with pytest.raises(DataError, match=r"frame 3 of the recording: .*; 3 frames of"):
        write_lab(tmp_path / "lab", handmade.Made(says=3), form=form)
    assert not list(tmp_path.iterdir())


def test_a_log_beyond_2_gib_is_refused_as_mat_at_the_first_frame(tmp_path: Path) -> None:
    made = handmade.Made(says=900_000)
    made.frames = lambda: iter([next(iter(handmade.Made().frames()))])  # type: ignore[method-assign]
    with pytest.raises(DataError, match=r"log.mat: 2\.\d GiB for 900000 frames; a .mat holds 2 GiB, write npy or npz"):
        write_lab(tmp_path / "lab", made)
    assert not list(tmp_path.iterdir())
