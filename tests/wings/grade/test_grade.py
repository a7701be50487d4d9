"""Grading: model solutions get everything, handouts nothing, typical mistakes less, and the cause is named."""

import ast
import functools
import importlib
import json
import time
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import slamref
from data.formats.mrclam import load_mrclam
from tests.quick import slow
from wings.grade import handout, parts, utias
from wings.grade.classes import distributions, similar
from wings.grade.parts import Outcome, Seeds
from wings.grade.sandbox import MODULES, graded, outcomes, read_scheme

HERE = Path(__file__).parent
SOLUTIONS = HERE / "solutions"
SEEDS = Seeds((5,))
LONG = ("joint_compatibility", "slam", "prediction")  # parts whose cases take more than a second for the first time


@pytest.fixture(autouse=True)
def warned():
    """A submission may warn; in its process nobody sees it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


@functools.cache
def part_of(assignment, name):
    part = next(p for p in importlib.import_module(MODULES[assignment]).PARTS if p.name == name)
    return part, part.prepare(SEEDS)


def outcome_of(file, assignment, name):
    return graded(file, *part_of(assignment, name))


def every_part():
    return [(a, p.name) for a in MODULES for p in importlib.import_module(MODULES[a]).PARTS]


def mistakes():
    for n, line in enumerate((HERE / "mistakes.txt").read_text().splitlines()[1:]):
        assignment, part, points, cause, old, new = line.split(" | ", 5)
        row = (assignment, part, float(points), cause, *map(ast.literal_eval, (old, new)))
        fast = n % 3 == 0
        yield row if fast and part not in LONG else slow(*row)


@pytest.mark.parametrize(("assignment", "part", "points", "cause", "old", "new"), list(mistakes()))
def test_a_typical_mistake_loses_points_and_is_named(assignment, part, points, cause, old, new, tmp_path):
    right = (SOLUTIONS / f"{assignment}.py").read_text()
    assert old in right
    file, scheme = tmp_path / "mine.py", read_scheme(None, assignment)
    file.write_text(right.replace(old, new))
    found = outcome_of(file, assignment, part)
    assert scheme.points(found) == points < scheme.weights[part]
    assert cause in found.causes if cause != "-" else not found.causes
    if found.right < found.of:
        assert found.first is not None
        assert found.first.why or found.first.expected != found.first.got


def test_every_assignment_has_twelve_mistakes():
    lines = (HERE / "mistakes.txt").read_text().splitlines()[1:]
    assert min(sum(line.startswith(f"{a} |") for line in lines) for a in MODULES) >= 12


@pytest.mark.parametrize(("assignment", "part"), [slow(*e) if e[1] in LONG else e for e in every_part()])
def test_a_model_solution_gets_everything_and_a_handout_nothing(assignment, part, tmp_path):
    scheme, file = read_scheme(None, assignment), tmp_path / f"{assignment}.py"
    right = outcome_of(SOLUTIONS / f"{assignment}.py", assignment, part)
    assert right.flawless, right
    assert scheme.points(right) == scheme.weights[part] > 0.0
    file.write_text(handout(assignment)[1])
    begun = outcome_of(file, assignment, part)
    assert scheme.points(begun) == 0.0
    assert "NotImplementedError" in begun.stopped + (begun.first.why if begun.first else "")


@pytest.mark.slow
@pytest.mark.parametrize("assignment", MODULES)
def test_a_model_solution_gets_everything_on_other_seeds(assignment):
    for part in importlib.import_module(MODULES[assignment]).PARTS:
        found = graded(SOLUTIONS / f"{assignment}.py", part, part.prepare(Seeds(tuple(range(20, 26)))))
        assert found.flawless, found


@pytest.mark.parametrize(("text", "why"), [
    ("def to_camera(:", "line 1"), ("x = 1", "no 'to_camera' in mine.py; there is nothing"),
    ("to_camera = 3", "to_camera is an int; a class or a function is needed"),
    ("raise SystemExit('no')", "importing it raised SystemExit: no (mine.py, line 1)"),
    ("def to_camera(*a):\n    return 'x'", "what it returned is 'x'; an array (4, 2) is needed"),
    ("def to_camera(*a):\n    return None, None, None", "has shape (3,); (4, 2) is needed"),
    ("def to_camera(pose, *a):\n    return 1 / 0", "raised ZeroDivisionError: division by zero (mine.py, line 2)"),
])  # fmt: skip
def test_what_cannot_be_used_says_why_without_the_place(text, why, tmp_path):
    (tmp_path / "mine.py").write_text(text)
    found = outcome_of(tmp_path / "mine.py", "visual", "to_camera")
    said = found.stopped or found.first.why
    assert why in said
    assert str(tmp_path) not in said
    assert read_scheme(None, "visual").points(found) == 0.0


def test_arguments_are_copies_and_idle_questions_count_only_where_they_are_answered_wrongly():
    asked = [parts.Question("log", k, (np.array([k]),), (np.array([7]),) if k else (np.empty(0, int),), idle=not k)
             for k in range(5)]  # fmt: skip

    def spoils(a):
        a += 90
        return [7]

    def careful(a):
        return [7] if a[0] else []

    part = parts.asked("f", lambda seeds, name: asked)
    for function, right in ((careful, 4), (spoils, 3), (lambda a: [], 0)):
        found = part.grade(type("Loaded", (), {"thing": staticmethod(function)}), part.prepare(SEEDS))
        assert (found.right, found.of) == (right, 4)
    assert [q.given[0][0] for q in asked] == [0, 1, 2, 3, 4]
    assert not Outcome("f").flawless


def test_one_submission_from_the_command_line(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert slamref.main(["grade", "--handout", "visual", "task"]) == 0
    text = (SOLUTIONS / "visual.py").read_text().replace("+ translation", "- translation")
    Path("task/visual.py").write_text(text)
    assert slamref.main(["grade", "task", "--assignment", "visual", "--seeds", "3", "--out", "page"]) == 0
    assert "task: 80.0 of 100 points" in capsys.readouterr().out
    facts = json.loads(Path("page/grade.json").read_text())
    assert (facts["points"], facts["seeds"], facts["public_seeds"]) == (80.0, [3], False)
    first = facts["parts"][0]["first"]
    assert (first["log"], first["frame"]) == ("visual:3", 0)
    page = Path("page/report.md").read_text()
    assert "no security boundary" in page
    assert "First wrong answer: to_camera, visual:3, frame 0." in page
    assert "expected  [[" in page
    assert str(tmp_path) not in page + Path("page/report.html").read_text() + json.dumps(facts)


@pytest.mark.slow
def test_a_part_alone_is_an_exercise(capsys):
    assert (
        slamref.main(["grade", str(SOLUTIONS), "--assignment", "visual", "--part", "noise", "--part", "jacobian"]) == 0
    )
    said = capsys.readouterr().out
    assert "solutions: 50.0 of 50 points" in said
    assert "to_camera" not in said


@pytest.mark.parametrize(("words", "said"), [
    (["task", "--assignment", "visual", "--part", "nose"], "--part nose: unknown (did you mean noise?)"),
    (["--handout", "visual", "task"], "exists"),
    (["task"], "--assignment: one of corridor, visual, utias, filter is needed"),
    (["nothing", "--assignment", "visual"], "nothing: no visual.py, nor folders with one"),
    (["task", "--assignment", "visual", "--data", "x"], "--data: for --assignment utias"),
    (["task", "--assignment", "visual", "--weights", "w.toml"], "[visual] noise = -1"),
    (["class.csv", "--assignment", "visual"], "a file with the columns name and path is needed"),
    (["task", "--assignment", "visual", "--seeds", "a"], "whole numbers with commas are needed"),
])  # fmt: skip
def test_wrong_words_are_answered_in_a_line(words, said, tmp_path, monkeypatch, refused):
    monkeypatch.chdir(tmp_path)
    assert slamref.main(["grade", "--handout", "visual", "task"]) == 0
    assert slamref.main(["grade", "--default-weights", "w.toml"]) == 0
    Path("w.toml").write_text(Path("w.toml").read_text().replace("noise = 25", "noise = -1"))
    Path("class.csv").write_text("who,path\na,task\n")
    assert said in refused(slamref.main, ["grade", *words])


LOOP = """
import os, subprocess, sys
def to_camera(*a):
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(99)"])
    open({place!r}, "w").write(str(child.pid))
    while True: pass
