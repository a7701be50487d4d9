"""Tables: rounding, blanks, and the same cells in CSV, Markdown and LaTeX, whatever text they hold."""

from __future__ import annotations

import html
import io
import re

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from markdown_it import MarkdownIt

from eval.figures.figure_style import tex_escape
from eval.referee.result_files import CONSISTENCY, DECISION_COUNTS, METRICS
from eval.report import comparison
from eval.report.page.files import write_table
from eval.report.page.tables import column_text, drop_blank_columns, markdown

FRAME = pd.DataFrame(
    {
        "estimator": ["ekf_slam", "batch | final", "gnc"],
        "position RMSE [m]": [0.09912, 0.0862, None],
        "inside 3σ [%]": [98.913, 100.0, np.nan],
        "accepted": [812, 840, None],
    },
    dtype=object,
)


def cells_of(table: str) -> list[list[str]]:
    """Head and body of a Markdown table, as a reader's browser would show them."""
    page = MarkdownIt("commonmark").enable("table").render(table)
    rows = re.findall(r"<tr>(.*?)</tr>", page, re.S)
    return [[html.unescape(c) for c in re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row, re.S)] for row in rows]


@pytest.mark.parametrize(
    ("column", "expected"),
    [
        ([0.09912, 0.0862, 0.1041], ["0.0991", "0.0862", "0.1041"]),
        ([51.61, 3.0, 2.912], ["51.61", "3.00", "2.91"]),
        ([812, None, 3], ["812", "", "3"]),
        ([812.0, float("nan")], ["812", ""]),
        ([-0.5, 0.25], ["−0.500", "0.250"]),
        ([0.0, 0.0312], ["0", "0.0312"]),
        ([2e13, 3.1], ["2.00e+13", "3.10"]),
        ([123456.7, 23456.0], ["123457", "23456"]),
        ([True, False, None], ["yes", "no", ""]),
        ([None, None], ["", ""]),
        (["ok", None], ["ok", ""]),
        ([float("inf"), 1.5], ["", "1.50"]),
    ],
)
def test_a_column_is_rounded_as_a_whole_and_unknown_is_blank(column, expected):
    assert column_text(column) == expected


def test_no_row_loses_digits_to_one_that_is_far_worse():
    frame = pd.DataFrame({"RMSE": [0.0082612, 0.022711, 31.3249, 2.1e9, 3e-11]}, dtype=object)
    assert [row[0] for row in cells_of(markdown(frame))[1:]] == ["0.00826", "0.0227", "31.3", "2.10e+09", "0"]


def test_markdown_shows_the_rounded_cells_with_numbers_to_the_right():
    text = markdown(FRAME)
    assert cells_of(text) == [
        ["estimator", "position RMSE [m]", "inside 3σ [%]", "accepted"],
        ["ekf_slam", "0.0991", "98.9", "812"],
        ["batch | final", "0.0862", "100", "840"],
        ["gnc", "", "", ""],
    ]
    assert text.splitlines()[1] == "| --- | ---: | ---: | ---: |"


@given(st.text(st.characters(blacklist_categories=("Cc", "Cs", "Zl", "Zp", "Zs"), max_codepoint=0x2FFF), min_size=1))
def test_markdown_shows_any_text_as_it_is(text):
    assert cells_of(markdown(pd.DataFrame({"a": [f"x{text}x"], "b": [1]})))[1] == [f"x{text}x", "1"]


def test_underscores_that_would_mean_emphasis_are_shown():
    assert cells_of(markdown(pd.DataFrame({"_a_": ["__init__ _b_c_"]}))) == [["_a_"], ["__init__ _b_c_"]]


def without_escapes(tex: str) -> str:
    return re.sub(r"\\[\\&%$#_{}]", "", tex)


@given(st.text(st.characters(blacklist_categories=("Cc", "Cs"), max_codepoint=0x24F)))
def test_latex_leaves_no_special_character_of_a_text_active(text):
    plain = without_escapes(tex_escape(text))
    assert plain.count("{") == plain.count("}")
    assert plain.count("$") % 2 == 0
    assert not re.search(r"[&%#~^<>|_]", re.sub(r"\$[^$]*\$", "", plain.replace("~", "", text.count("\u00a0"))))
    commands = set(re.findall(r"\\(.[a-z]*)", plain))
    assert commands <= {"textbackslash", "textasciitilde", "textasciicircum", "dots", "circ", "times", "pm", "mu"}


def test_csv_keeps_every_digit_and_blanks(tmp_path):
    frame = pd.DataFrame({"name": ["a", "b"], "x [m]": [0.1 + 0.2, None], "n": [3, None]}, dtype=object)
    write_table(frame, tmp_path, "t", "caption", formats=("csv",))
    text = (tmp_path / "t.csv").read_text(encoding="utf-8")
    assert text == "name,x [m],n\na,0.30000000000000004,3\nb,,\n"
    assert pd.read_csv(io.StringIO(text))["x [m]"][0] == 0.1 + 0.2


def test_tables_are_written_in_the_formats_asked_for_and_the_same_bytes_twice(tmp_path):
    first = write_table(FRAME, tmp_path / "a", "t", "caption")
    second = write_table(FRAME, tmp_path / "b", "t", "caption")
    assert [p.name for p in first] == ["t.csv", "t.md", "t.tex"]
    assert [p.read_bytes() for p in first] == [p.read_bytes() for p in second]
    assert not any(b"\r" in p.read_bytes() for p in first)
    assert (tmp_path / "a" / "notes.tex").read_bytes() == (tmp_path / "b" / "notes.tex").read_bytes()
    assert [p.name for p in write_table(FRAME, tmp_path / "c", "t", "caption", formats=("md",))] == ["t.md"]
    with pytest.raises(ValueError, match="table format 'xlsx'; known: csv, md, tex"):
        write_table(FRAME, tmp_path / "d", "t", "caption", formats=("xlsx",))


