"""`step` and `play` take a lab's settings for its logs and decide as it did; every command has one default task."""

from __future__ import annotations

import json
import re

import pytest

from data.logs import open_log
from eval import play
from eval.compare import compare
from eval.plan.experiments import make_plan
from eval.plan.flags.options import read_options
from eval.plan.provenance import provenance
from eval.player.pack import unpacked
from eval.referee.score import Trial, confusion_of
from tests.eval.player.test_document import chunk_of
from wings.labs.plan import settings_by_log
from wings.labs.stepping import command as step

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


def test_another_log_or_a_changed_one_takes_nothing_and_a_named_report_must_be_its_lab_s(lab, capsys, tmp_path):
    line, _ = stepped(capsys, "corridor:4:people", "--association", "nn")
    assert line.startswith("corridor:4:people: localization")
    assert step.main(["corridor:4:people", "--report", "results/report", "--run-through"]) == 2
    assert "--report results/report: no lab ran on this log there" in capsys.readouterr().err
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
