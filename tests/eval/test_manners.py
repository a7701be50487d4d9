"""What a command does when something outside it goes wrong: full disks, closed pipes, strange packages, Ctrl-C."""

from __future__ import annotations

import errno
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from PIL import Image

import data.convert.__main__ as convert
from data import compiled
from eval import inspect, run_all, twin
from eval.plan import first_use, warming
from eval.studies import store
from wings.labs.stepping import command as step

ROOT = Path(__file__).parents[2]
RUN = ["--log", "linear:0", "--estimator", "ekf,batch", "--association", "known", "--jobs", "1", "-q"]


def full(*_, **__):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize(("owner", "name", "more"), [
    (pd.DataFrame, "to_csv", ["--no-plots"]), (Path, "mkdir", ["--no-plots"]),
    pytest.param(np, "savetxt", ["--no-plots"], marks=pytest.mark.slow),
    pytest.param(Path, "write_text", ["--no-plots"], marks=pytest.mark.slow),
    pytest.param(Image.Image, "save", ["--quick"], marks=pytest.mark.slow),
])  # fmt: skip
def test_a_full_disk_is_one_line_and_status_2_wherever_it_is_noticed(owner, name, more, tmp_path, monkeypatch, capsys):
    out = tmp_path / "report"
    monkeypatch.setattr(owner, name, full)
    assert run_all.main([*RUN, "--out", str(out), *more]) == 2
    said = capsys.readouterr().err
    assert "No space left on device" in said
    assert said.count("\n") == 1
    monkeypatch.undo()
    assert list(tmp_path.iterdir()) == []  # nothing half-written is left


def test_every_command_that_writes_says_so_when_the_disk_is_full(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(Path, "mkdir", full)
    monkeypatch.setattr(Path, "write_text", full)
    monkeypatch.setattr(Image.Image, "save", full)
    out = str(tmp_path / "out")
    for main, words in (
        (convert.main, ["linear", out]), (inspect.main, ["linear:0", "--plot", f"{out}.png"]),
        (step.main, ["--log", "linear:0", "--association", "known", "--save", out, "--run-through"]),
        (twin.main, ["linear:0", out]),
    ):  # fmt: skip
        assert main(words) == 2, words
        said = capsys.readouterr().err
        assert "No space left on device" in said, words
        assert said.count("\n") == 1, said


@pytest.mark.slow
@pytest.mark.parametrize("words", [
    "inspect linear:0", "step --log linear:0 --association known --frames 9", "run --help", "--help",
    "run --log linear:0 --estimator ekf --no-plots --jobs 1 --out {out}", "convert linear {out}", "twin linear:0 {out}",
])  # fmt: skip
def test_a_reader_that_has_seen_enough_is_no_error_and_what_was_asked_for_is_done(words, tmp_path):
    out = tmp_path / "out"
    command = f"{sys.executable} -m slamref {words.format(out=out)} | head -1"
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True, cwd=ROOT, check=True)
    assert done.stderr == ""
    assert done.stdout.count("\n") == 1
    if "{out}" in words:
        assert out.is_dir()


def strange(folder: Path) -> Path:
    """A folder with packages of other people."""
    for name in ("data", "eval", "graph", "association", "ekf"):
        (folder / name).mkdir()
        (folder / name / "__init__.py").write_text("raise SystemExit('a stranger')\n")
    return folder


def test_the_command_is_ours_whatever_lies_in_the_working_directory(tmp_path):
    """As the script `slamref` does it: its folder, not the working directory, comes first on the path."""
    code = "import sys, slamref; sys.path.insert(0, ''); sys.exit(slamref.main(['inspect', '--help']))"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    environment |= {"PYTHONSAFEPATH": "1"}
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=strange(tmp_path),
        capture_output=True,
        text=True,
        env=environment,
        check=False,
    )
    assert done.stdout.startswith("usage: slamref inspect"), done.stderr
    assert done.returncode == 0


def test_python_dash_m_with_a_strange_package_says_which_and_where(tmp_path):
    """There the working directory comes first by Python's own rule."""
    strange(tmp_path)
    shutil.rmtree(tmp_path / "eval")
    done = subprocess.run(
        [sys.executable, "-m", "eval.run_all"], cwd=tmp_path, capture_output=True, text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)}, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr.startswith(f"slamref: the package 'association' found first is {tmp_path / 'association'}")
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize("module", [
    "eval.run_all", "data.convert.__main__", *(pytest.param(f"eval.{name}", marks=pytest.mark.slow) for name in (
        "step", "twin", "tune", "inspect", "benchmark", "warm")),
])  # fmt: skip
def test_without_its_libraries_a_command_says_what_to_install(module, tmp_path):
    words = {"eval.step": ["--log", "linear:0"], "eval.twin": ["linear:0", str(tmp_path / "o")],
             "eval.tune": ["linear:0", str(tmp_path / "o")], "eval.inspect": ["linear:0"],
             "data.convert.__main__": ["linear", str(tmp_path / "o")]}.get(module, [])  # fmt: skip
    code = (
        "import sys\nclass Nothing:\n"
        "    def find_spec(self, name, *_):\n"
        f"        if name.partition('.')[0] in {LIBRARIES!r}:\n"
        "            raise ModuleNotFoundError(f'No module named {name!r}', name=name)\n"
        f"sys.meta_path.insert(0, Nothing())\nfrom {module} import main\nsys.exit(main({words!r}))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert " is not installed for " in done.stderr
    assert done.stderr.count("\n") == 1


LIBRARIES = ("numpy", "numba", "scipy", "pandas", "gtsam", "matplotlib", "joblib", "threadpoolctl", "tqdm", "cv2",
             "llvmlite")  # fmt: skip


def test_who_interrupts_a_study_hears_what_is_kept(tmp_path, monkeypatch, capsys):
    folder = tmp_path / ".studies" / "arena-x-y"
    folder.mkdir(parents=True)

    def interrupted(*_):
        for seed in range(3):
            (folder / f"{seed}.npz").touch()
        (folder / ".3.partial-1.npz").touch()
        raise KeyboardInterrupt

    monkeypatch.setattr("eval.report.steps.execute", interrupted)
    assert run_all.main(["--scenario", "linear", "--runs", "5", "-q", "--out", str(tmp_path / "report")]) == 130
    said = capsys.readouterr().err
    assert said.startswith("interrupted; the report is as it was; 3 runs done since the start are kept in ")
    assert said.endswith(": the same command goes on from there\n")
    assert store.kept_since(tmp_path, time.time() + 9.0) == "nothing was changed"


def test_the_first_use_compiles_with_progress_and_later_ones_do_not(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(compiled, "base", lambda: tmp_path)
    for module in (warming, first_use):
        monkeypatch.setattr(module, "base", lambda: tmp_path)
    monkeypatch.setattr("eval.plan.warming.PARTS", {"one": lambda: None, "two": lambda: None})
    warming.compile_if_needed()
    said = capsys.readouterr().err
    assert said.splitlines()[0].startswith("first use: compiling the numerical kernels")
    assert "compiling, part 2 of 2: two\n" in said
    assert compiled.mark().exists()
    (tmp_path / "ekf.kernels-0").mkdir()
    (tmp_path / "ekf.kernels-0" / "kernel.nbi").touch()
    warming.compile_if_needed()
    assert capsys.readouterr() == ("", "")
    (tmp_path / "ekf.kernels-0" / "kernel.nbi").unlink()  # a cache that was cleared is no cache
    warming.compile_if_needed(quiet=True)
    assert capsys.readouterr() == ("", "")
