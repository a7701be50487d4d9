"""`slamref camera` prints K beside its prior and, of a rendered recording, its truth; and says what it cannot do."""

from __future__ import annotations

import io
import re
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import data.logs
from data.log import Log
from data.pictures import Evidence, Found
from tests.eval.handmade import circle_log
from tests.wings.camera.camera_study import drawn, true_camera
from wings.camera.command import main
from wings.camera.gallery import Gallery, gallery

SMALL = Gallery(duration=20.0, rate=2.0)


def recorded(some: slice = slice(None)) -> Log:
    """A log with drawn pixels as what was found in images of 640 x 480."""
    log, _, seen = drawn(0, 0.2, SMALL)
    setup, n, D = gallery(SMALL, 0).setup, len(log.recorded), len(seen.frame[some])
    content = io.BytesIO()
    Image.new("RGB", (640, 480)).save(content, "PNG")
    found = Found(
        log.recorded.time, np.zeros(n), np.zeros(n), seen.frame[some], seen.picture[some], np.full(D, 50),
        seen.pixels[some], np.full((D, 4, 3), np.nan), ({},) * 8, ((0, content.getvalue()),), 554.0, 0.1, 0.01,
    )  # fmt: skip
    return replace(log, evidence=Evidence(setup, found))


@pytest.fixture
def opened(monkeypatch):
    def install(log: Log) -> None:
        monkeypatch.setattr(data.logs, "open_log", lambda name, reading, say: log)

    return install


def test_focal_length_and_centre_are_printed_with_three_sigma_beside_prior_and_truth(opened, capsys):
    opened(recorded())
    assert main(["visual:0"]) == 0
    out = capsys.readouterr().out
    truth = true_camera(SMALL)
    for name, true, prior in zip(("focal length", "centre u", "centre v"), truth, ("640.0", "319.5", "239.5")):
        value, sigma, said, rendered = re.search(
            rf"{name} +([\d.]+) ± ([\d.]+) px \(prior ([\d.]+) ± \d+, rendered with ([\d.]+)\)", out
        ).groups()
        assert said == prior
        assert float(rendered) == pytest.approx(true, abs=0.006)
        assert abs(float(value) - true) < 1.5 * float(sigma)
        assert float(sigma) < 40.0
    assert "the stereo points imply a focal length of 554.00 px" in out
    assert float(re.search(r"residuals: RMS ([\d.]+) of", out)[1]) == pytest.approx(1.0, abs=0.15)
    assert float(re.search(r"NEES of K: ([\d.]+)", out)[1]) < 16.3
    assert float(re.search(r"position RMSE .*: ([\d.]+) m", out)[1]) < 0.05


def test_a_folder_s_camera_is_estimated_without_a_truth(opened, capsys):
    opened(recorded())
    assert main(["my_lab", "--pixel-sigma", "0.4"]) == 0
    out = capsys.readouterr().out
    assert "rendered with" not in out
    assert "NEES" not in out
    assert float(re.search(r"residuals: RMS ([\d.]+) of", out)[1]) == pytest.approx(0.5, abs=0.1)


@pytest.mark.parametrize(
    ("log", "words", "said"),
    [
        (circle_log(), [], "has no images; visual:SEED and folders of the visual lab have"),
        (None, [], "no picture was found in any image"),
        (circle_log(), ["--pixel-sigma", "0"], "--pixel-sigma 0: a number from 0.001 to 100"),
        (circle_log(), ["--pixel-sigma", "much"], "--pixel-sigma much: a number from 0.001 to 100"),
    ],
)
def test_what_it_cannot_do_is_said_in_a_line(log, words, said, opened, capsys):
    opened(log or recorded(slice(0)))
    assert main(["visual:0", *words]) == 2
    error = capsys.readouterr().err.strip()
    assert said in error
    assert "\n" not in error
