"""The public face is light, complete, and in the wheel; the command lists its subcommands and refuses others."""

import re
import tomllib
import zipfile
from functools import partial
from importlib import import_module
from importlib.metadata import version
from pathlib import Path

import pytest

import slamref
from eval.studies.shipped import scenarios
from tests.builders.processes import python

ROOT = Path(__file__).parents[1]
NAMES = [
    "DISCARD", "NEW", "Diagnosis", "Expectation", "Judgement", "Log", "Notice", "Samples", "Setup", "Study",
    "Trial", "__version__", "association_findings", "audit", "check_association", "check_estimator", "compare",
    "decide", "estimator_findings", "judge", "make_estimator", "notices", "open_log", "score", "score_files",
    "sentence", "study", "twins",
]  # fmt: skip


command = partial(python, "-m", "slamref")


def test_the_names_are_those_of_the_submodules():
    assert dir(slamref) == slamref.__all__ == sorted(NAMES)
    homes = slamref.HOMES | slamref._of_wings()
    assert sorted([*homes, "__version__"]) == sorted(NAMES)
    for name, home in homes.items():
        assert getattr(slamref, name) is getattr(import_module(home), name)
    assert slamref.__version__ == version("slamref")
    with pytest.raises(AttributeError, match="'slamref' has no attribute 'ekf'"):
        _ = slamref.ekf


@pytest.mark.parametrize("hiding", ["data.py", "eval/__init__.py", "graph.py"])
def test_a_file_with_the_name_of_one_of_our_packages_is_no_obstacle_unless_it_is_in_use(hiding, tmp_path):
    package = hiding.partition("/")[0].removesuffix(".py")
    (tmp_path / hiding).parent.mkdir(exist_ok=True)
    (tmp_path / hiding).write_text("raise SystemExit('mine')" if package == "graph" else "")
    script, use = tmp_path / "script.py", "import slamref\nlog = slamref.open_log('arena:0:frames=5')\n"
    script.write_text(f"{use}print(len(slamref.compare(log.inputs(), 'slam', ['batch'], 'nn')))")
    done = python(script, PYTHONPATH=str(ROOT))
    assert done.stdout == "1\n", done.stderr
    place = tmp_path / hiding.partition("/")[0]
    assert f"UserWarning: packages of slamref have the names of {place}" in done.stderr
    if package != "graph":
        script.write_text(f"import {package}\n{use}")
        said = python(script, PYTHONPATH=str(ROOT)).stderr.strip().splitlines()[-1]
        assert said.startswith(f"ImportError: {place}")
        assert said.endswith(f"hides the package {package!r} of slamref; rename it, or import slamref first")


@pytest.mark.parametrize("asked", [["--help"], ["-h"]])
def test_the_command_lists_its_subcommands_in_a_line_each(asked):
    done = command(*asked)
    assert done.returncode == 0
    names = [line.split()[0] for line in done.stdout.split("\n") if line.startswith("  ")]
    assert names == [*slamref.commands()]
    assert {"run", "step", "play", "live", "score", "check", "detect", "convert", "inspect"} <= set(names)


def test_the_command_lists_its_subcommands_says_its_version_and_refuses_others():
    assert command("--version").stdout == f"slamref {version('slamref')}\n"
    done = command("walk", "--log", "arena:0")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("slamref: walk: no such command; type one of run, lab, ")
    assert done.stderr.count("\n") == 1
    assert command("inspekt").stderr == "slamref: inspekt: no such command. Did you mean inspect?\n"


@pytest.mark.slow
def test_the_wheel_holds_the_face_the_command_and_the_files_beside_the_code(tmp_path):
    python("-m", "hatchling", "build", "-t", "wheel", "-d", tmp_path)
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        held = set(archive.namelist())
        archive.extractall(tmp_path / "unpacked")
    code = {p.relative_to(ROOT).as_posix() for p in ROOT.glob("[adeg]*/**/*.py") if p.parts[-1] != "__pycache__"}
    tables = {p.relative_to(ROOT).as_posix() for p in (ROOT / "eval/scenarios").iterdir()}
    packages = ("association/", "data/", "ekf/", "eval/", "graph/")
    assert {name for name in code if name.startswith(packages)} | tables | {"slamref.py"} <= held
    assert {f"{package}py.typed" for package in packages} <= held
    stub = (tmp_path / "unpacked" / "slamref-stubs" / "__init__.pyi").read_text()
    assert set(re.findall(r"(\w+) as \1\b", stub)) == set(NAMES) - {"__version__"}
    (entry,) = (name for name in held if name.endswith("entry_points.txt"))
    assert "slamref = slamref:main" in (tmp_path / "unpacked" / entry).read_text()
    asked = "import slamref; from eval.studies.shipped import scenarios; print(slamref.__file__, len(scenarios()))"
    done = python("-c", asked, cwd=tmp_path, PYTHONPATH=str(tmp_path / "unpacked"))
    assert done.stdout == f"{tmp_path / 'unpacked' / 'slamref.py'} {len(scenarios())}\n"


def test_the_conda_recipe_needs_what_the_wheel_needs():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    theirs = {"matplotlib": "matplotlib-base", "opencv-python-headless": "py-opencv"}
    needed = [re.fullmatch("([a-z0-9-]+)(>=.*)", each).groups() for each in project["dependencies"]]
    recipe = (ROOT / "packaging/recipe.yaml").read_text()
    python, *lines = re.findall("    - (.*)", recipe.partition("\n  run:\n")[2].partition("\n\n")[0])
    assert sorted(lines) == sorted(f"{theirs.get(name, name)} {least}" for name, least in needed)
    assert python == "python >=${{ python_min }}"
    assert f'python_min: "{project["requires-python"].removeprefix(">=")}"' in recipe
