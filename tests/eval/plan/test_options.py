"""The command line and config files: one table of flags, nonsense refused by name, gates, defaults by the log."""

import argparse
import math
import re
import shlex
from dataclasses import replace

import pytest
from hypothesis import given, strategies as st

from data.errors import UsageError
from data.formats.open_log import write_folder
from data.logs import open_log
from eval.plan.experiments import make_plan
from eval.plan.flags.options import read_options
from eval.plan.flags.table import HELP, LARGEST, SMALLEST, TYPE, Options, inches, parser, points, width
from eval.plan.provenance import command_of
from eval.replay.flag import names, rows
from eval.replay.settings import ASSOCIATIONS, ESTIMATORS, TASKS, Setup
from eval.studies.scenario import load_scenario
from tests.builders.processes import python
from tests.ekf.lines.world import line_log
from wings.labs.stepping.command import read


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
    (["--gate", "1"], "between 0 and 1"), (["--gate", "0"], "between 0 and 1"),
    (["--gate-known", "-0.5"], "between 0 and 1"), (["--gate", "nan"], "between 0 and 1"),
    (["--gate", "wide"], "a number is needed"), (["--estimator", "ukf"], "known: dead-reckoning, ekf"),
    (["--association", "guess"], "known: known, nn, ml"), (["--task", "mapping"], "known: localization, slam"),
    (["--formats", "docx"], "known: csv, md, tex"), (["--estimator", "ekf,ekf"], "named twice"),
    (["--runs", "-1"], "negative"), (["--runs", "2.5"], "whole number"), (["--jobs", "0"], "at least one"),
    (["-q", "-v"], "exclude each other"), (["--animate", "--no-plots"], "--animate and --no-plots exclude each other"),
    (["--speed", "2"], "type --animate"), (["--config", "nowhere.toml"], "no such file"),
    (["--new-gate", "1"], "between 0 and 1"), (["--new-gate", "-0.1"], "between 0 and 1"),
    (["--association", "jcbb,jcbb"], "named twice"), (["--forget-after", "0"], "positive"),
    (["--deactivate-after", "inf"], "positive"),
    (["--deactivate-after", "60", "--forget-after", "30"], "less than --forget-after"),
    (["--full", "--quick"], "exclude each other"),
    (["--deactivate-after", "60", "--estimator", "ekf-invariant"], "moves all landmarks together"),
    (["--full", "--log", "arena:0"], "name no log"), (["--calibrate", "colour"], "known: scale, curvature"),
    (["--calibrate", "scale,scale=0.1"], "scale is named twice"), (["--calibrate", "scale=0"], "positive prior sigma"),
    (["--calibrate", "auto,scale"], "auto: unknown"), (["--calibrate="], "a name is needed"),
    (["--calibrate", "--scenario", "arena"], "exclude each other"),
    (["--calibrate", "--lab", "corridor:3"], "--calibrate and --lab exclude each other"),
])  # fmt: skip
def test_nonsense_is_refused_by_name(arguments, words):
    with pytest.raises(UsageError, match=words):
        read_options(arguments)


@pytest.mark.parametrize(("text", "words"), [
    ("lgo = 'x'", "unknown key 'lgo'"), ("quick = 1", "true or false"), ("runs = true", "whole number"),
    ("log = 3", "a list of names"),
    ("task = [", "run.toml"), ("[variant]\nname = 'x'", "unknown key 'variant'"),
])  # fmt: skip
def test_a_config_file_with_faults_is_refused(tmp_path, text, words):
    config = tmp_path / "run.toml"
    config.write_text(text)
    with pytest.raises(UsageError, match=words):
        read_options(["--config", str(config)])


def shown_help(*words: str) -> str:
    done = python("-X", "importtime", "slamref.py", *words)
    assert " numpy\n" not in done.stderr
    return done.stdout


def test_words_without_a_flag_are_logs_and_may_stand_between_flags():
    options = read_options(["arena:0", "--task", "slam", "arena:1", "--log", "arena:2"])
    assert options.selection.log == ("arena:0", "arena:1", "arena:2")
    assert read_options(["corridor:3"], positional="lab").selection.lab == "corridor:3"
    assert read_options(["arena", "--runs", "3"], positional="scenario").selection.scenario == ("arena",)
    with pytest.raises(UsageError, match="one lab is needed"):
        read_options(["corridor:3", "corridor:4"], positional="lab")


