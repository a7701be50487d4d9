"""`--lab` states what is run on what, and `step` and `play` take its settings and decide as it did."""

import json
import re
from dataclasses import replace

import pytest

from data.errors import UsageError
from data.formats.open_log import write_folder
from data.logs import Reading, open_log
from eval import play
from eval.compare import compare
from eval.plan.experiments import make_plan
from eval.plan.flags.options import read_options
from eval.plan.provenance import command_of, provenance
from eval.referee.score import Trial, confusion_of
from tests.builders.unpacked import unpacked
from tests.eval.player.test_document import chunk_of
from wings.labs.plan import METHODS, corridor_names, lab_experiments, settings_by_log, switched_on
from wings.labs.stepping import command as step

FOUR = [(False, True), (True, True), (False, False), (True, False)]


def said(*arguments: str):
    heard: list[str] = []
    options = read_options(list(arguments))
    asked = options.selection
    return lab_experiments(asked.lab, asked.estimator, options.setup, Reading(), heard.append), heard


@pytest.mark.parametrize(("lab", "names"), [
    ("corridor:3", ["corridor:3", "corridor:3:people", "corridor:3:no-odometry", "corridor:3:people+no-odometry"]),
    ("corridor:3+srho=0.05", [
        "corridor:3:srho=0.05", "corridor:3:people+srho=0.05", "corridor:3:no-odometry+srho=0.05",
        "corridor:3:people+no-odometry+srho=0.05",
    ]),
    ("corridor:3:crowd=4+sx-blind=.3+stheta_move=1", [
        "corridor:3:stheta_move=1", "corridor:3:people+crowd=4+stheta_move=1", "corridor:3:no-odometry+sx-blind=.3",
        "corridor:3:people+no-odometry+crowd=4+sx-blind=.3",
    ]),
])  # fmt: skip
def test_a_lab_is_four_logs_with_the_constants_that_have_an_effect(lab, names):
    assert corridor_names(lab) == names
    assert [switched_on(open_log(name)) for name in names] == FOUR


@pytest.mark.parametrize(("lab", "words"), [
    ("corridor:3+people", "people is a condition; the lab has all four"), ("corridor:x", "the seed is a whole number"),
    ("corridor:3+sigma=1", "'sigma=1' is not known"), ("nowhere", "no such folder; a folder, corridor:SEED"),
])  # fmt: skip
def test_what_is_no_lab_is_said_in_a_line(lab, words):
    with pytest.raises(UsageError, match=words):
        said("--lab", lab)


@pytest.mark.parametrize("other", [
    ("--log", "arena:0"), ("--scenario", "arena"), ("--task", "slam"), ("--association", "nn"), ("--data", "."),
    ("--full",), ("--twins", "3"),
])  # fmt: skip
def test_a_lab_states_logs_tasks_and_methods_itself(other):
    with pytest.raises(UsageError, match=f"{other[0]} and --lab exclude each other: a lab states what is run"):
        read_options(["--lab", "corridor:0", *other])


def test_every_method_is_run_in_every_condition_without_maintenance_and_with_it():
    experiments, _ = said("--lab", "corridor:3")
    plain, kept = ([e for e in experiments if (e.variant_of is None) == first] for first in (True, False))
    assert [switched_on(e.log) for e in plain] == [switched_on(e.log) for e in kept] == FOUR
    for e in plain:
        assert {*METHODS, "known"} < {w.association for w in e.work}
        assert not e.setup.maintain
    for e in kept:
        assert {w.association for w in e.work} == set(METHODS)
        assert e.setup.maintain
    with pytest.raises(UsageError, match="answered from ekf, or else isam2"):
        said("--lab", "corridor:3", "--estimator", "batch")


def test_the_lab_has_one_gate_unless_two_are_asked_for():
    assert read_options(["--lab", "corridor:0"]).setup.new_gate == 0.99
    assert read_options(["--lab", "corridor:0", "--gate", "0.95"]).setup.new_gate == 0.95
    two = read_options(["--lab", "corridor:0", "--new-gate", "0.99999"])
    assert two.setup.new_gate == 0.99999
    assert "--new-gate 0.99999" in command_of(two), "it is the default of other runs, and not of this one"
    assert read_options(["--log", "corridor:0"]).setup.new_gate == 0.99999


