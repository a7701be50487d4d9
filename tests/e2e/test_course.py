"""The teacher's sheet: every file and function it names is there, and every command is one."""

from __future__ import annotations

import ast
import re
import shlex
from pathlib import Path

import pytest

import slamref
from data.convert.__main__ import parser as convert_parser
from eval.plan.flags.options import read_options

ROOT = Path(__file__).parents[2]
SHEET = (ROOT / "docs" / "course.md").read_text(encoding="utf-8")
ROW = re.compile(r"^\| .* \| `([a-z_0-9/]+\.py)`: (.+) \|$", re.MULTILINE)
NAMED = [(file, name) for file, names in ROW.findall(SHEET) for name in re.findall(r"`([\w.]+)`", names)]
COMMANDS = [
    shlex.split(line)
    for block in re.findall(r"```sh\n(.*?)```", SHEET, re.DOTALL)
    for line in block.splitlines()
    if line.startswith("slamref ")
]


def defined(file: str) -> set[str]:
    """Functions and classes of a module, methods as `Class.method`."""
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
    name, arguments = words[1], words[2:]
    if name in ("run", "study"):
        read_options(arguments, positional={"run": "log", "study": "scenario"}[name])
    elif name == "convert":
        convert_parser().parse_args(arguments)
    else:
        assert name in slamref.commands()
