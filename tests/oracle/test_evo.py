"""evo on the same trajectories: its absolute and relative errors, with and without alignment and interpolation.

evo is under the GPL, so it is in no environment of ours: its numbers are recorded, and a slow test makes an environment
of its own for it and asks again.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile

import pytest

from eval.score import main as score
from tests.oracle.evo_numbers import SAID, files

VERSION = "1.38.1"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("evo")
    files(folder)
    return folder


@pytest.mark.parametrize("said", SAID, ids=lambda s: s.call)
def test_its_recorded_numbers_are_ours(said, folder, capsys):
    command = [str(folder / f"{said.estimate}.tum"), str(folder / "truth.tum"), "--align", said.align]
    assert score(command) == 0
    ours = dict(line.split() for line in capsys.readouterr().out.splitlines())
    assert {n: float(ours[n]) for n in said.numbers} == pytest.approx(said.numbers, rel=5e-6)  # six digits are printed


@pytest.mark.slow
def test_the_recorded_numbers_are_what_it_says(folder, request, tmp_path):
    place = request.config.cache.mkdir("evo")
    tool = place / VERSION / "bin"
    if not (tool / "evo_ape").exists():
        subprocess.run([sys.executable, "-m", "venv", place / VERSION], check=True, capture_output=True)
        made = subprocess.run([tool / "pip", "install", "-q", f"evo=={VERSION}"], capture_output=True, text=True)
        if made.returncode:
            pytest.skip(f"evo cannot be installed here: {made.stderr.strip().splitlines()[-1]}")
    environment = {**os.environ, "HOME": str(tmp_path)}  # it writes settings there
    for k, said in enumerate(SAID):
        name, *words = said.call.split()
        result = tmp_path / f"{k}.zip"
        given = [folder / "truth.tum", folder / f"{said.estimate}.tum", *words]
        more = ["--save_results", result, "--silent", "--no_warnings"]
        subprocess.run([tool / name, "tum", *given, *more], check=True, env=environment, capture_output=True)
        stats = json.loads(zipfile.ZipFile(result).read("stats.json"))
        for column, value in said.numbers.items():
            statistic = "rmse" if column.startswith("rpe") else column.partition("_")[0]
            assert float(stats[statistic]) == pytest.approx(value, rel=1e-9), (said.call, column)
