"""docs/results-files.md as it is written: its commands run, and they print what it says."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

import slamref

TEXT = (Path(__file__).parents[3] / "docs" / "results-files.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_three_commands_run_and_print_what_the_page_shows(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    printed = []
    for line in re.search(r"```sh\n(.*?)```", TEXT, re.S)[1].splitlines():
        program, *arguments = shlex.split(line)
        assert program == "slamref"
        assert slamref.main(arguments) == 0
        printed.append(capsys.readouterr().out.splitlines())
    shown = re.search(r"```text\n(.*?)```", TEXT, re.S)[1].splitlines()
    assert [line for line in shown if line != "..."] == [line for line in printed[1] if line in shown]
    assert "mine" in (tmp_path / "second/metrics.csv").read_text()
    assert (tmp_path / "second/figures/arena_0-slam-map.png").exists()
