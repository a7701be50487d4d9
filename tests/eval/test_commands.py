"""Every command: its help, slips answered with what is right, full disks and closed pipes, Ctrl-C."""

import contextlib
import errno
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from PIL import Image

import data.convert.__main__ as convert
import slamref
from data import compiled
from data.command import Parser
from data.convert.__main__ import SOURCES
from data.errors import UsageError
from data.terminal import INTERRUPTED
from eval import inspect, open_report, run_all, twin
from eval.plan import first_use, warming
from eval.plan.flags import options as flags
from eval.run_all import heeding_interruption
from eval.studies import store
from tests.builders.processes import python
from tests.data.formats.mrclam import world
from tests.data.formats.mrclam.world import save_folder, save_zip
from tests.quick import slow
from wings.labs.stepping import command as step

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
    "grade": "wings.grade.command",
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


@pytest.mark.parametrize(("module", "arguments"), [
    *((module, ["--help"]) for module in (*COMMANDS.values(), "wings.robot.simulate")),
    *(("slamref", [*name, "--help"]) for name in ([], ["lab"], ["study"])),
    *(slow("slamref", [name, "--help"]) for name in COMMANDS),
])  # fmt: skip
def test_help_answers_at_once_and_loads_nothing_heavy(module, arguments):
    done = python("-c", HELP.format(module=module, arguments=arguments, heavy=HEAVY, most=MODULES))
    assert done.stdout.startswith("usage: ")
    assert done.stdout.endswith("\n[] True\n"), done.stdout[-200:] + done.stderr


MODULES_TOO = [c for c in COMMANDS.items() if c[0] not in ("audit", "camera", "detect", "grade")]


@pytest.mark.parametrize(("name", "module"), [c if c[0] in ("run", "convert") else slow(*c) for c in MODULES_TOO])
def test_a_subcommand_is_the_module_under_another_name(name, module):
    module = f"eval.{name}" if module.startswith("wings.") else module.removesuffix(".__main__")
    ours, theirs = (" ".join(python("-m", *words, "--help").stdout.split()) for words in (["slamref", name], [module]))
    assert ours.startswith(f"usage: slamref {name} ")
    assert theirs.startswith(f"usage: python -m {module} ")
    assert ours.replace(f"slamref {name}", f"python -m {module}") == theirs


@pytest.mark.parametrize(("name", "wrong", "words"), [
    ("run", ["--gate", "1"], "slamref: --gate 1: a probability"), ("step", [], "slamref: no log: one log is needed"),
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
    ("slamref ru", {"run "}), ("slamref run --es", {"--estimator "}), ("slamref score --ali", {"--align "}),
    ("slamref lab --write", {"--write-up "}), ("slamref convert mrc", {"mrclam "}),
])  # fmt: skip
def test_the_shell_completes_commands_and_flags(line, expected):
    environment = os.environ | {"COMP_LINE": line, "COMP_POINT": str(len(line)), "_ARGCOMPLETE": "1"}
    with tempfile.NamedTemporaryFile("r") as answer:
        environment["_ARGCOMPLETE_STDOUT_FILENAME"] = answer.name
        subprocess.run([sys.executable, "slamref.py"], env=environment, cwd=ROOT, check=False)
        assert set(answer.read().split("\x0b")) == expected


def test_a_report_is_opened_in_the_browser_or_its_address_is_printed(tmp_path, monkeypatch, capsys, refused):
    opened = []
    monkeypatch.setattr(open_report.webbrowser, "open", lambda address: opened.append(address) or len(opened) == 1)
    assert "no report.html" in refused(open_report.main, [str(tmp_path)])
    (tmp_path / "report.html").write_text("<p>")
    assert open_report.main([str(tmp_path)]) == 0
    assert capsys.readouterr().out == ""
    assert open_report.main([str(tmp_path)]) == 0
    assert opened[1] in capsys.readouterr().out


ODOMETRY, SEEN = "t,v,omega\n0,1,0\n1,1,0\n", "t,range,bearing\n0,2,0\n1,2,0.1\n"
TABLE = "convert table odo.csv out --observations seen.csv --odometry-sigma .05,.02 --observation-sigma .1,1deg"


@pytest.fixture
def said(tmp_path, monkeypatch, refused):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(first_use, "start", lambda options: "")  # kernels of another state are no slip
    (tmp_path / "odo.csv").write_text(ODOMETRY)
    (tmp_path / "seen.csv").write_text(SEEN)
    return lambda line: refused(slamref.main, line.split())


