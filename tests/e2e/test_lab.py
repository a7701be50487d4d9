"""A lab in one command, from end to end: answers with pictures, a text that LaTeX sets, and the same bytes again."""

import shutil
import subprocess

import pytest

from eval.run_all import main

DIFFERENT = {"timing.csv", "provenance.json", "run.log"}
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    folders = []
    for name in ("one", "two"):
        out = tmp_path_factory.mktemp("lab") / name
        assert main(["--lab", "corridor:3", "--write-up", "--lab-text", "-q", "--out", str(out), "--jobs", "2"]) == 0
        folders.append(out)
    return folders


def test_everything_but_measured_times_is_the_same_again(done):
    one, two = ({p.relative_to(d): p for p in d.rglob("*") if p.is_file()} for d in done)
    assert one.keys() == two.keys()
    for name, path in one.items():
        if name.name not in DIFFERENT and "lab-update-time" not in name.name:
            assert path.read_bytes() == two[name].read_bytes(), name


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="no pdflatex on this machine")
def test_the_write_up_compiles_with_one_page_for_each_answer_and_log(done):
    for _ in range(2):
        made = subprocess.run(
            ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "write-up.tex"], cwd=done[0],
            capture_output=True, text=True, check=False, errors="replace",
        )  # fmt: skip
        assert made.returncode == 0, made.stdout[-2000:]
    assert "Overfull" not in made.stdout
    assert "(11 pages" in made.stdout  # six answers, four logs, and what the tables mean
