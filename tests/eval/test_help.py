"""Every command says what it takes at once: the parser imports little, and no numerical library."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from eval import open_report
from tests.quick import slow

ROOT = Path(__file__).parents[2]
HEAVY = ("numpy", "scipy", "numba", "pandas", "gtsam", "matplotlib", "cv2", "joblib", "tqdm")
MODULES = 260
"""That are imported, at most: 150 to 210 of Python and ours. One numerical library alone has a hundred more."""
COMMANDS = {
    "run": "eval.run_all", "step": "wings.labs.stepping.command", "play": "eval.play",
    "convert": "data.convert.__main__",
    "detect": "wings.camera.detect", "camera": "wings.camera.command", "inspect": "eval.inspect",
    "live": "wings.robot.live.__main__",
    "tune": "eval.tune", "twin": "eval.twin", "score": "eval.score", "check": "eval.check",
    "benchmark": "eval.benchmark", "audit": "wings.audit.command", "warm": "eval.warm", "report": "eval.open_report",
}  # fmt: skip
HELP = """
import sys
from {module} import main
try:
    main({arguments!r})
except SystemExit as end:
    assert not end.code
print([name for name in {heavy!r} if name in sys.modules], len(sys.modules) < {most})
"""


def python(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, *arguments], capture_output=True, text=True, cwd=ROOT, check=False)


@pytest.mark.parametrize(
    ("module", "arguments"),
    [
        *((module, ["--help"]) for module in (*COMMANDS.values(), "wings.robot.simulate")),
        *(("slamref", [*name, "--help"]) for name in ([], ["lab"], ["study"])),
        *(slow("slamref", [name, "--help"]) for name in COMMANDS),
    ],
)
def test_help_answers_at_once_and_loads_nothing_heavy(module, arguments):
    done = python("-c", HELP.format(module=module, arguments=arguments, heavy=HEAVY, most=MODULES))
    assert done.stdout.startswith("usage: ")
    assert done.stdout.endswith("\n[] True\n"), done.stdout[-200:] + done.stderr


@pytest.mark.parametrize(("name", "module"), [c if c[0] in ("run", "convert") else slow(*c) for c in COMMANDS.items()])
def test_a_subcommand_is_the_module_under_another_name(name, module):
    module = f"eval.{name}" if module.startswith("wings.") else module.removesuffix(".__main__")
    ours, theirs = (" ".join(python("-m", *words, "--help").stdout.split()) for words in (["slamref", name], [module]))
    assert ours.startswith(f"usage: slamref {name} ")
    assert theirs.startswith(f"usage: python -m {module} ")
    assert ours.replace(f"slamref {name}", f"python -m {module}") == theirs


@pytest.mark.parametrize(("name", "wrong", "words"), [
    ("run", ["--gate", "1"], "slamref: --gate 1: a probability"),
    ("step", [], "slamref: no log: one log is needed"),
    ("inspect", ["nowhere"], "slamref: nowhere: no such log or folder"),
    ("convert", ["moon"], "slamref convert: argument KIND: moon: unknown"),
])  # fmt: skip
def test_a_subcommand_hands_on_its_exit_status(name, wrong, words):
    done = python("-m", "slamref", name, *wrong)
    assert done.returncode == 2
    assert done.stderr.startswith(words)
    assert done.stderr.count("\n") == 1


def test_slamref_alone_says_what_it_is_for_and_names_three_commands():
    done = python("-m", "slamref")
    assert done.returncode == 0
    assert re.findall(r"^  slamref (\w+)", done.stdout, re.M) == ["run", "lab", "inspect"]
    assert len(done.stdout.splitlines()) == 5


@pytest.mark.parametrize(("line", "expected"), [
    ("slamref ru", {"run "}),
    ("slamref run --es", {"--estimator "}),
    ("slamref score --ali", {"--align "}),
    ("slamref lab --write", {"--write-up "}),
    ("slamref convert mrc", {"mrclam "}),
])  # fmt: skip
def test_the_shell_completes_commands_and_flags(line, expected):
    environment = os.environ | {"COMP_LINE": line, "COMP_POINT": str(len(line)), "_ARGCOMPLETE": "1"}
    with tempfile.NamedTemporaryFile("r") as answer:
        environment["_ARGCOMPLETE_STDOUT_FILENAME"] = answer.name
        subprocess.run([sys.executable, "slamref.py"], env=environment, cwd=ROOT, check=False)
        assert set(answer.read().split("\x0b")) == expected


def test_a_report_is_opened_in_the_browser_or_its_address_is_printed(tmp_path, monkeypatch, capsys):
    opened = []
    monkeypatch.setattr(open_report.webbrowser, "open", lambda address: opened.append(address) or len(opened) == 1)
    assert open_report.main([str(tmp_path)]) == 2
    assert "no report.html" in capsys.readouterr().err
    (tmp_path / "report.html").write_text("<p>")
    assert open_report.main([str(tmp_path)]) == 0
    assert capsys.readouterr().out == ""
    assert open_report.main([str(tmp_path)]) == 0
    assert opened[1] in capsys.readouterr().out