@pytest.mark.parametrize(("line", "hint"), [
    ("run arena:0 --estimator EKF", "did you mean ekf?"), ("run arena:0 --association JCBB", "did you mean jcbb?"),
    ("run arena:0 --calibrate scal", "did you mean scale?"),
    ("run arena:0 --estimators ekf", "did you mean --estimator?"), ("run coridor:3", "Did you mean corridor:3?"),
    ("run arena", "the seed is missing, as in arena:0"), ("run corridor:0:peopel", "did you mean people?"),
    ("run arena:0:landmark=3", "did you mean landmarks?"),
    ("run arena:0:sensor=relative-point", "did you mean relative_point?"),
    ("run corridor:0:people,no-odometry", "as in corridor:0:people+no-odometry"),
    ("run corridor:0:frames=8,people", "as in corridor:0:frames=8+people"),
    ("run arena:0 --gate 9.21", "is --gate 0.99"), ("run arena:0 --new-gate 99.9", "99.9 % is --new-gate 0.999"),
    ("run arena:0 --gate high", "a number is needed, as in --gate 0.5"),
    ("run arena:0 --estimator", "--estimator: expected one argument"),
    ("run odo.csv", "type slamref convert table odo.csv LOG"), ("study aren", "did you mean arena?"),
    ("study corridor --runs many", "a whole number is needed, as in --runs 1"),
    ("lab corridor", "did you mean corridor:0?"), ("step arena:0 --lab", "did you mean --lab-text?"),
    ("check EKF", "did you mean ekf?"), ("tune arena:0 out --fit nosie", "unknown"),
    ("convert arena out --seeds 3", "did you mean --seed?"),
    ("convert arena out --frames lots", "--frames: invalid int value: 'lots'"),
    ("live --link /dev/x --out y --drive wals", "did you mean walls?"),
    (f"{TABLE} --unit time=msec", "did you mean ms?"), (f"{TABLE} --unit bearings=deg", "did you mean bearing?"),
    (f"{TABLE} --columns omga=omega", "did you mean omega?"),
    (f"{TABLE} --columns odometri.t=t", "did you mean odometry?"),
    (f"{TABLE} --columns omega=omga", "did you mean omega?"),
    (f"{TABLE} --odometry-kind velocity", "did you mean velocities?"),
    (f"{TABLE} --odometry-noise densty", "did you mean density?"), (f"{TABLE} --unit v=kmhr", "did you mean km/h?"),
    (f"{TABLE} --tick-wrap 65536", "of wheel ticks; the odometry has velocities"),
    ("run arena:0 -estimator ekf", "did you mean --estimator?"),
    ("convert table a.csv out --exclude-truth 1:2", "a flag of slamref run, slamref score, slamref convert mrclam"),
    ("run arena0", "Did you mean arena:0?"), ("runn arena:0", "Did you mean run?"),
    ("benchmark quick", "a word too many"),
])  # fmt: skip
def test_a_slip_is_answered_with_what_is_right(said, line, hint):
    assert hint in said(line)


def test_flags_are_never_abbreviated_and_a_value_may_begin_with_a_minus(said, tmp_path):
    assert "--lab: unknown flag" in said("step arena:0 --lab")
    assert slamref.main(f"{TABLE} --view -1,0.75".split()) == 0
    assert slamref.main(f"{TABLE} --view -60deg,60deg".split()) == 0
    assert "the smaller bearing first" in said(f"{TABLE} --view 1,-0.75")


def test_a_recording_that_is_no_log_is_answered_with_its_conversion(said, tmp_path):
    save_zip(tmp_path / "set.zip", world.texts())
    save_folder(tmp_path / "set", world.texts())
    for command in ("run", "run --log", "step", "play"):
        for source in ("set.zip", "set"):
            assert f"type slamref convert mrclam {source} LOG --robot 1" in said(f"{command} {source}")


@pytest.mark.parametrize("command", ["play", "run", "step", "inspect"])
def test_a_result_folder_is_no_log_and_names_its_logs(command, said, tmp_path):
    (tmp_path / "r").mkdir()
    (tmp_path / "r/provenance.json").write_text(json.dumps({"inputs": {"arena:0": {}, "my_log": {}}}))
    assert "a result folder; type slamref report r, or name one of its logs" in said(f"{command} r")


def test_python_names_the_nearest_too():
    inputs = slamref.open_log("arena:0:frames=4").inputs(labels=True)
    for function, hint in (
        (lambda: slamref.compare(inputs, "slam", ["EKF"]), "did you mean ekf?"),
        (lambda: slamref.compare(inputs, "SLAM", ["ekf"]), "did you mean slam?"),
        (lambda: slamref.compare(inputs, "slam", ["ekf"], "JCBB"), "did you mean jcbb?"),
        (lambda: slamref.compare(slamref.open_log("arena:0"), "slam", ["ekf"]), r"log\.inputs\(labels=True\)"),
    ):
        with pytest.raises(UsageError, match=hint.replace("?", r"\?")):
            function()


RUN = ["--log", "linear:0", "--estimator", "ekf,batch", "--association", "known", "--jobs", "1", "-q"]


