"""Severity alone says where a notice stands: each code in its places, once, and in no other."""

from __future__ import annotations

import csv
from types import SimpleNamespace

import pytest

from data import words
from data.notice import Code, Severity, notice
from eval.report import steps
from eval.run_all import main

LOG = "arena:0:frames=12"
RUN = {"log": LOG, "task": "slam", "estimator": "ekf", "association": "known", "frame": 3}


class Marks:
    """For each code a macro that says the code alone, whatever its values."""

    def __getattr__(self, name):
        return lambda *_, **__: f"«{name.replace('_', '-')}»"


@pytest.fixture(scope="module")
def places(tmp_path_factory):
    """Texts of a run in which every code is found, by place."""
    out = tmp_path_factory.mktemp("codes") / "report"
    templates, found = words.environment, steps.notices
    marked = SimpleNamespace(get_template=lambda _: SimpleNamespace(module=Marks()))
    with pytest.MonkeyPatch.context() as patch:
        said: list[str] = []
        patch.setattr(words, "environment", lambda package: marked if package == "data" else templates(package))
        every = [notice(code).about(**RUN) for code in Code]
        patch.setattr(steps, "notices", lambda trials, scores, known: found(trials, scores, [*known, *every]))
        patch.setattr("eval.plan.console._print", said.append)
        run = ["--log", LOG, "--task", "slam", "--estimator", "ekf", "--association", "known", "--no-plots"]
        main([*run, "--out", str(out), "--jobs", "1"])
    report = (out / "report.md").read_text(encoding="utf-8")
    with (out / "notices.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    sections = {name: report.partition(f"## {name}\n")[2].partition("\n## ")[0] for name in ("Warnings", "Failures")}
    notes = report.partition("Notes on the log and its runs")[2].partition("</details>")[0]
    return {"terminal": "\n".join(said), **sections, "notes": notes, "notices.csv": rows}


PLACES = {
    Severity.ERROR: {"terminal", "Failures"},
    Severity.WARNING: {"terminal", "Warnings"},
    Severity.INFO: {"notes"},
}


@pytest.mark.parametrize("place", ["terminal", "Warnings", "Failures", "notes"])
def test_each_code_stands_once_where_its_severity_belongs_and_nowhere_else(places, place):
    there = {code: places[place].count(f"«{code}»") for code in Code}
    assert there == {code: int(place in PLACES[code.severity]) for code in Code}


def test_the_table_has_every_code_with_its_severity_errors_first(places):
    rows = places["notices.csv"]
    assert {r["code"]: r["severity"] for r in rows if r["frame"] == "3"} == {c.value: c.severity.value for c in Code}
    order = [Severity(r["severity"]) for r in rows]
    assert order == sorted(order, key=[Severity.ERROR, Severity.WARNING, Severity.INFO].index)