@pytest.mark.parametrize(("arguments", "config", "expected"), [
    (["--calibrate"], "calibrate = true", ("auto",)), (["--calibrate", "auto"], "calibrate = 'auto'", ("auto",)),
    (["--calibrate", "left,scale=0.05"], "calibrate = ['left', 'scale=0.05']", ("scale=0.05", "left")),
    ([], "calibrate = false", ()),
])  # fmt: skip
def test_errors_to_be_calibrated_are_named_or_left_to_the_log(tmp_path, arguments, config, expected):
    file = tmp_path / "run.toml"
    file.write_text(config)
    assert read_options([*arguments, "--no-plots"]).setup.calibrate == expected
    assert read_options(["--config", str(file)]).setup.calibrate == expected


POSITIONAL = {"run": "log", "lab": "lab", "study": "scenario"}
TABLE = rows(Options)


def some(known: tuple[str, ...]) -> st.SearchStrategy[str]:
    return st.lists(st.sampled_from(known), min_size=1, unique=True).map(",".join)


PATHS = st.text("ab ';$\"-=é", min_size=1).filter(lambda t: t == t.strip())
SPANS = st.floats(1e-9, 1e9).map(str)
GATES = st.one_of(st.just("none"), st.floats(1e-9, 1 - 1e-9).map(str))
VALUES = {
    **dict.fromkeys(("log", "data", "scenario", "lab"), PATHS),
    "task": some(TASKS), "estimator": some(ESTIMATORS), "association": some(ASSOCIATIONS),
    **dict.fromkeys(("gate", "new_gate", "gate_known", "gate_poses"), GATES),
    **dict.fromkeys(("forget_after", "deactivate_after", "lag", "keyframe_distance"), SPANS),
    "hypotheses": st.integers(1, 10**9).map(str),
    **dict.fromkeys(("runs", "seed", "twins"), st.integers(0, 10**9).map(str)),
    "camera_translation": st.sampled_from(("cm", "mm", "m")),
    "camera_reading": st.sampled_from(("to-camera", "to-body")),
    "corner_noise": st.sampled_from(("lab", "depth")),
    "relations": PATHS, "maintain_by": PATHS,
    "exclude_truth": st.sampled_from(("1:2", "-3:0.5", "755:836")),
    **dict.fromkeys(("result", "truth", "cov", "times", "time_offset"), PATHS),
    **dict.fromkeys(("cov_frame", "cov_order", "axes", "unit"), PATHS),
    "align": st.sampled_from(("none", "first", "se2", "se3", "sim3", "yaw")),
    "pairs": st.sampled_from(("evo", "rpg", "openvins")), "truth_gap": SPANS,
    "calibrate": st.one_of(st.just("auto"), some(("scale", "curvature=0.02", "left", "drift=1e-3", "bearing"))),
}  # fmt: skip
"""Words for every row that takes a value and changes the numbers."""
CHANGED = {
    "log": "a b", "data": "a b", "scenario": "a b", "lab": "a b", "task": "slam", "estimator": "ekf,batch",
    "association": "known,nn",
    "gate": "0.9", "new_gate": "0.9999999", "gate_known": "0.999", "gate_poses": "0.9",
    "forget_after": "12.5", "deactivate_after": "12.5",
    "lag": "1e-07", "keyframe_distance": "0.8", "hypotheses": "3",
    "runs": "0", "seed": "7", "twins": "9", "camera_translation": "m", "camera_reading": "to-body",
    "corner_noise": "depth", "relations": "a b", "maintain_by": "a b.py:rule", "exclude_truth": "3:4.5",
    "result": "a=a b", "truth": "a b", "cov": "a=b", "times": "a b", "cov_frame": "local", "axes": "camera",
    "cov_order": "rotation-first", "unit": "ns", "pairs": "rpg",
    "align": "se2", "truth_gap": "0.2", "time_offset": "auto", "calibrate": "curvature=0.02,scale",
}  # fmt: skip
"""For each of them one that is not the default."""
NUMBERS = [row.name for row in TABLE.values() if row.numbers]