def full(*_, **__):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize(("owner", "name", "more"), [
    (pd.DataFrame, "to_csv", ["--no-plots"]), (Path, "mkdir", ["--no-plots"]),
    pytest.param(np, "savetxt", ["--no-plots"], marks=pytest.mark.slow),
    pytest.param(Path, "write_text", ["--no-plots"], marks=pytest.mark.slow),
    pytest.param(Image.Image, "save", ["--quick"], marks=pytest.mark.slow),
])  # fmt: skip
def test_a_full_disk_is_one_line_and_status_2_wherever_it_is_noticed(owner, name, more, tmp_path, monkeypatch, refused):
    out = tmp_path / "report"
    monkeypatch.setattr(owner, name, full)
    assert "No space left on device" in refused(run_all.main, [*RUN, "--out", str(out), *more])
    monkeypatch.undo()
    assert list(tmp_path.iterdir()) == []  # nothing half-written is left


def test_every_command_that_writes_says_so_when_the_disk_is_full(tmp_path, monkeypatch, refused):
    monkeypatch.setattr(Path, "mkdir", full)
    monkeypatch.setattr(Path, "write_text", full)
    monkeypatch.setattr(Image.Image, "save", full)
    out = str(tmp_path / "out")
    for main, words in (
        (convert.main, ["linear", out]), (inspect.main, ["linear:0", "--plot", f"{out}.png"]),
        (step.main, ["--log", "linear:0", "--association", "known", "--save", out, "--run-through"]),
        (twin.main, ["linear:0", out]),
    ):  # fmt: skip
        assert "No space left on device" in refused(main, words), words


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
    for name in ("data", "eval", "graph", "association", "ekf"):
        (folder / name).mkdir()
        (folder / name / "__init__.py").write_text("raise SystemExit('a stranger')\n")
    return folder


def test_the_command_is_ours_whatever_lies_in_the_working_directory(tmp_path):
    """As the script `slamref` does it: its folder, not the working directory, comes first on the path."""
    code = "import sys, slamref; sys.path.insert(0, ''); sys.exit(slamref.main(['inspect', '--help']))"
    done = python("-c", code, cwd=strange(tmp_path), PYTHONPATH=str(ROOT), PYTHONSAFEPATH="1")
    assert done.stdout.startswith("usage: slamref inspect"), done.stderr
    assert done.returncode == 0


def test_python_dash_m_with_a_strange_package_says_which_and_where(tmp_path):
    """There the working directory comes first by Python's own rule."""
    strange(tmp_path)
    shutil.rmtree(tmp_path / "eval")
    done = python("-m", "eval.run_all", cwd=tmp_path, PYTHONPATH=str(ROOT))
    assert done.returncode == 2
    assert done.stderr.startswith(f"slamref: the package 'association' found first is {tmp_path / 'association'}")
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize("module", [
    "eval.run_all", "data.convert.__main__", "wings.labs.stepping.command",
    *(pytest.param(f"eval.{name}", marks=pytest.mark.slow) for name in (
        "twin", "tune", "inspect", "benchmark", "warm")),
])  # fmt: skip
def test_without_its_libraries_a_command_says_what_to_install(module, tmp_path):
    words = {"wings.labs.stepping.command": ["--log", "linear:0"], "eval.twin": ["linear:0", str(tmp_path / "o")],
             "eval.tune": ["linear:0", str(tmp_path / "o")], "eval.inspect": ["linear:0"],
             "data.convert.__main__": ["linear", str(tmp_path / "o")]}.get(module, [])  # fmt: skip
    code = (
        "import sys\nclass Nothing:\n"
        "    def find_spec(self, name, *_):\n"
        f"        if name.partition('.')[0] in {LIBRARIES!r}:\n"
        "            raise ModuleNotFoundError(f'No module named {name!r}', name=name)\n"
        f"sys.meta_path.insert(0, Nothing())\nfrom {module} import main\nsys.exit(main({words!r}))\n"
    )
    done = python("-c", code)
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


def press():
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(1)


def turned_into_another_exception():
    with heeding_interruption():
        try:
            press()
        except KeyboardInterrupt:
            raise SystemError("a compiled function returned a result with an exception set") from None


def lost():
    with heeding_interruption() as check:
        with contextlib.suppress(KeyboardInterrupt):
            press()
        check()


@pytest.mark.parametrize("work", [turned_into_another_exception, lost])
def test_a_library_cannot_hide_it(work):
    with pytest.raises(KeyboardInterrupt):
        work()


def test_pressed_while_the_command_line_is_read_it_is_not_lost(tmp_path, monkeypatch, capsys):
    read = run_all.read_options

    def pressed_while_modules_are_loaded(*arguments):
        with contextlib.suppress(KeyboardInterrupt):
            press()
        return read(*arguments)

    monkeypatch.setattr(run_all, "read_options", pressed_while_modules_are_loaded)
    words = ["--log", "linear:0", "--task", "slam", "--estimator", "ekf", "--out", str(tmp_path / "report")]
    assert run_all.main(words) == INTERRUPTED
    assert "interrupted" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


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