def jacobian(*a):
    return bytearray(50_000_000_000)
def to_pixels(*a):
    os._exit(3)
"""


@pytest.mark.slow
def test_a_part_without_end_or_measure_ends_alone_and_its_children_with_it(tmp_path):
    weights, place = tmp_path / "weights.toml", tmp_path / "pid"
    shipped = (HERE.parents[2] / "wings/grade/weights.toml").read_text()
    weights.write_text(shipped.replace("seconds = 20 ", "seconds = 2 "))
    right = (SOLUTIONS / "visual.py").read_text()
    (tmp_path / "visual.py").write_text(right + LOOP.format(place=str(place)))
    begin = time.monotonic()
    found = {o.part: o for o in outcomes(tmp_path / "visual.py", "visual", read_scheme(weights, "visual"))}
    assert time.monotonic() - begin < 60.0
    assert found["to_camera"].stopped == "no answer within 2 s"
    assert "MemoryError" in found["jacobian"].stopped
    assert found["to_pixels"].stopped == "the process ended with status 3"
    assert found["to_points"].flawless
    state = Path(f"/proc/{place.read_text()}/stat")
    assert not state.exists() or " Z " in state.read_text()  # or nobody has collected it yet


@pytest.mark.slow
def test_a_class_is_graded_in_parallel_and_what_is_finished_is_kept(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    right = (SOLUTIONS / "visual.py").read_text()
    texts = {
        "ada": right, "bob": right.replace("body", "b").replace("share", "s"), "eve": handout("visual")[1], "nil": None,
    }  # fmt: skip
    for name, text in texts.items():
        Path("class", name).mkdir(parents=True)
        if text is not None:
            Path("class", name, "visual.py").write_text(text)
    words = ["grade", "class", "--assignment", "visual", "--jobs", "2", "--seeds", "4", "--out", "marks"]
    assert slamref.main(words) == 0
    assert "eve: 0.0 of 100 points" in capsys.readouterr().out
    table = pd.read_csv("marks/class.csv")
    assert dict(zip(table["name"], table["points"])) == {"ada": 100.0, "bob": 100.0, "eve": 0.0, "nil": 0.0}
    assert pd.read_csv("marks/similar.csv")[["one", "other"]].to_numpy().tolist() == [["ada", "bob"]]
    Path("class/eve/visual.py").write_text(right)
    Path("list.csv").write_text("name,path\nada,class/ada\neve,class/eve/visual.py\n")
    assert slamref.main(["grade", "list.csv", *words[2:]]) == 0
    said = capsys.readouterr().out
    assert "eve: 100.0" in said
    assert "ada: " not in said
    assert "2 submissions" in Path("marks/report.md").read_text()


def test_distributions_and_similarity():
    table = pd.DataFrame({"points": [0.0, 5.0, 10.0, 10.0], "a": [0.0, 5.0, 10.0, 10.0]})
    row = distributions(table, {"points": 10.0, "a": 10.0}).iloc[0]
    assert (row["mean"], row["median"], row["full"], row["zero"]) == (6.2, 7.5, 2, 1)
    assert [row["histogram"][n] for n in (0, 1, 5, 9)] == ["▅", "▁", "▅", "█"]


def test_only_copies_are_near_identical(tmp_path):
    right = (SOLUTIONS / "utias.py").read_text()
    renamed = right.replace("landmark", "lm").replace("pose", "q").replace("2.0", "4.0").replace("z_hat", "h")
    moved = "\n\n\n".join(reversed(renamed.split("\n\n\n")))
    texts = {"a": right, "b": renamed, "c": moved, "d": handout("utias")[1], "e": "def broken(:"}
    texts["f"] = right.replace("    D, A, c, s", "    assert dt > 0\n    D, A, c, s").replace(
        "np.linalg.inv(S)", "inverse(S)"
    )
    files = {name: tmp_path / f"{name}.py" for name in texts}
    for name, text in texts.items():
        files[name].write_text(text)
    found = similar(files, "utias", 0.0).set_index(["one", "other"])["similarity"]
    assert found["a", "b"] == 1.0
    assert found["a", "c"] > 0.9
    assert 0.75 < found["a", "f"] < 1.0
    assert found.filter(like="e").max() < 0.1


def test_a_simulated_recording_is_one_in_the_mrclam_format(tmp_path):
    assert len(load_mrclam(utias.write_dataset(tmp_path / "set", 3), 1).recorded) > 30
    own = {name: len(q) for name, q in utias.recorded(Seeds((0, 1), tmp_path / "set")).items()}
    assert own["move"] > 300
    assert own["correct"] == own["initialize"] > 10
