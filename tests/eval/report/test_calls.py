"""One call from Python gives the numbers of the command; the main numbers on the terminal; studies in words."""

from dataclasses import replace

import numpy as np
import pytest

import slamref
from data.errors import UsageError
from eval.judgement.judgement import judge
from eval.report.studies import Diverged
from eval.report.terminal import groups_of, lines
from eval.report.words import say
from eval.studies.scenario import load_scenario

WORLD = "arena:{}:frames=30"


def make(seed):
    return slamref.open_log(WORLD.format(seed))


def test_logs_of_different_length_have_verdicts_but_no_common_time():
    found = slamref.study([make(0), slamref.open_log("arena:1:frames=20")], ["ekf"], task="localization")
    assert len(found.runs) == 2
    with pytest.raises(UsageError, match="differ in length"):
        found.figure()


@pytest.mark.parametrize(("world", "message"), [
    (lambda seed: 1, "returned int"), ([], "at least one log"), ("./nowhere.py:make", "there is no file"),
])  # fmt: skip
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
    np.testing.assert_array_equal(load_scenario("own.toml").simulate(3).truth.pose, make(3).truth.pose)
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
    assert slamref.score_files(estimate, truth)["rmse_position_m"] == pytest.approx(0.5)
    assert slamref.score_files(estimate, truth, align="se2")["rmse_position_m"] == pytest.approx(0.0, abs=1e-9)
    with pytest.raises(UsageError, match="alignment: unknown; known: cov, "):
        slamref.score_files(estimate, truth, alignment="se2")


def trials(*names: str, task: str = "slam", estimators=("dead-reckoning", "ekf", "isam2", "batch")):
    made = []
    for name in names:
        log = slamref.open_log(name)
        runs = slamref.compare(log.inputs(labels=True).without_map(), task, estimators)
        made.append(slamref.Trial(log, task, tuple(runs)))
    return made


def groups(*names: str):
    made = trials(*names)
    scores = slamref.score(made)
    return groups_of([(t, judge(t, scores)) for t in made], scores, (), ())


def lines_of(*names: str) -> list[str]:
    return lines(groups(*names))


def test_one_log_is_named_once_and_every_run_has_its_numbers():
    title, head, *rows, means, verdict, phases = lines_of("arena:0:frames=30")
    assert title == "arena:0:frames=30, SLAM"
    assert head.split() == ["estimator", "association", "RMSE", "[m]", "NEES", "NIS", "verdict", "wrong"]
    assert [row.split(",")[0].split()[0] for row in rows] == ["dead-reckoning", "ekf", "isam2", "batch"]
    assert "batch, final " in rows[3]
    assert phases.startswith("(online: ")
    scores = slamref.score(trials("arena:0:frames=30")).metrics.set_index(["estimator", "phase"])
    shown = rows[1].replace("ekf, online", "ekf").split()
    assert float(shown[2]) == pytest.approx(scores["rmse_position_m"]["ekf", "online"], rel=0.01)
    assert shown[5:7] == ["innovations", "fit"]
    assert rows[1].endswith(f"0 of {scores['accepted']['ekf', 'online']}")
    assert "expected 3" in means
    assert verdict.startswith("(verdict: ")


def test_what_diverged_is_listed_once_with_what_replays_it():
    run = Diverged("slam", "ekf", "nn", 3, "frame 7: lost", False, "python -m eval.run_all --seed 3")
    doubtful = replace(run, seed=4, implausible=True)
    assert say("studies#diverged", lost=()) == "Every run of every estimator reached its end."
    assert say("studies#diverged", lost=(run, run)) == (
        "2 runs diverged; they are in no average:\n\n"
        "* seed 3: `ekf` (slam, nn), frame 7: lost: `python -m eval.run_all --seed 3`"
    )
    both = say("studies#diverged", lost=(run, doubtful))
    assert both.startswith("2 runs diverged or are implausible; they are in no average:\n\n* seed 3:")
    assert "* seed 4: `ekf` (slam, nn), implausible, frame 7: lost:" in both
    many = say("studies#diverged", lost=tuple(replace(run, seed=n) for n in range(23)))
    assert many.endswith("* … and 3 more")
    assert many.count("\n* seed") == 20
