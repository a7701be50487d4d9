"""The command line takes what it says it takes, config files hold the same keys, and nonsense is refused by name."""

from __future__ import annotations

import argparse
import re
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from data.errors import UsageError
from eval.plan.flags.options import read_options
from eval.plan.flags.table import Options, help_text, parser
from eval.replay.flag import rows

ROOT = Path(__file__).parents[4]


def test_flags_and_config_keys_mean_the_same_and_flags_win(tmp_path):
    config = tmp_path / "run.toml"
    config.write_text(
        'log = ["arena:1", "arena:2"]\ntask = "slam"\nestimator = ["ekf", "batch"]\ngate = 0.95\ngate-known = 0.9999\n'
        'runs = 60\nseed = 7\njobs = 1\nquick = true\nformats = "csv,tex"\nno-plots = true\nout = "elsewhere"\n'
    )
    o = read_options(["--config", str(config)])
    s = o.selection
    assert (s.log, s.task, s.estimator) == (("arena:1", "arena:2"), ("slam",), ("ekf", "batch"))
    assert (o.setup.gate, o.setup.gate_known, o.study.runs, o.study.seed, o.execution.jobs) == (0.95, 0.9999, 60, 7, 1)
    out = o.output
    assert (out.quick, out.formats, out.no_plots, str(out.out)) == (True, ("csv", "tex"), True, "elsewhere")
    same = read_options([
        "--log", "arena:1", "--log", "arena:2", "--task", "slam", "--estimator", "ekf,batch", "--gate", "0.95",
        "--gate-known", "0.9999", "--runs", "60", "--seed", "7", "--jobs", "1", "--quick", "--formats", "csv,tex",
        "--no-plots", "--out", "elsewhere",
    ])  # fmt: skip
    assert same == o
    assert read_options(["--config", str(config), "--gate", "none", "--seed", "1"]).setup.gate is None
    assert read_options(["--config", str(config), "--seed", "1"]).study.seed == 1


@pytest.mark.parametrize(("arguments", "words"), [
    (["--gate", "1"], "between 0 and 1"),
    (["--gate", "0"], "between 0 and 1"),
    (["--gate-known", "-0.5"], "between 0 and 1"),
    (["--gate", "nan"], "between 0 and 1"),
    (["--gate", "wide"], "a number is needed"),
    (["--estimator", "ukf"], "known: dead-reckoning, ekf"),
    (["--association", "guess"], "known: known, nn, ml"),
    (["--task", "mapping"], "known: localization, slam"),
    (["--formats", "docx"], "known: csv, md, tex"),
    (["--estimator", "ekf,ekf"], "named twice"),
    (["--runs", "-1"], "negative"),
    (["--runs", "2.5"], "whole number"),
    (["--jobs", "0"], "at least one"),
    (["-q", "-v"], "exclude each other"),
    (["--animate", "--no-plots"], "--animate and --no-plots exclude each other"),
    (["--speed", "2"], "type --animate"),
    (["--config", "nowhere.toml"], "no such file"),
    (["--new-gate", "1"], "between 0 and 1"),
    (["--new-gate", "-0.1"], "between 0 and 1"),
    (["--association", "jcbb,jcbb"], "named twice"),
    (["--forget-after", "0"], "positive"),
    (["--deactivate-after", "inf"], "positive"),
    (["--deactivate-after", "60", "--forget-after", "30"], "less than --forget-after"),
    (["--full", "--quick"], "exclude each other"),
    (["--deactivate-after", "60", "--estimator", "ekf-invariant"], "moves all landmarks together"),
    (["--full", "--log", "arena:0"], "name no log"),
    (["--calibrate", "colour"], "known: scale, curvature"),
    (["--calibrate", "scale,scale=0.1"], "scale is named twice"),
    (["--calibrate", "scale=0"], "positive prior sigma"),
    (["--calibrate", "auto,scale"], "auto: unknown"),
    (["--calibrate="], "a name is needed"),
    (["--calibrate", "--scenario", "arena"], "exclude each other"),
    (["--calibrate", "--lab", "corridor:3"], "--calibrate and --lab exclude each other"),
])  # fmt: skip
def test_nonsense_is_refused_by_name(arguments, words):
    with pytest.raises(UsageError, match=words):
        read_options(arguments)