def test_only_columns_without_anything_are_dropped():
    frame = pd.DataFrame({"a": [None, 1.0], "b": [np.nan, None], "c": ["", None], "d": [0, None]}, dtype=object)
    assert list(drop_blank_columns(frame).columns) == ["a", "d"]


def metrics_rows(**changes) -> pd.DataFrame:
    row = {
        "log": "arena", "task": "slam", "estimator": "ekf", "association": "known", "phase": "online", "status": "ok",
        "accepted": 812, "rejected": 28, "rmse_position_m": 0.1, "nis": 1.9, "nis_lower": 0.9712, "nis_upper": 1.0331,
        "inside_3sigma": 0.9889,
    } | changes  # fmt: skip
    return METRICS.table([row])


def test_comparison_has_human_heads_bounds_and_percent_and_no_blank_columns():
    table = comparison.comparison_table(metrics_rows())
    assert table.to_dict("records") == [
        {
            "estimator": "ekf", "association": "known", "phase": "online", "position RMSE [m]": 0.1,
            "NIS per dof (expected 1)": 1.9, "95 % bounds of NIS": "0.971–1.033",
            "inside 3σ (expected 98.9) [%]": pytest.approx(98.89), "accepted": 812, "rejected": 28,
        }
    ]  # fmt: skip


def test_comparison_of_several_logs_names_the_log():
    both = pd.concat([metrics_rows(), metrics_rows(log="victoria-park")])
    assert list(comparison.comparison_table(both).columns[:2]) == ["log", "estimator"]


def test_a_failed_run_keeps_its_row_and_its_blanks():
    row = {"rmse_position_m": None, "nis": None, "nis_lower": None, "nis_upper": None, "inside_3sigma": None}
    both = pd.concat([metrics_rows(), metrics_rows(estimator="batch", status="diverged", **row)])
    table = comparison.comparison_table(both)
    assert table["status"].tolist() == ["ok", "diverged"]
    assert cells_of(markdown(table))[2][4:8] == ["", "", "", ""]


def test_association_table_shows_the_final_phase_only_where_something_was_revised():
    row = {
        "log": "a",
        "task": "slam",
        "estimator": "ekf",
        "association": "jcbb",
        "tp": 5,
        "precision": 0.5,
        "recall": 1.0,
    }
    rows = [
        {**row, "phase": "online"}, {**row, "phase": "final"},
        {**row, "estimator": "isam2", "phase": "online"}, {**row, "estimator": "isam2", "phase": "final", "tp": 6},
    ]  # fmt: skip
    table = comparison.association_table(DECISION_COUNTS.table(rows))
    assert table[["estimator", "phase", "TP"]].to_numpy().tolist() == [
        ["ekf", "online", 5], ["isam2", "online", 5], ["isam2", "final", 6],
    ]  # fmt: skip
    assert table["precision [%]"].tolist() == [50.0, 50.0, 50.0]


def test_estimators_with_the_same_outcomes_share_a_row_and_nothing_is_said_twice():
    row = {"log": "a", "task": "slam", "tp": 5, "deferred": 0, "precision": 1.0, "recall": 1.0}
    runs = [("ekf", "known", 5), ("batch", "known", 5), ("ekf", "jcbb", 5), ("isam2", "jcbb", 4)]
    rows = [
        row | {"estimator": e, "association": a, "phase": p, "tp": n} for e, a, n in runs for p in ("online", "final")
    ]
    table = comparison.association_table(DECISION_COUNTS.table(rows))
    assert list(table.columns) == ["association", "estimator", "TP", "precision [%]", "recall [%]"]
    assert table[["association", "estimator", "TP"]].to_numpy().tolist() == [
        ["known", "ekf, batch", 5], ["jcbb", "ekf", 5], ["jcbb", "isam2", 4],
    ]  # fmt: skip
    deferred = DECISION_COUNTS.table([r | {"deferred": 1} for r in rows])
    assert "deferred (FN)" in comparison.association_table(deferred)


def test_logs_and_associations_are_not_mixed_though_their_outcomes_are_equal():
    rows = [
        {"log": g, "task": "slam", "estimator": e, "association": a, "phase": "online", "tp": 5}
        for g in "ab" for e in ("ekf", "batch") for a in ("known", "nn")
    ]  # fmt: skip
    table = comparison.association_table(DECISION_COUNTS.table(rows))
    assert table[["log", "association", "estimator"]].to_numpy().tolist() == [
        [g, a, "ekf, batch"] for g in "ab" for a in ("known", "nn")
    ]  # fmt: skip


@pytest.mark.parametrize(("weighted", "shown"), [(0.101, False), (0.12, True), (None, True)])
def test_a_time_weighted_error_is_shown_where_it_is_another(weighted, shown):
    both = pd.concat([metrics_rows(rmse_time_m=0.1), metrics_rows(rmse_time_m=weighted)])
    assert ("time-weighted RMSE [m]" in comparison.comparison_table(both)) is shown


def test_consistency_table_has_interval_verdict_and_power():
    row = {
        "scenario": "arena", "estimator": "ekf", "quantity": "pose", "dof": 3, "runs": 50, "mean": 3.05, "lower": 2.93,
        "upper": 3.17, "verdict": "consistent", "power": 0.993, "phase": "online",
    }  # fmt: skip
    table = comparison.consistency_table(CONSISTENCY.table([row]))
    assert table["95 % interval of the mean"].tolist() == ["2.93–3.17"]
    assert table["power against 0.8 P [%]"].tolist() == [pytest.approx(99.3)]
    assert "scenario" not in table
