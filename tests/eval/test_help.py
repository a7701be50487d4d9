"""Whole help pages, and every command that a help page or a page of the docs shows: its own parser reads it."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

import slamref
from data.command import Parser
from data.convert.__main__ import SOURCES
from eval.plan.flags import options as flags

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
WIDTH = 120


class Read(Exception):  # noqa: N818
    """The words of a command were read."""


def help_of(words, capsys):
    with pytest.raises(SystemExit) as end:
        slamref.main(words)
    assert not end.value.code
    return capsys.readouterr().out


def commands(text):
    """Commands among the lines of a text, without remarks."""
    for line in re.sub(r" *\\\n *", " ", text).splitlines():
        bare = re.split(r" {2,}| #", line.strip())[0].removeprefix("$ ")
        if bare.startswith("slamref ") and "--help" not in bare and "..." not in bare:
            yield bare.removeprefix("slamref ")
        elif bare.startswith("python -m eval.run_all"):
            yield "run" + bare.removeprefix("python -m eval.run_all")


def shown(page):
    """Commands of fenced blocks; and of inline code, where they are more than a mention."""
    text = page.read_text()
    for language, block in re.findall(r"^ *```(\w*)\n(.*?)^ *```", text, re.M | re.S):
        if language in ("", "sh", "console"):
            yield from commands(block)
    for command in re.findall(r"`(slamref [^`]+)`", re.sub(r"```.*?```", "", text, flags=re.S)):
        if command.count(" ") > 2:
            yield from commands(" ".join(command.split()))


@pytest.fixture
def only_read(monkeypatch, tmp_path):
    """Commands end when their words were read."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_run.toml").write_text("quick = true\n")
    refuse, options = Parser.refuse, flags.read_options

    def refused(self, left):
        refuse(self, left)
        raise Read

    def read(*words, **named):
        options(*words, **named)
        raise Read

    monkeypatch.setattr(Parser, "refuse", refused)
    monkeypatch.setattr("eval.run_all.read_options", read)

    def tried(command):
        with pytest.raises(Read):
            slamref.main(shlex.split(command))

    return tried


CONVERSIONS = sorted({kind for source in SOURCES for kind in source.KINDS})


@pytest.mark.parametrize(
    "words", [*([name] for name in slamref.commands()), *(["convert", k] for k in CONVERSIONS)], ids=" ".join
)
def test_help_is_whole_and_its_examples_can_be_read(words, capsys, only_read):
    for page in (help_of([*words, "--help"], capsys), help_of([*words, "--help-all"], capsys)):
        assert page.startswith(f"usage: slamref {' '.join(words)} ")
        assert max(map(len, page.splitlines())) <= WIDTH
        assert not re.search(r"PROG|%\(|\{\{|<<<|>>>|===", page)
        for command in commands(page):
            only_read(command)


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_commands_of_the_docs_can_be_read(page, only_read):
    for command in shown(page):
        only_read(command)
