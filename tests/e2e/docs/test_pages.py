"""Pages of the docs: their Python and commands run, what they name and advise is there, public names have examples."""

import ast
import doctest
import importlib
import inspect
import io
import json
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from matplotlib import image

import slamref
from data.convert.__main__ import parser, parser as convert_parser
from eval.plan.flags.options import read_options
from tests.documents import course, measured
from tests.documents.__main__ import PAGES as PAGES_WRITTEN
from tests.e2e.docs.notebook import executed, load

README = Path(__file__).parents[3] / "README.md"
API = README.parent / "docs" / "api.md"


def python(page: Path) -> str:
    code = re.search(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    assert code
    return code[1]


def test_the_python_of_readme_and_api_page_runs(capsys):
    assert len(python(README).splitlines()) <= 10
    exec(compile(python(README), "README.md", "exec"), {})
    assert "rmse_position_m" in capsys.readouterr().out
    names: dict[str, object] = {}
    exec(compile(python(API), "api.md", "exec"), names)
    assert np.isfinite(names["pose"]).all()
    assert np.linalg.eigvalsh(names["covariance"]).min() > 0.0


@pytest.mark.parametrize("path", PAGES_WRITTEN, ids=lambda path: path.name)
def test_generated_pages_are_as_make_docs_writes_them(path):
    assert path.read_text(encoding="utf-8") == PAGES_WRITTEN[path](), "`make docs` writes it anew"


def test_measured_numbers_stand_on_the_pages_as_make_docs_writes_them():
    pages = measured.pages()
    assert {page.name for page in pages} >= {"README.md", "results.md"}
    assert [page.name for page, text in pages.items() if page.read_text(encoding="utf-8") != text] == []
    assert not re.findall(r"[\s\"']/\w+/", measured.PRINTED.read_text(encoding="utf-8")), "a folder of a machine"
    with pytest.raises(ValueError, match="0 times, not once"):
        measured.written("a 1.5 m b", "a {x.y:.1f} m c", {"x": {"y": 2.0}})
    assert measured.written("a 1.5 m b", "a {x.y:.1f} m", {"x": {"y": -2.0}}) == "a −2.0 m b"


def test_pages_pictures_and_public_names_are_there():
    described = re.findall(r"^### (\w+)$", API.read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert sorted([*described, "__version__"]) == slamref.__all__
    for page in [README, *(README.parent / "docs").glob("*.md")]:
        for link in re.findall(r"\]\(([^)#]+)[^)]*\)", page.read_text(encoding="utf-8")):
            assert (page.parent / link).exists(), f"{page.name}: {link}"
    named = {
        (path.name, page)
        for package in PACKAGES
        for path in (ROOT / package).rglob("*")
        if path.suffix in (".py", ".j2", ".html", ".js")
        for page in re.findall(r"docs/[\w/-]+\.(?:md|ipynb)", path.read_text(encoding="utf-8"))
    }
    assert len(named) > 5
    assert {(name, page) for name, page in named if not (ROOT / page).exists()} == set()


ROOT = Path(__file__).parents[3]
PACKAGES = ("association", "data", "ekf", "eval", "graph", "wings")
OURS = (*PACKAGES, "docs", "tests")
PAGES = [p for kind in ("*.md", "docs/**/*.md", "docs/**/*.ipynb") for p in sorted(ROOT.glob(kind))]
PAGES.remove(ROOT / "CHANGELOG.md")  # which names what there was
QUOTED = re.compile(r"`([^`\n]+)`")
FILE = re.compile(rf"(?:{'|'.join(OURS)})/[\w./-]*")
DOTTED = re.compile(rf"(?:{'|'.join(PACKAGES)})(?:\.(?!csv\b)\w+)+")


def is_there(name: str) -> bool:
    parts = name.split(".")
    for k in range(len(parts), 0, -1):
        try:
            found: object = importlib.import_module(".".join(parts[:k]))
        except ModuleNotFoundError:
            continue
        return all((found := getattr(found, attribute, None)) is not None for attribute in parts[k:])
    return False


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_files_and_names_in_backticks_exist(page):
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    words = [word.partition("(")[0] for word in QUOTED.findall(text)]
    missing = [w for w in words if FILE.fullmatch(w) and not (ROOT / w).exists()]
    assert missing + [w for w in words if DOTTED.fullmatch(w) and not is_there(w)] == []


CONSTANTS = ("NEW", "DISCARD", "__version__")
PUBLIC = [name for name in slamref.__all__ if name not in CONSTANTS]


@pytest.fixture(scope="module")
def shown():
    """What the examples take for granted: a log, its inputs, runs, a trial."""
    log = slamref.open_log("arena:0:frames=30")
    runs = slamref.compare(log.inputs(labels=True), "localization", ["ekf", "batch"])
    trial = slamref.Trial(log, "localization", tuple(runs))
    return {"slamref": slamref, "np": np, "log": log, "inputs": log.inputs(), "runs": runs, "trial": trial}


@pytest.mark.parametrize("name", PUBLIC)
def test_the_example_of_a_public_name_runs(name, shown, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for file in ("estimate.tum", "truth.tum"):
        (tmp_path / file).write_text("".join(f"{t} {t} {t * t} 0 0 0 0 1\n" for t in range(9)))
    text = inspect.getdoc(getattr(slamref, name)) or ""
    examples = doctest.DocTestParser().get_examples(text)
    assert examples, f"{name} has no example"
    space = dict(shown)
    for example in examples:
        exec(compile(example.source, f"<{name}>", "single"), space)


TEXT = (Path(__file__).parents[3] / "docs" / "results-files.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_three_commands_run_and_print_what_the_page_shows(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    printed, shown = [], []
    for line in re.search(r"```sh\n(.*?)```", TEXT, re.S)[1].splitlines():
        program, *arguments = shlex.split(line, comments=True)
        shown += [line.partition("#")[2].split()] if "#" in line else []
        assert program == "slamref"
        assert slamref.main(arguments) == 0
        printed.append(capsys.readouterr().out.splitlines())
    assert shown == [["nees_pose", "3.10366"]]
    assert shown[0] in [line.split() for line in printed[1]]
    assert "mine" in (tmp_path / "second/metrics.csv").read_text()
    assert (tmp_path / "second/figures/arena_0-slam-map.png").exists()


@pytest.mark.slow
def test_the_site_is_built_and_is_strict(tmp_path):
    pytest.importorskip("mkdocs", reason="make site installs it")
    site = tmp_path / "site"
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(site)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    assert (site / "index.html").is_file()
    assert "compare" in (site / "api.html").read_text()


DOCS = Path(__file__).parents[3] / "docs"
TOURS = sorted(DOCS.glob("*.ipynb"))
by_name = pytest.mark.parametrize("tour", TOURS, ids=[path.stem for path in TOURS])


@pytest.mark.slow
@by_name
def test_the_tour_runs_and_shows_what_is_stored(tour):
    stored = load(tour)
    for before, now in zip(stored["cells"], executed(stored)["cells"], strict=True):
        assert outputs_of(before) == outputs_of(now), before["id"]


def outputs_of(cell):
    """What the outputs of a cell say: texts and tables with their numbers, kinds of pictures."""
    outputs = cell.get("outputs", [])
    said = [(o.get("text"), o.get("data", {}).get("text/html")) for o in outputs]
    return [(o["output_type"], sorted(o.get("data", {}))) for o in outputs], said


SHEET = (ROOT / "docs" / "course.md").read_text(encoding="utf-8")
ROW = re.compile(r"^\| .* \| `([a-z_0-9/]+\.py)`: (.+) \|$", re.MULTILINE)
NAMED = [(file, name) for file, names in ROW.findall(SHEET) for name in re.findall(r"`([\w.]+)`", names)]
LESSONS = [course.source(name) for name in course.LESSONS]
COMMANDS = [
    shlex.split(line)
    for lesson in LESSONS
    for block in re.findall(r"```sh\n(.*?)```", lesson, re.DOTALL)
    for line in block.splitlines()
    if line.startswith("slamref ")
]


def defined(file: str) -> set[str]:
    found = set()
    for node in ast.parse((ROOT / file).read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
            if isinstance(node, ast.ClassDef):
                found |= {f"{node.name}.{inner.name}" for inner in node.body if isinstance(inner, ast.FunctionDef)}
    return found


@pytest.mark.parametrize("file", sorted({file for file, _ in NAMED}))
def test_every_function_beside_an_equation_is_in_its_file(file):
    assert {name for f, name in NAMED if f == file} <= defined(file)


def test_every_row_names_a_function_and_no_file_is_named_in_any_other_way():
    rows = [line for line in SHEET.splitlines() if line.startswith("| ") and ".py`" in line]
    assert len(rows) == len(ROW.findall(SHEET)) > 30
    assert all(names for _, names in NAMED)
    assert set(re.findall(r"`([\w/]+\.py)`", SHEET)) == {file for file, _ in NAMED}


@pytest.mark.parametrize("words", COMMANDS, ids=lambda words: " ".join(words[1:6]))
def test_every_command_is_understood(words):
    name, arguments = words[1], [re.sub(r"^(.*,)?tasks/.*\.py:\w+$", r"\1dead-reckoning", word) for word in words[2:]]
    if name in ("run", "study"):
        read_options(arguments, positional={"run": "log", "study": "scenario"}[name])
    elif name == "convert":
        convert_parser().parse_args(arguments)
    else:
        assert name in slamref.commands()


def test_every_lesson_has_one_exercise_that_is_marked():
    """Its skeleton was written before, its parts exist, and no other lesson asks them."""
    weights = tomllib.loads((ROOT / "wings" / "grade" / "weights.toml").read_text(encoding="utf-8"))
    written, asked = set(), []
    for number, lesson in enumerate(LESSONS, start=1):
        written |= set(re.findall(r"^slamref grade --handout (\w+) tasks/\1$", lesson, re.MULTILINE))
        ((assignment, parts),) = re.findall(
            rf"^slamref grade tasks/(\w+) --assignment \1((?: --part \w+)+) --out marks/lesson-{number}$",
            lesson,
            re.MULTILINE,
        )
        asked += [(assignment, part) for part in parts.split(" --part ")[1:]]
        assert assignment in written
    assert len(set(asked)) == len(asked) > 10
    assert all(part in weights[assignment] for assignment, part in asked)


@pytest.mark.slow
@pytest.mark.parametrize("name", course.LESSONS)
def test_a_lesson_runs_within_a_minute_and_shows_what_its_page_says(name):
    found, stored = course.run(name), json.loads(course.STORE.read_text(encoding="utf-8"))[name]
    assert (found.printed, found.values) == (stored["printed"], stored["values"])
    assert found.seconds < 60
    drawn, kept = (image.imread(source) for source in (io.BytesIO(found.picture), course.PAGES / f"{name}.png"))
    assert drawn.shape == kept.shape
    assert np.abs(drawn - kept).mean() < 0.01


ADVICE = re.compile(
    r"`([^`]*--[^`]*)` of `slamref convert ?(\w*)|"
    r"slamref convert (\w+) ((?:(?!slamref)[^`\n\"])*--(?:(?!slamref)[^`\n\"])*)"
)


def test_a_command_has_the_flags_that_are_advised():
    kinds = parser()._subparsers._group_actions[0].choices | {"KIND": parser()}
    for path in (p for of in ("data", "eval", "wings", "docs") for p in Path(ROOT, of).rglob("*")):
        if path.suffix not in (".j2", ".py", ".toml", ".md"):
            continue
        for before, kind, other, after in ADVICE.findall(path.read_text(encoding="utf-8")):
            known = kinds[kind or other]._option_string_actions if kind or other else ()
            assert [f for f in re.findall(r"--[a-z][a-z-]*", before + after) if f not in known] == [], path
