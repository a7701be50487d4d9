"""docs/extending.md, docs/logs.md and docs/stories.md run as they stand."""

import re
import shlex
import sys
from pathlib import Path

import pandas as pd
import pytest

import slamref
from data.convert.__main__ import main as convert
from data.worlds.arena import Arena, simulate
from eval.example import write
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
    assert "all 12 checks passed" in capsys.readouterr().out
    for folder in ("ukf", "mine"):
        metrics = pd.read_csv(here / "results" / folder / "metrics.csv")
        assert set(metrics["status"]) == {"ok"}
    assert set(metrics["association"]) == {"known", "my_singles"}


@pytest.mark.slow
def test_the_lines_of_python_run(capsys):
    (code,) = [code for code in PYTHON if code.startswith("import slamref")]
    exec(compile(code, "extending.md", "exec"), {})
    assert capsys.readouterr().out.split().count("0.327855") == 2


def test_every_verb_it_names_is_one_and_none_is_left_out():
    from eval.replay.estimators import OPTIONAL, Estimator

    verbs = {verb for verb in vars(Estimator) if not verb.startswith("_")}
    verbs |= {verb for principal, others in OPTIONAL.items() for verb in (principal, *others)}
    named = set(re.findall(r"`(\w+)", PAGE.read_text(encoding="utf-8")))
    assert verbs - named == {"inflate", "stamp", "errors"}  # of no consequence to most
    assert not verbs & (set(vars(Bare)) - {"predict", "update", "estimate"})


@pytest.mark.slow
def test_a_study_of_an_own_world_and_an_own_filter_takes_fifteen_lines(monkeypatch, here):
    assert len([line for line in STUDY.splitlines() if line.strip() and "import" not in line]) <= 15
    monkeypatch.syspath_prepend(here)
    names: dict[str, object] = {}
    exec(compile(STUDY.replace("runs=50", "runs=20"), "scenarios.md", "exec"), names)
    found = names["study"].verdicts.set_index(["estimator", "quantity"])
    assert found.lower["Ukf", "pose"] < 3.0 < found.upper["Ukf", "pose"]
    assert (here / "anees.pdf").stat().st_size > 1000


DOCS = Path(__file__).parents[3] / "docs" / "logs.md"


def blocks(language: str) -> list[str]:
    parts = DOCS.read_text(encoding="utf-8").split("```")[1::2]
    return [text.partition("\n")[2] for text in parts if text.partition("\n")[0] == language]


@pytest.mark.slow
def test_the_story_of_the_docs(tmp_path, monkeypatch, capsys):
    write(tmp_path)
    monkeypatch.chdir(tmp_path)
    commands = [line for line in blocks("sh")[0].splitlines() if line]
    assert len(commands) <= 5
    said = []
    for line in commands:
        program, *words = shlex.split(line)
        assert program == "slamref"
        assert slamref.main(words) == 0
        said.append(capsys.readouterr().out)
    files, converted, answered, asked = [*blocks("")[:3], *blocks("console")]
    for name in ("odometry.csv", "cones.csv"):
        for line in (tmp_path / name).read_text().splitlines()[:3]:
            assert line in files
    assert converted in said[0]
    assert answered in said[-1]
    wrong = shlex.split(commands[0].replace("time=ms,angle=deg", "time=ms"))[2:]
    assert convert(["wrong" if w == "robot" else w for w in wrong]) == 0
    assert asked in capsys.readouterr().out
    assert (tmp_path / "report" / "figures" / "robot-slam-claims.png").exists()
    (last,) = re.findall(r"`(robot, slam: .*)`", DOCS.read_text(encoding="utf-8"))
    assert last in said[-1]
    assert last in (DOCS.parent / "verdicts.md").read_text(encoding="utf-8")
    for n, row, found in re.findall(r"^\| (\d) \| (.*) \| (.*) \|$", DOCS.read_text(encoding="utf-8"), re.MULTILINE):
        flags = shlex.split(" ".join(re.findall(r"`(--[^`]+)`", row)))
        assert convert([f"mended{n}" if w == "robot" else w for w in shlex.split(commands[0])[2:]] + flags) == 0
        assert slamref.main(["run", f"mended{n}", "--no-plots", "--out", f"report{n}"]) == 0
        assert found in capsys.readouterr().out
    assert n == "3"


@pytest.mark.slow
def test_the_commands_beside_the_example_files_run_and_localize(here, monkeypatch, capsys, refused):
    assert slamref.main(["example", "files"]) == 0
    monkeypatch.chdir(here / "files")
    for line in Path("commands.sh").read_text(encoding="utf-8").replace("\\\n", " ").splitlines():
        program, *words = shlex.split(line, comments=True) or [""]
        assert program in ("", "slamref")
        assert not program or slamref.main(words) == 0, line
    metrics = pd.read_csv("report-surveyed/metrics.csv").query("estimator != 'dead-reckoning'")
    assert (metrics["rmse_position_m"] < 0.05).all()
    capsys.readouterr()
    assert "exists; name a new folder" in refused(slamref.main, ["example", "."])


STORIES_PAGE = Path(__file__).parents[3] / "docs" / "stories.md"
STORIES = dict(re.findall(r"```sh (\w+)\n(.*?)```", STORIES_PAGE.read_text(encoding="utf-8"), flags=re.DOTALL))


def tell(story):
    write(Path.cwd())
    for program, *words in [shlex.split(line) for line in STORIES[story].strip().splitlines()]:
        assert program == "slamref"
        assert slamref.main(words) == 0, words


@pytest.mark.slow
def test_the_student_has_answers_steps_and_a_player(here):
    tell("student")
    text = (here / "lab" / "report.md").read_text(encoding="utf-8")
    assert [f"## Question {n}:" in text for n in range(1, 7)] == [True] * 6
    assert "Not answered" not in text
    assert (here / "lab" / "write-up.tex").exists()
    assert len(list((here / "steps").glob("*.png"))) >= 12
    assert (here / "people.html").stat().st_size < 1e6


@pytest.mark.slow
def test_the_researchers_filter_is_scored_beside_ours(here, capsys):
    tell("researcher")
    said = capsys.readouterr().out
    metrics = pd.read_csv(here / "mine" / "metrics.csv").set_index(["estimator", "association"])
    assert (metrics["status"] == "ok").all()
    off = metrics.loc[("Ukf", "known"), "rmse_position_m"]
    assert off == pytest.approx(metrics.loc[("ekf", "known"), "rmse_position_m"], rel=0.05)
    assert f"rmse_position_m {off:.6g}" in said
    study = pd.read_csv(here / "study" / "consistency.csv").query("estimator == 'Ukf' and quantity == 'pose'")
    assert len(study) > 0
    assert (study["verdict"] == "consistent").all()


@pytest.mark.slow
def test_the_engineer_learns_what_to_trust(here):
    tell("engineer")
    metrics = pd.read_csv(here / "report" / "metrics.csv").query("estimator != 'dead-reckoning'")
    assert set(metrics["association"]) == {"jcbb-hindsight"}
    assert metrics["nis"].between(0.8, 1.2).all()
    assert pd.read_csv(here / "trust" / "trust.csv")["p"].notna().any()


@pytest.mark.slow
def test_the_writer_has_tables_that_fit(here):
    tell("writer")
    for folder in ("study", "paper"):
        tables = list((here / folder / "tables").glob("*.tex"))
        assert (here / folder / "tables" / "notes.tex") in tables
        assert not any("resizebox" in t.read_text(encoding="utf-8") for t in tables)
    assert (here / "paper" / "write-up.tex").exists()
