"""One call from Python gives the numbers of the command: studies of own worlds, and the diagnosis of a log."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import slamref
from data.errors import UsageError
from ekf.localizer import EkfLocalizer
from eval.studies.scenario import load_scenario

WORLD = "arena:{}:frames=30"


def make(seed):
    return slamref.open_log(WORLD.format(seed))


class Mine(EkfLocalizer):
    pass


def test_a_study_of_an_own_world_is_that_of_the_same_logs():
    by_seed = slamref.study(make, ["ekf"], task="localization", runs=3, seed=4)
    listed = slamref.study([make(4), make(5), make(6)], ["ekf"], task="localization")
    pd.testing.assert_frame_equal(by_seed.runs.drop(columns="seed"), listed.runs.drop(columns="seed"))
    assert by_seed.runs.seed.tolist() == [4, 5, 6]


def test_an_estimator_of_ones_own_is_judged_as_ours():
    found = slamref.study(make, ["ekf", Mine], task="localization", runs=3)
    ours, own = (found.runs[found.runs.estimator == name].rmse_position_m.tolist() for name in ("ekf", "Mine"))
    assert ours == own
    assert set(found.verdicts.estimator) == {"ekf", "Mine"}
    (drawn,) = found.figure().axes
    assert "NEES" in drawn.get_ylabel()


def test_logs_of_different_length_have_verdicts_but_no_common_time():
    found = slamref.study([make(0), slamref.open_log("arena:1:frames=20")], ["ekf"], task="localization")
    assert len(found.runs) == 2
    with pytest.raises(UsageError, match="differ in length"):
        found.figure()


@pytest.mark.parametrize(
    ("world", "message"),
    [(lambda seed: 1, "returned int"), ([], "at least one log"), ("./nowhere.py:make", "there is no file")],
)
def test_a_world_that_makes_no_log_is_refused_by_name(world, message):
    with pytest.raises(UsageError, match=message):
        slamref.study(world, ["ekf"], runs=2)


def test_a_scenario_may_name_a_world_of_ones_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(
        "import slamref\ndef make(seed):\n    return slamref.open_log(f'arena:{seed}:frames=30')\n"
    )
    text = 'about = "own"\nworld = "./mine.py:make"\n[estimators]\nekf = {}\n'
    (tmp_path / "own.toml").write_text(text)
    scenario = load_scenario("own.toml")
    np.testing.assert_array_equal(scenario.simulate(3).truth.pose, make(3).truth.pose)
    (tmp_path / "own.toml").write_text(text.replace(":make", ":other"))
    with pytest.raises(UsageError, match="no 'other' in"):
        load_scenario("own.toml")


@pytest.mark.slow
def test_replicates_in_python_accept_a_sound_log():
    found = slamref.twins(make(1), ["ekf"], task="localization", count=19)
    assert found.cause == "nothing"
    assert found.p > 0.05
    assert "19 bootstrap replicates" in found.words()
    assert set(found.table.estimator) == {"ekf", "batch"}


def test_files_are_scored_as_by_the_command(tmp_path):
    for name, shift in (("estimate.tum", 0.5), ("truth.tum", 0.0)):
        lines = (f"{t} {t} {0.1 * t * t + shift} 0 0 0 0 1\n" for t in range(9))
        (tmp_path / name).write_text("".join(lines))
    estimate, truth = tmp_path / "estimate.tum", tmp_path / "truth.tum"
    found = slamref.score_files(estimate, truth)
    assert found["rmse_position_m"] == pytest.approx(0.5)
    assert slamref.score_files(estimate, truth, align="se2")["rmse_position_m"] == pytest.approx(0.0, abs=1e-9)
    with pytest.raises(UsageError, match="alignment: unknown; known: cov, "):
        slamref.score_files(estimate, truth, alignment="se2")
