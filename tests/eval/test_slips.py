"""Where a user slips: every unknown name gets the nearest known one, every wrong value the right form, in one line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import slamref
from data.errors import UsageError
from tests.data.formats.mrclam import world
from tests.data.formats.mrclam.world import save_folder, save_zip

ROOT = Path(__file__).parents[2]
ODOMETRY, SEEN = "t,v,omega\n0,1,0\n1,1,0\n", "t,range,bearing\n0,2,0\n1,2,0.1\n"
TABLE = "convert table odo.csv out --observations seen.csv --odometry-sigma .05,.02 --observation-sigma .1,1deg"


@pytest.fixture
def said(tmp_path, monkeypatch, capsys):
    """What a command line says, in one line, before it ends with status 2."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "odo.csv").write_text(ODOMETRY)
    (tmp_path / "seen.csv").write_text(SEEN)

    def run(line: str) -> str:
        try:
            status = slamref.main(line.split())
        except SystemExit as stop:  # a parser's
            status = stop.code
        captured = capsys.readouterr()
        assert status == 2, captured
        assert captured.err.count("\n") == 1
        return captured.err

    return run


@pytest.mark.parametrize(("line", "hint"), [
    ("run arena:0 --estimator EKF", "did you mean ekf?"),
    ("run arena:0 --estimator ekf,BATCH", "did you mean batch?"),
    ("run arena:0 --association JCBB", "did you mean jcbb?"),
    ("run arena:0 --task SLAM", "did you mean slam?"),
    ("run arena:0 --calibrate scal", "did you mean scale?"),
    ("run arena:0 --estimators ekf", "did you mean --estimator?"),
    ("run arena:0 --out-put r", "did you mean --out?"),
    ("run coridor:3", "Did you mean corridor:3?"),
    ("run arena", "the seed is missing, as in arena:0"),
    ("run corridor:0:peopel", "did you mean people?"),
    ("run arena:0:landmark=3", "did you mean landmarks?"),
    ("run arena:0:sensor=relative-point", "did you mean relative_point?"),
    ("run corridor:0:people,no-odometry", "as in corridor:0:people+no-odometry"),
    ("run corridor:0:range=8,people", "as in corridor:0:range=8+people"),
    ("run corridor:0:frames=8,people", "as in corridor:0:frames=8+people"),
    ("run arena:0 --gate 9.21", "is --gate 0.99"),
    ("run arena:0 --gate 5.99", "is --gate 0.95"),
    ("run arena:0 --new-gate 99.9", "99.9 % is --new-gate 0.999"),
    ("run arena:0 --gate-known 13.8", "is --gate-known 0.999"),
    ("run arena:0 --gate high", "a number is needed, as in --gate 0.5"),
    ("run arena:0 --seed x", "a whole number is needed, as in --seed 1"),
    ("run arena:0 --estimator", "a value is needed: --estimator LIST"),
    ("run odo.csv", "type slamref convert table odo.csv LOG"),
    ("study aren", "did you mean arena?"),
    ("study Corridor", "did you mean corridor?"),
    ("study corridor --runs many", "a whole number is needed, as in --runs 1"),
    ("lab coridor:3", "did you mean corridor:3?"),
    ("lab corridor", "did you mean corridor:0?"),
    ("step arena:0 --lab", "did you mean --lab-text?"),
    ("step arena:0 --estimator Ekf", "did you mean ekf?"),
    ("play arena:0 --association Jcbb", "did you mean jcbb?"),
    ("check EKF", "did you mean ekf?"),
    ("tune arena:0 out --fit nosie", "unknown"),
    ("convert coridor out", "did you mean corridor?"),
    ("convert arena out --seeds 3", "did you mean --seed?"),
    ("convert arena out --frames lots", "lots: a whole number is needed"),
    ("convert arena out --side wide", "wide: a number is needed"),
    ("live --link /dev/x --out y --drive wals", "did you mean walls?"),
    (f"{TABLE} --unit time=msec", "did you mean ms?"),
    (f"{TABLE} --unit bearings=deg", "did you mean bearing?"),
    (f"{TABLE} --columns omga=omega", "did you mean omega?"),
    (f"{TABLE} --columns odometri.t=t", "did you mean odometry?"),
    (f"{TABLE} --columns omega=omga", "did you mean omega?"),
    (f"{TABLE} --odometry-kind velocity", "did you mean velocities?"),
    (f"{TABLE} --odometry-noise densty", "did you mean density?"),
    (f"{TABLE} --unit v=m", "did you mean m/s?"),
    (f"{TABLE} --unit v=kmh", "did you mean km/h?"),
    (f"{TABLE} --unit omega=deg", "did you mean deg/s?"),
    (f"{TABLE} --tick-wrap 65536", "of wheel ticks; the odometry has velocities"),
    ("run arena:0 -estimator ekf", "did you mean --estimator?"),
    ("run arena0", "Did you mean arena:0?"),
    ("runn arena:0", "Did you mean run?"),
    ("Run arena:0", "Did you mean run?"),
    ("benchmark quick", "a word too many"),
])  # fmt: skip
def test_a_slip_is_answered_with_what_is_right(said, line, hint):
    assert hint in said(line)


def test_flags_are_never_abbreviated_and_a_value_may_begin_with_a_minus(said, tmp_path):
    assert "--lab: unknown flag" in said("step arena:0 --lab")
    assert slamref.main(f"{TABLE} --view -1,0.75".split()) == 0
    assert slamref.main(f"{TABLE} --view -60deg,60deg".split()) == 0
    assert "the smaller bearing first" in said(f"{TABLE} --view 1,-0.75")


def test_every_command_line_is_read_by_the_parser_that_knows_no_abbreviations():
    for folder in ("data", "eval", "graph", "association", "ekf", "tests"):
        for path in (ROOT / folder).rglob("*.py"):
            if path not in (ROOT / "data/command.py", Path(__file__)):
                assert "argparse.ArgumentParser(" not in path.read_text(), path


def test_a_recording_that_is_no_log_is_answered_with_its_conversion(said, tmp_path):
    save_zip(tmp_path / "set.zip", world.texts())
    save_folder(tmp_path / "set", world.texts())
    for command in ("run", "run --log", "step", "play"):
        for source in ("set.zip", "set"):
            assert f"type slamref convert mrclam {source} LOG --robot 1" in said(f"{command} {source}")


@pytest.mark.parametrize("command", ["play", "run", "step", "inspect"])
def test_a_result_folder_is_no_log_and_names_its_logs(command, said, tmp_path):
    (tmp_path / "r").mkdir()
    (tmp_path / "r/provenance.json").write_text(json.dumps({"inputs": {"arena:0": {}, "my_log": {}}}))
    text = said(f"{command} r")
    assert "a result folder; type slamref report r, or name one of its logs: arena:0, my_log" in text


def test_python_names_the_nearest_too():
    inputs = slamref.open_log("arena:0:frames=4").inputs(labels=True)
    for function, hint in (
        (lambda: slamref.compare(inputs, "slam", ["EKF"]), "did you mean ekf?"),
        (lambda: slamref.compare(inputs, "SLAM", ["ekf"]), "did you mean slam?"),
        (lambda: slamref.compare(inputs, "slam", ["ekf"], "JCBB"), "did you mean jcbb?"),
        (lambda: slamref.compare(slamref.open_log("arena:0"), "slam", ["ekf"]), r"log\.inputs\(labels=True\)"),
    ):
        with pytest.raises(UsageError, match=hint.replace("?", r"\?")):
            function()