def test_a_folder_of_recorded_runs_must_hold_every_condition_and_others_are_skipped(tmp_path):
    logs = [replace(open_log(name), name=f"log{k}") for k, name in enumerate(corridor_names("corridor:5+frames=6"))]
    for log in logs[:3]:
        write_folder(log, tmp_path / log.name)
    with pytest.raises(UsageError, match="no log with people and without odometry; the lab needs all four"):
        said("--lab", str(tmp_path))
    write_folder(logs[3], tmp_path / logs[3].name)
    write_folder(replace(logs[0], name="zz"), tmp_path / "zz")
    experiments, heard = said("--lab", str(tmp_path))
    assert [e.log.name for e in experiments if e.variant_of is None] == [log.name for log in logs]
    assert heard == ["skipped zz: log0 has the same condition"]
    with pytest.raises(UsageError, match="one log; the lab's folder holds one for each condition"):
        said("--lab", str(tmp_path / "zz"))


NAME = "corridor:3:people"


@pytest.fixture
def lab(tmp_path, monkeypatch):
    """What a lab leaves in `results/report`, and its wrong pairings by NN."""
    monkeypatch.chdir(tmp_path)
    options, log = read_options(["corridor:3"], "slamref lab", "lab"), open_log(NAME)
    runs = [r for m in ("known", "nn", "jcbb-first") for r in lab_runs(log, m, options.setup)]
    trial = Trial(log, "slam", tuple(runs))
    text = provenance(options, [log], ["slamref", "lab"], lab=settings_by_log(options, [trial]))
    (tmp_path / "results" / "report").mkdir(parents=True)
    (tmp_path / "results" / "report" / "provenance.json").write_text(text)
    return {r.association: confusion_of(r, log, "online") for r in runs}


def lab_runs(log, method, setup):
    return compare(log.inputs(labels=method == "known").without_map(), "slam", ("ekf",), method, setup)


def stepped(capsys, *words: str) -> tuple[str, int]:
    """The first line, and the FP of the whole run."""
    assert step.main([*words, "--run-through"]) == 0
    out = capsys.readouterr().out
    found = re.search(r"^FP +(\d+) ", out, re.MULTILINE)
    assert found is not None
    return out.split("\n")[0], int(found[1])


def test_step_makes_the_decisions_of_the_lab_and_says_whose_settings_it_took(lab, capsys):
    line, fp = stepped(capsys, NAME, "--association", "nn")
    assert line == "settings of the lab in results/report: --task slam --new-gate 0.99"
    assert fp == lab["nn"].fp == 134
    # what is stated wins; then, too, one line says what was taken
    line, fp = stepped(capsys, NAME, "--association", "nn", "--new-gate", "0.99999")
    assert line == "settings of the lab in results/report: --task slam"
    assert fp != lab["nn"].fp


def test_play_shows_the_lab_s_methods_with_its_decisions(lab, capsys, tmp_path):
    assert play.main([NAME, "--out", "page.html"]) == 0
    said = capsys.readouterr().out
    assert "--task slam --estimator ekf --association known,nn,jcbb-first --new-gate 0.99" in said
    page = chunk_of((tmp_path / "page.html").read_text(encoding="utf-8"))
    arrays = unpacked(page)
    shown = {r["association"]: arrays[f"{r['key']}outcome"][:, 0] for r in page["runs"]}
    assert shown.keys() == lab.keys()
    for method, counts in lab.items():
        assert shown[method].tolist() == counts.outcome.tolist()


def test_another_log_or_a_changed_one_takes_nothing_and_a_named_report_must_be_its_lab_s(
    lab, capsys, refused, tmp_path
):
    line, _ = stepped(capsys, "corridor:4:people", "--association", "nn")
    assert line.startswith("corridor:4:people: localization")
    assert "--report results/report: no lab ran on this log there" in refused(
        step.main, ["corridor:4:people", "--report", "results/report", "--run-through"]
    )
    kept = tmp_path / "results" / "report" / "provenance.json"
    changed = json.loads(kept.read_text())
    changed["inputs"][NAME]["sha256"] = "0"
    kept.write_text(json.dumps(changed))
    assert stepped(capsys, NAME, "--association", "nn")[0].startswith(f"{NAME}: localization")
    kept.write_text("no JSON")
    assert stepped(capsys, NAME, "--association", "nn")[0].startswith(f"{NAME}: localization")


def test_run_step_and_play_have_one_default_task_and_say_it(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    line = "corridor:3: localization, because the map is known (--task slam estimates one)"
    said: list[str] = []
    plan = make_plan(read_options(["corridor:3"]), said.append)
    assert [e.task for e in plan.experiments] == ["localization"]
    assert said == [line]
    assert step.main(["corridor:3", "--run-through"]) == 0
    out = capsys.readouterr().out
    assert out.split("\n")[0] == line
    assert "corridor:3: localization, ekf, jcbb" in out
    assert play.main(["corridor:3", "--estimator", "ekf", "--out", "page.html"]) == 0
    assert capsys.readouterr().out.split("\n")[0] == line
    said.clear()
    make_plan(read_options(["corridor:3", "--task", "slam"]), said.append)
    assert said == []
