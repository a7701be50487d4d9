"""The camera's images in the player: which frames have one, and corners as they were found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from data.log import shortened
from eval.player.pack import unpacked
from eval.player.scene import scene
from eval.referee.score import Trial
from eval.replay.settings import Setup
from tests.eval.handmade import circle_log
from tests.wings.camera.report.handmade import GREY, evidence

SMALL = ((0, b"first"), (2, b"second"), (4, b"third"))


def camera_log(small=SMALL):
    made = evidence()
    return replace(circle_log(), evidence=replace(made, found=replace(made.found, small=small)))


def test_small_images_and_corners_are_those_of_the_recording():
    log = camera_log()
    chunk = scene([Trial(log, "localization", ())], Setup())
    assert chunk["camera"] == {
        "width": GREY.shape[1],
        "frames": [0, 2, 4],
        "images": ["Zmlyc3Q=", "c2Vjb25k", "dGhpcmQ="],
    }
    arrays, found = unpacked(chunk), log.evidence.found
    assert arrays["camera_frame"][:, 0].tolist() == found.frame.tolist()
    assert arrays["camera_picture"][:, 0].tolist() == found.picture.tolist()
    np.testing.assert_allclose(arrays["camera_corners"], found.pixels.reshape(-1, 8), atol=0.13)


def test_a_player_of_the_first_frames_has_their_images_alone():
    log = shortened(camera_log(), 3)
    chunk = scene([Trial(log, "localization", ())], Setup())
    assert chunk["camera"]["frames"] == [0, 2]
    assert unpacked(chunk)["camera_frame"].max() == 2
