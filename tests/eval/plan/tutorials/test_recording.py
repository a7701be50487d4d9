"""A tutorial's variant is of a recording that a log was converted from, and of no other log."""

from __future__ import annotations

from dataclasses import replace

import pytest

from data.digest import file_sha256
from data.errors import UsageError
from data.formats.mrclam.load import Treatment, load_mrclam
from eval.plan.flags.options import read_options
from eval.plan.tutorials import ABOUT, is_tutorial, original_of, variant_log
from eval.referee.score import Trial
from tests.data.formats.mrclam import world
from tests.data.formats.mrclam.world import exchange, save_zip
from tests.eval.handmade import circle_log

VARIANT = read_options(["--config", "tutorial-step1"]).variants[0]


def test_a_log_from_elsewhere_is_refused_with_how_to_make_one():
    with pytest.raises(UsageError, match="does not come from a UTIAS MRCLAM recording"):
        variant_log(circle_log(), VARIANT)


@pytest.mark.parametrize("key", ["file", "path"])
def test_a_recording_that_is_gone_is_said_to_be(key, tmp_path):
    gone = {"file": "gone.zip", "path": str(tmp_path / "gone.zip")}[key]
    log = replace(circle_log(), source={"kind": "mrclam", key: gone, "robot": 3})
    with pytest.raises(UsageError, match=r"gone\.zip, which log .* is neither here nor beside the log"):
        variant_log(log, VARIANT, [tmp_path])


def test_the_original_program_s_numbers_are_known_where_the_log_has_them():
    trial = Trial(replace(circle_log(), source={"original": [12.5, 0.3]}), "slam", ())
    assert original_of(trial) == (12.5, 0.3)
    assert original_of(Trial(circle_log(), "slam", ())) is None
    assert is_tutorial(replace(trial, about=ABOUT))
    assert not is_tutorial(trial)


def test_the_original_s_numbers_stand_where_its_landmark_file_was_used_and_nowhere_else(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    source = save_zip(tmp_path / "MRCLAM_Dataset77.zip", world.texts())
    corrected = tmp_path / "corrected.dat"
    corrected.write_text(exchange(world.texts()["Landmark_Groundtruth.dat"], 11, 17))
    variant = replace(
        VARIANT,
        start=None,
        original=(12.5, 0.3),
        original_log="MRCLAM_Dataset77, robot 1",
        original_landmarks=file_sha256(corrected),
    )

    def original(treatment):
        return original_of(Trial(variant_log(load_mrclam(source, 1, treatment), variant), variant.task, ()))

    assert original(Treatment(landmarks=corrected)) == (12.5, 0.3)
    assert original(Treatment()) is None
    assert original(Treatment(landmarks=corrected, stop=9.0)) is None
