"""The net holds: no column of a small run has moved; and it is a net: what moves is told, by run, file and column.

Whether the first screen of a report contradicts the tables beside it: ticks are read from report.md as a person reads
them, and numbers from metrics.csv and association.csv; nothing of the product decides here.
"""

import json
import math
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pandas as pd
import pytest

from tests.net.cases import CASES
from tests.net.digest import compare, digest_of, moved
from tests.net.record import RECORDED, Record, done

VALUES = [0.1 * k - 0.7 + 1e-3 * k * k for k in range(40)]


def cells(values):
    return [repr(v) for v in values]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """`made(name)`: what is kept of a case, and its result folder; each case is run once."""

    @cache
    def make(name):
        folder = tmp_path_factory.mktemp("net")
        return done(name, folder), folder / name

    return make


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[] if case.short else [pytest.mark.slow]) for n, case in CASES.items()]
)
def test_no_column_of_a_run_has_moved_and_no_headline_contradicts_its_numbers(name, made):
    (case, folder), kept = made(name), Record.read(name)
    assert not isinstance(case, str), case
    assert kept is not None, f"{name} is not recorded: python -m tests.net --record --only {name}"
    assert case.record.status == kept.status
    found = list(compare(case.record.files, kept.files, exact=False, close=CASES[name].close))
    assert not found, "\n".join([f"{len(found)} moved", *("  ".join(move) for move in found[:40])])
    if (folder / "report.md").is_file():
        assert not list(contradictions(folder))


def test_changes_of_rounding_rows_blanks_and_words_are_told_apart():
    kept, now = digest_of(cells(VALUES)), digest_of(cells(v * (1 + 3e-11) for v in VALUES))
    assert now.exact != kept.exact
    assert moved(now, kept, exact=False) == ""
    assert moved(now, kept, exact=True) == "other text, the same but for rounding"
    kept = digest_of(cells(VALUES))
    assert moved(digest_of(["", *cells(VALUES[1:])]), kept, exact=False) == "1 blanks were 0"
    assert moved(digest_of(cells(VALUES[1:])), kept, exact=False) == "39 rows were 40"
    assert moved(digest_of(["tp", "fp"]), digest_of(["tp", "tp"]), exact=False) == "other words"
    for column in (cells(VALUES), ["tp", "fn", ""], ["", ""], [], ["0.0"]):
        d = digest_of(column)
        assert moved(type(d).parse(str(d)), d, exact=False) == moved(type(d).parse(str(d)), d, exact=True) == ""
    assert digest_of([]).exact != digest_of([""]).exact
    assert {p.stem for p in RECORDED.glob("*.json")} == set(CASES)


ROW = re.compile(r"^\| \[(?P<log>.+), (?P<task>localization|slam)\]\(.*?\| (?P<mark>[✓▲✗–]) \*\*(?P<word>[^*]+)\*\*")
WORST_NEES = 9.0
WORST_SHARE = 0.05


def marks(report: Path) -> dict[tuple[str, str], tuple[str, str]]:
    found = map(ROW.match, report.read_text("utf-8").splitlines())
    return {(m["log"], m["task"]): (m["mark"], m["word"]) for m in found if m}


def contradictions(folder: Path) -> Iterator[str]:
    seen = marks(folder / "report.md")
    metrics, decisions = (pd.read_csv(folder / name) for name in ("metrics.csv", "association.csv"))
    for log in json.loads((folder / "report.json").read_text("utf-8"))["logs"]:
        mark, word = seen[log["log"], log["task"]]
        compared = [_number_of(metrics, log, side) for side in ("filtered", "smoothed")]
        trusted = {"smoother": compared[1:], "path: smoother": compared[1:], "filter": compared[:1]}.get(word, compared)
        if mark == "✓":
            for row in trusted:
                yield from (f"{log['log']}, {log['task']}: ✓ {word}, but {why}" for why in _against(row, decisions))
        if word in ("smoother", "filter") and all(row is not None for row in compared):
            yield from (f"{log['log']}, {log['task']}: {word}, but {why}" for why in _nearer(*compared, word, log))


def _number_of(metrics: pd.DataFrame, log: dict, side: str) -> dict | None:
    if log["compared"][side] is None:
        return None
    keys = {
        "log": log["log"],
        "task": log["task"],
        **{k: log["compared"][side][k] for k in ("estimator", "association", "phase")},
    }
    rows = metrics
    for column, value in keys.items():
        rows = rows[rows[column].fillna("none") == (value or "none")]
    return rows.iloc[0].to_dict()


def _against(row: dict | None, decisions: pd.DataFrame) -> Iterator[str]:
    if row is None:
        yield "it did not run"
        return
    if row["status"] != "ok":
        yield f"{row['estimator']} is {row['status']}"
    if row["nees_pose"] > WORST_NEES:
        yield f"NEES is {row['nees_pose']:.3g}"
    if math.isnan(row["nees_pose"]) and isinstance(row["lost_why"], str):
        yield f"{row['estimator']} is lost: {row['lost_why']}"
    if math.isnan(row["nees_pose"]) and row["nis"] > row["nis_upper"]:
        yield f"NIS is {row['nis']:.3g}, above its bound of {row['nis_upper']:.3g}"
    own = decisions
    for column in ("log", "task", "estimator", "association", "phase"):
        own = own[own[column] == row[column]]
    for fp, tp in own[["fp", "tp"]].itertuples(index=False):
        if fp > WORST_SHARE * (fp + tp):
            yield f"{fp} of {fp + tp} pairings are wrong"


def _nearer(filtered: dict, smoothed: dict, word: str, log: dict) -> Iterator[str]:
    column = "rmse_aligned_m" if log["task"] == "slam" else "rmse_position_m"
    own, other = (smoothed, filtered) if word == "smoother" else (filtered, smoothed)
    unused = {"stopped", "implausible", "idle", "lost", "astray"}
    usable = not any(
        o["objection"] in unused for side in ("filtered", "smoothed") for o in log["compared"][side]["objections"]
    )
    if usable and own[column] > other[column]:
        yield f"its {column} is {own[column]:.3g} beside {other[column]:.3g}"
