"""A lab folder that is written is read, is what scipy and numpy read, and leaves nothing half done."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from data.errors import DataError, UsageError
from data.inputs import Prior
from tests.wings.camera.lab.handmade import FRAMES, Made
from wings.camera.lab.folder import open_lab, write_lab


def check_written(folder: Path, made: Made) -> None:
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
    write_lab(tmp_path / "out" / "lab", Made(), form=form)
    assert sorted(p.name for p in (tmp_path / "out" / "lab").iterdir()) == ["config.mat", "landmark", f"log.{form}"]
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["lab"]
    check_written(tmp_path / "out" / "lab", Made())
    (tmp_path / "empty").mkdir()
    write_lab(tmp_path / "empty", Made(), form=form)


def test_what_is_written_is_what_scipy_and_numpy_read_in_the_files_units(tmp_path: Path) -> None:
    made = Made()
    given = list(made.frames())
    for form in ("mat", "npy", "npz"):
        write_lab(tmp_path / form, made, form=form)
    mat = scipy.io.loadmat(tmp_path / "mat" / "log.mat")["log"]
    assert mat.shape == (1, FRAMES)
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


def test_a_point_known_in_part_is_written_as_none(tmp_path: Path) -> None:
    made = Made()
    next(made.frames()).xyz[9, 9] = [1.0, np.nan, 2.0]
    write_lab(tmp_path / "lab", made)
    first = next(open_lab(tmp_path / "lab").frames())
    assert np.isnan(first.xyz[9, 9]).all()


def test_writing_refuses_a_folder_in_use_an_unknown_form_and_a_correlated_prior(tmp_path: Path) -> None:
    (tmp_path / "used").mkdir()
    (tmp_path / "used" / "thesis.tex").write_text("long work")
    with pytest.raises(DataError, match="used: exists and is not an empty folder; name another one"):
        write_lab(tmp_path / "used", Made())
    assert (tmp_path / "used" / "thesis.tex").read_text() == "long work"
    with pytest.raises(UsageError, match="'hdf5'; known: mat, npy, npz"):
        write_lab(tmp_path / "new", Made(), form="hdf5")
    correlated = Prior(np.zeros(3), np.eye(3) + 0.1)
    with pytest.raises(DataError, match="prior's covariance is not diagonal"):
        write_lab(tmp_path / "new", Made(prior=correlated))
    assert [p.name for p in tmp_path.iterdir()] == ["used"]


@pytest.mark.parametrize("form", ["mat", "npy", "npz"])
def test_a_recording_with_more_or_fewer_frames_than_it_says_leaves_nothing_behind(tmp_path: Path, form: str) -> None:
    with pytest.raises(DataError, match="has 4 frames; the stated 5"):
        write_lab(tmp_path / "lab", Made(says=5), form=form)
    with pytest.raises(DataError, match=r"frame 3 of the recording: .*; 3 frames of"):
        write_lab(tmp_path / "lab", Made(says=3), form=form)
    assert not list(tmp_path.iterdir())


def test_a_log_beyond_2_gib_is_refused_as_mat_at_the_first_frame(tmp_path: Path) -> None:
    made = Made(says=900_000)
    made.frames = lambda: iter([next(iter(Made().frames()))])  # type: ignore[method-assign]
    with pytest.raises(DataError, match=r"log.mat: 2\.\d GiB for 900000 frames; a .mat holds 2 GiB, write npy or npz"):
        write_lab(tmp_path / "lab", made)
    assert not list(tmp_path.iterdir())
