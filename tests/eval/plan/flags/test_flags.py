"""One table of flags: whatever changes the numbers is in the command, and reading the command gives the same again."""

from __future__ import annotations

import shlex

import pytest
from hypothesis import given
from hypothesis import strategies as st

from data.errors import UsageError
from eval.plan.flags.options import read_options
from eval.plan.flags.table import Options, parser
from eval.plan.provenance import command_of
from eval.replay.flag import rows
from eval.replay.settings import ASSOCIATIONS, ESTIMATORS, TASKS, Setup

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
    "least_information": GATES,
    **dict.fromkeys(("forget_after", "deactivate_after", "lag", "keyframe_distance"), SPANS),
    **dict.fromkeys(("runs", "seed", "twins"), st.integers(0, 10**9).map(str)),
    "camera_translation": st.sampled_from(("cm", "mm", "m")),
    "camera_reading": st.sampled_from(("to-camera", "to-body")),
    "corner_noise": st.sampled_from(("lab", "depth")),
    "relations": PATHS,
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
    "lag": "1e-07", "keyframe_distance": "0.8", "least_information": "0.2",
    "runs": "0", "seed": "7", "twins": "9", "camera_translation": "m", "camera_reading": "to-body",
    "corner_noise": "depth", "relations": "a b", "exclude_truth": "3:4.5",
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
    """What the command in the report asks for."""
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


def test_a_file_is_spelled_out(tmp_path):
    config = tmp_path / "run.toml"
    config.write_text('log = ["arena:1"]\ngate_smoothers = false\ngate_known = 0.999\n')
    options = read_options(["--config", str(config)])
    config.unlink()
    assert again(options) == options
    assert "--no-gate-smoothers" in command_of(options)


def test_files_take_every_row_of_the_table_and_no_other(tmp_path):
    config = tmp_path / "run.toml"
    config.write_text("gate = 0.5\nconfig = 'x'\n")
    with pytest.raises(UsageError, match="unknown key 'config'"):
        read_options(["--config", str(config)])


def test_every_row_is_explained():
    text = "".join(parser().format_help().split())
    for row in rows(Options).values():
        assert row.help, row.name
        assert "".join(row.help.split()) in text, row.name
    assert rows(Setup).keys() < rows(Options).keys()