def words(name: str, value: str) -> list[str]:
    row = TABLE[name]
    return [f"{row.option}={value}"] if row.metavar else [row.option]


def again(options: Options) -> Options:
    command = shlex.split(command_of(options))
    assert command[0] == "slamref"
    return read_options(command[2:], positional=POSITIONAL[command[1]])


def test_every_row_that_changes_the_numbers_is_tried_here():
    assert {name for name in NUMBERS if TABLE[name].metavar} == set(VALUES) == set(CHANGED)
    assert {"trust_pickle", "gate_smoothers", "maintain", "in_view", "quick", "full"} < set(NUMBERS)
    assert not {"out", "jobs", "scheduler", "formats", "no_plots", "animate", "quiet", "verbose"} & set(NUMBERS)


@pytest.mark.parametrize("name", NUMBERS)
def test_what_changes_the_numbers_is_in_the_command(name):
    options = read_options(words(name, CHANGED.get(name, "")))
    assert TABLE[name].of(options) != TABLE[name].default
    assert name in POSITIONAL.values() or TABLE[name].option in command_of(options).split()
    assert again(options) == options


@given(st.data())
def test_reading_the_command_again_gives_the_same_options(data):
    given_names = data.draw(st.lists(st.sampled_from(NUMBERS), unique=True, max_size=8))
    arguments = [w for n in given_names for w in words(n, data.draw(VALUES.get(n, st.just(""))))]
    try:
        options = read_options(arguments)
    except UsageError:
        return  # they exclude each other
    assert again(options) == options


def test_a_file_is_spelled_out_and_takes_every_row_of_the_table(tmp_path):
    config = tmp_path / "run.toml"
    config.write_text('log = ["arena:1"]\ngate_smoothers = false\ngate_known = 0.999\n')
    options = read_options(["--config", str(config)])
    config.unlink()
    assert again(options) == options
    assert "--no-gate-smoothers" in command_of(options)
    config = tmp_path / "run.toml"
    config.write_text("gate = 0.5\nconfig = 'x'\n")
    with pytest.raises(UsageError, match="unknown key 'config'"):
        read_options(["--config", str(config)])


def test_every_row_is_explained_with_an_example_and_its_default():
    text = "".join(parser().format_help().split())
    for row in rows(Options).values():
        assert "".join(HELP[row.name].split()) in text, row.name
    assert rows(Setup).keys() < rows(Options).keys()
    examples = shown_help("run", "--help-all").split("examples:")[1]
    for action in parser()._actions:
        if action.dest not in (argparse.SUPPRESS, "help", "words", "open", "help_all"):
            assert any(s in examples.split() for s in action.option_strings), action.option_strings
    given = read_options([])
    said = {}
    for row in rows(Options).values():
        if found := re.search(r"\(default: (\d+(?:\.\d+)?)(?: [a-z]+)?\)", HELP[row.name]):
            said[row.name] = float(found.group(1))
    assert {"font_size"} <= said.keys()
    assert {name: rows(Options)[name].of(given) for name in said} == said


@pytest.mark.parametrize(
    ("length", "value"), [("3.4in", 3.4), ("8.636 cm", 3.4), ("86.36mm", 3.4), ("252pt", 252 / 72.27), (" 2 in ", 2.0)]
)
def test_a_length_is_read_in_inches_centimetres_millimetres_or_points(length, value):
    assert inches(length) == pytest.approx(value, rel=1e-3)


@pytest.mark.parametrize("length", ["3.4", "in", "3.4 feet", "1.2.3in", "-3in", ""])
def test_what_is_no_length_is_refused_with_examples(length):
    assert math.isnan(inches(length))
    with pytest.raises(UsageError, match=r"3\.4in, 8\.6cm"):
        width("--figure-width", length)


