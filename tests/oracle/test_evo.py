"""evo on the same trajectories, in the plane and in space: absolute and relative errors, aligned and interpolated.

evo is under the GPL, so it is in no environment of ours: its numbers are recorded, and a slow test makes an environment
of its own for it and asks again.
"""

import json
import os
import subprocess
import sys
import zipfile

import pytest

from data.formats.results.reading import read_path
from eval.referee.given.runs import TruePath, given_run, truth_log
from eval.referee.space_scores import columns_in_space
from eval.score import main as score
from tests.oracle.evo_numbers import SAID, SAID_IN_SPACE, files, files_in_space

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


@pytest.fixture(scope="module")
def in_space(tmp_path_factory):
    folder = tmp_path_factory.mktemp("evo3")
    files_in_space(folder)
    return folder


@pytest.mark.parametrize("said", SAID_IN_SPACE, ids=lambda s: f"{s.call} {s.estimate}")
def test_its_recorded_numbers_in_space_are_ours(said, in_space):
    estimate, truth = (read_path(str(in_space / f"{name}.tum")) for name in (said.estimate, "truth"))
    run = given_run("a", "slam", {"final": estimate}, truth_log("truth", truth), TruePath.of(truth), align=said.align)
    ours = columns_in_space(run.space["final"])
    assert {n: ours[n] for n in said.numbers} == pytest.approx(said.numbers, rel=1e-9, abs=1e-9)
    if said.align in ("se3", "sim3"):  # without the alignment each fit is a number beside
        plain = given_run("a", "slam", {"final": estimate}, truth_log("truth", truth), TruePath.of(truth))
        beside = columns_in_space(plain.space["final"])
        for of, unit in (("position", "m"), ("rotation", "deg")):
            if f"rmse_{of}_3d_{unit}" in said.numbers:
                wanted = said.numbers[f"rmse_{of}_3d_{unit}"]
                assert beside[f"rmse_{of}_3d_{said.align}_{unit}"] == pytest.approx(wanted, rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("set_of", [(SAID, files), (SAID_IN_SPACE, files_in_space)], ids=["plane", "space"])
def test_the_recorded_numbers_are_what_it_says(set_of, request, tmp_path):
    recorded, write = set_of
    folder = tmp_path / "files"
    folder.mkdir()
    write(folder)
    place = request.config.cache.mkdir("evo")
    tool = place / VERSION / "bin"
    if not (tool / "evo_ape").exists():
        subprocess.run([sys.executable, "-m", "venv", place / VERSION], check=True, capture_output=True)
        made = subprocess.run([tool / "pip", "install", "-q", f"evo=={VERSION}"], capture_output=True, text=True)
        if made.returncode:
            pytest.skip(f"evo cannot be installed here: {made.stderr.strip().splitlines()[-1]}")
    environment = {**os.environ, "HOME": str(tmp_path)}  # it writes settings there
    for k, said in enumerate(recorded):
        name, *words = said.call.split()
        result = tmp_path / f"{k}.zip"
        given = [folder / "truth.tum", folder / f"{said.estimate}.tum", *words]
        more = ["--save_results", result, "--silent", "--no_warnings"]
        subprocess.run([tool / name, "tum", *given, *more], check=True, env=environment, capture_output=True)
        stats = json.loads(zipfile.ZipFile(result).read("stats.json"))
        for column, value in said.numbers.items():
            statistic = "rmse" if column.startswith("rpe") else column.partition("_")[0]
            assert float(stats[statistic]) == pytest.approx(value, rel=1e-9), (said.call, column)