@pytest.mark.parametrize(("text", "words"), [
    ("lgo = 'x'", "unknown key 'lgo'"), ("quick = 1", "true or false"), ("runs = true", "whole number"),
    ("log = 3", "a list of names"),
    ("corridor = 3", "is a table"),
    ("task = [", "run.toml"), ("[variant]\nname = 'x'", "unknown key 'variant'"),
])  # fmt: skip
def test_a_config_file_with_faults_is_refused(tmp_path, text, words):
    config = tmp_path / "run.toml"
    config.write_text(text)
    with pytest.raises(UsageError, match=words):
        read_options(["--config", str(config)])


def test_a_table_of_constants_in_a_config_file_is_a_corridor(tmp_path):
    config = tmp_path / "run.toml"
    config.write_text('log = "arena:0"\n[corridor]\nseed = 4\npeople = true\nodometry = false\nrange = 8\n')
    assert read_options(["--config", str(config)]).selection.log == (
        "arena:0",
        "corridor:4:people=on+odometry=off+range=8",
    )


def children_cpu() -> float:
    """s of processor time that finished subprocesses used, on a busy machine as on an idle one."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def shown_help(*words: str) -> str:
    begin = children_cpu()
    done = subprocess.run([sys.executable, "slamref.py", *words], capture_output=True, text=True, cwd=ROOT, check=True)
    assert children_cpu() - begin < 0.5  # a tenth, unless the numerical libraries are imported
    return done.stdout


@pytest.mark.parametrize(("command", "positional"), [("run", "log"), ("lab", "lab"), ("study", "scenario")])
def test_every_example_of_everyday_use_is_a_command_that_can_be_read(monkeypatch, tmp_path, command, positional):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_run.toml").write_text("quick = true\n")
    examples = re.findall(r"^ +PROG (.+)$", help_text(positional), re.M)
    assert len(examples) >= 7
    for example in examples:
        read_options([w for w in example.split() if w != "--help-all"], f"slamref {command}", positional)


def test_help_of_all_flags_shows_an_example_of_each():
    examples = shown_help("run", "--help-all").split("examples:")[1]
    for action in parser()._actions:
        if action.dest not in (argparse.SUPPRESS, "help", "words", "open", "help_all"):
            assert any(s in examples.split() for s in action.option_strings), action.option_strings


def test_words_without_a_flag_are_logs_and_may_stand_between_flags():
    options = read_options(["arena:0", "--task", "slam", "arena:1", "--log", "arena:2"])
    assert options.selection.log == ("arena:0", "arena:1", "arena:2")
    assert read_options(["corridor:3"], positional="lab").selection.lab == "corridor:3"
    assert read_options(["arena", "--runs", "3"], positional="scenario").selection.scenario == ("arena",)
    with pytest.raises(UsageError, match="one lab is needed"):
        read_options(["corridor:3", "corridor:4"], positional="lab")


def test_help_imports_nothing_heavy():
    heavy = ("numpy", "gtsam", "numba", "pandas", "matplotlib")
    code = "import sys; from eval.plan.flags.table import parser; parser().format_help(); "
    code += f"print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize(("arguments", "config", "expected"), [
    (["--calibrate"], "calibrate = true", ("auto",)),
    (["--calibrate", "auto"], "calibrate = 'auto'", ("auto",)),
    (["--calibrate", "left,scale=0.05"], "calibrate = ['left', 'scale=0.05']", ("scale=0.05", "left")),
    ([], "calibrate = false", ()),
])  # fmt: skip
def test_errors_to_be_calibrated_are_named_or_left_to_the_log(tmp_path, arguments, config, expected):
    file = tmp_path / "run.toml"
    file.write_text(config)
    assert read_options([*arguments, "--no-plots"]).setup.calibrate == expected
    assert read_options(["--config", str(file)]).setup.calibrate == expected


def test_a_default_that_the_help_says_is_the_default():
    given = read_options([])
    said = {}
    for row in rows(Options).values():
        if found := re.search(r"\(default: (\d+(?:\.\d+)?)(?: [a-z]+)?\)", row.help):
            said[row.name] = float(found.group(1))
    assert {"font_size", "truth_gap"} <= said.keys()
    assert {name: rows(Options)[name].of(given) for name in said} == said
