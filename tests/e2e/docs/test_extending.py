"""docs/extending.md runs as it stands: its examples, its commands, its lines of Python."""

from __future__ import annotations

import re
import shlex
import sys
from pathlib import Path

import pandas as pd
import pytest

import slamref
from data.worlds.arena import Arena, simulate
from eval.replay.run import compare
from tests.eval.replay.external.things import Bare

PAGE = Path(__file__).parents[3] / "docs" / "extending.md"
PYTHON = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
EXAMPLES = {found[1]: code for code in PYTHON if (found := re.match(r"# (\w+\.py)\n", code))}
(COMMANDS,) = re.findall(r"```sh\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
(STUDY,) = re.findall(
    r"```python\n(.*?)```", (PAGE.parent / "scenarios.md").read_text(encoding="utf-8"), flags=re.DOTALL
)
NAMES = {"ukf.py": "Ukf", "particles.py": "Particles", "my_singles.py": "my_singles"}


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    for name, code in EXAMPLES.items():
        (tmp_path / name).write_text(code, encoding="utf-8")
    return tmp_path


def test_the_examples_do_as_well_as_ours():
    log = simulate(Arena(frames=12), 3)
    names = ("ekf", "u=./ukf.py:Ukf", "p=./particles.py:Particles")
    runs = compare(log.inputs(labels=True), "localization", names)
    runs += compare(log.inputs(), "localization", names[:2], "s=./my_singles.py:my_singles")
    runs += compare(log.inputs(), "localization", names[:1], "singles")
    scored = slamref.score([slamref.Trial(log, "localization", tuple(runs))]).metrics
    scored = scored.set_index(["estimator", "association"])
    rmse, nees = scored["rmse_position_m"].astype(float), scored["nees_pose"].astype(float)
    assert rmse["u", "known"] == pytest.approx(rmse["ekf", "known"], rel=0.05)
    assert rmse["p", "known"] == pytest.approx(rmse["ekf", "known"], rel=0.2)
    assert nees["p", "known"] == pytest.approx(nees["ekf", "known"], rel=0.3)
    assert rmse["ekf", "s"] == rmse["ekf", "singles"]
    assert rmse["u", "s"] == pytest.approx(rmse["ekf", "s"], rel=0.05)


def test_the_students_association_passes_the_checks():
    slamref.check_association("./my_singles.py:my_singles")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ukf.py", "particles.py"])
def test_the_estimators_pass_the_checks(name):
    slamref.check_estimator(f"./{name}:{NAMES[name]}")


@pytest.mark.slow
def test_the_commands_run_as_written(here, capsys):
    for line in COMMANDS.strip().splitlines():
        program, *words = shlex.split(line)
        assert program == "slamref"
        assert slamref.main(words) == 0, line
    assert "all 15 checks passed" in capsys.readouterr().out
    for folder in ("ukf", "mine"):
        metrics = pd.read_csv(here / "results" / folder / "metrics.csv")
        assert set(metrics["status"]) == {"ok"}
    assert set(metrics["association"]) == {"known", "my_singles"}


@pytest.mark.slow
def test_the_lines_of_python_run(capsys):
    (code,) = [code for code in PYTHON if code.startswith("import slamref")]
    exec(compile(code, "extending.md", "exec"), {})
    said = capsys.readouterr().out
    assert said.split().count("0.327855") == 2


def test_every_verb_it_names_is_one_and_none_is_left_out():
    from eval.replay.estimators import CAPABILITIES, Estimator

    verbs = {verb for protocol in (Estimator, *CAPABILITIES) for verb in vars(protocol) if not verb.startswith("_")}
    named = set(re.findall(r"`(\w+)", PAGE.read_text(encoding="utf-8")))
    assert verbs - named == {"inflate", "stamp", "errors"}  # of no consequence to most
    assert not verbs & (set(vars(Bare)) - {"predict", "update", "estimate"})


def test_a_study_of_an_own_world_and_an_own_filter_takes_fifteen_lines(monkeypatch, here):
    assert len([line for line in STUDY.splitlines() if line.strip() and "import" not in line]) <= 15
    monkeypatch.syspath_prepend(here)
    names: dict[str, object] = {}
    exec(compile(STUDY.replace("runs=50", "runs=20"), "scenarios.md", "exec"), names)
    found = names["study"].verdicts.set_index(["estimator", "quantity"])
    assert found.lower["Ukf", "pose"] < 3.0 < found.upper["Ukf", "pose"]
    assert (here / "anees.pdf").stat().st_size > 1000
