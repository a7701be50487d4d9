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