def test_lengths_and_sizes_of_type_have_their_limits_and_columns_are_named_once():
    assert width("--w", "3.4 in") == "3.4in"
    for edge in (SMALLEST, LARGEST):
        assert width("--w", f"{edge}in") == f"{edge}in"
    for beyond in (0.99 * SMALLEST, 1.01 * LARGEST):
        with pytest.raises(UsageError, match=f"between {SMALLEST:g}in and {LARGEST:g}in"):
            width("--w", f"{beyond}in")
    assert [points("--f", t) for t in TYPE] == list(TYPE)
    for beyond in (0.99 * TYPE[0], 1.01 * TYPE[1], 0.0, -8.0):
        with pytest.raises(UsageError, match="--f"):
            points("--f", beyond)
    with pytest.raises(UsageError, match=f"between {TYPE[0]:g} and {TYPE[1]:g} points"):
        points("--f", 2.0 * TYPE[1])
    columns = names()
    assert columns("--columns", "a, b,,c") == ("a", "b", "c")
    with pytest.raises(UsageError, match="named twice"):
        columns("--columns", "a,b,a")


@pytest.mark.parametrize("arguments", [
    ["--gate", "0.999", "--new-gate", "0.5"], ["--new-gate", "0.98"], ["--gate", "0.9999999"],
])  # fmt: skip
def test_a_new_gate_inside_the_gate_is_refused_in_one_line_that_names_both(arguments):
    for refuse in (read_options, lambda given: read(["--log", "arena:0", *given])):
        with pytest.raises(UsageError, match=r"--new-gate 0\.\d+: must not be less than --gate 0\.\d+") as fault:
            refuse(arguments)
        assert "\n" not in str(fault.value)


def test_so_it_is_in_a_config_file(tmp_path):
    config = tmp_path / "run.toml"
    config.write_text("gate = 0.999\nnew_gate = 0.5\n")
    with pytest.raises(UsageError, match=r"--new-gate 0\.5: must not be less than --gate 0\.999"):
        read_options(["--config", str(config)])
    assert read_options(["--config", str(config), "--gate", "0.5"]).setup.gate == 0.5


@pytest.mark.parametrize(("setup", "words"), [
    ("gate = 0.999\nnew_gate = 0.5", "new_gate = 0.5: must not be less than gate = 0.999"),
    ("gate = 5", "gate = 5: a probability between 0 and 1"), ('lag = "none"', "lag = none: a number is needed"),
    ("maintain = 1", "maintain = 1: true or false is needed"), ("forget_after = -1", "a positive number is needed"),
])  # fmt: skip
def test_so_it_is_in_the_setup_of_a_scenario_as_every_other_fault(tmp_path, setup, words):
    path = tmp_path / "small.toml"
    path.write_text(f'about = "x"\n[world]\nkind = "arena"\nframes = 40\n[estimators]\nekf = {{}}\n[setup]\n{setup}\n')
    with pytest.raises(UsageError, match=r"small\.toml: \[setup\] ") as fault:
        load_scenario(str(path))
    assert words in str(fault.value)


def said(text: str) -> None:
    """Nobody listens."""


@pytest.mark.parametrize(("name", "labels", "expected"), [
    ("arena:0:frames=5", True, "known"), ("arena:0:frames=5", False, "jcbb-hindsight"),
    ("floorplan:0:frames=5", False, "scan"),
])  # fmt: skip
def test_the_default_association_follows_what_the_log_has(tmp_path, name, labels, expected):
    log = open_log(name)
    if not labels:
        log = replace(log, label=None, truth=replace(log.truth, landmark_of=None))
    write_folder(log, tmp_path / "log")
    plan = make_plan(read_options(["--log", str(tmp_path / "log")], "run"), said)
    assert {work.association for work in plan.experiments[0].work} == {expected}


@pytest.fixture
def walls(tmp_path):
    log = line_log(0, seconds=10.0)
    write_folder(replace(log, truth=replace(log.truth, landmark_of=None)), tmp_path / "walls")
    return ["--log", str(tmp_path / "walls"), "--estimator", "ekf"]


def test_walls_are_not_paired_in_hindsight(walls):
    with pytest.raises(UsageError, match="walls can be paired by jcbb"):
        make_plan(read_options([*walls, "--association", "jcbb-hindsight"], "run"), said)


@pytest.mark.parametrize(("errors", "refused"), [("curvature,bearing", True), ("range", True), ("scale", False)])
def test_errors_of_the_sensor_are_not_calibrated_by_walls(walls, errors, refused):
    options = read_options([*walls, "--calibrate", errors], "run")
    if not refused:
        assert make_plan(options, said).experiments
        return
    with pytest.raises(UsageError, match="--calibrate: log 'walls' has walls"):
        make_plan(options, said)
