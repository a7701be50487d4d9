"""Every written column is described; tables in Python have types; the page follows the table."""

from __future__ import annotations

import pandas as pd
import pytest

from eval.referee.metrics import Metric
from eval.referee.result_files import OF_LOGS, OF_RUNS, TOP, Column, File, count, measured, text
from eval.report.results_folder import PAGE, page

FILE = File("runs/small.csv", "small", (text("who", "name"), count("n", "how many"), Column("x", "where", "m")))


def test_the_page_is_what_the_table_says():
    assert PAGE.read_text(encoding="utf-8") == page(), "make docs writes it anew"


def test_every_column_says_what_it_holds():
    with pytest.raises(ValueError, match="column 'n'"):
        count("n", " ")
    assert all(c.about for f in (*TOP, *OF_RUNS, *OF_LOGS) for c in f.columns)


@pytest.mark.parametrize("columns", [["who", "n", "x", "more"], ["who", "n"], ["n", "who", "x"]])
def test_a_column_too_many_too_few_or_in_another_place_is_not_written(columns, tmp_path):
    with pytest.raises(AssertionError, match="has the columns who, n, x, not"):
        FILE.write(pd.DataFrame(columns=columns), tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_rows_become_typed_columns_and_unknown_is_blank_in_the_file(tmp_path):
    table = FILE.table([{"who": "ekf", "n": 3, "x": 0.1}, {"who": None, "n": None, "x": float("nan")}, {}])
    assert [str(t) for t in table.dtypes] == ["str", "Int64", "float64"]
    assert table["n"].isna().tolist() == [False, True, True]
    FILE.write(table, tmp_path)
    assert (tmp_path / "small.csv").read_text() == "who,n,x\nekf,3,0.1\n,,\n,,\n"
    assert [str(t) for t in FILE.table([]).dtypes] == ["str", "Int64", "float64"]
    with pytest.raises(AssertionError, match=r"small.csv: columns \['m'\]"):
        FILE.table([{"m": 1}])


def test_a_metric_is_described_by_its_own_line():
    assert measured(Metric("rpe_m", "RPE over 1 m", "m")) == Column("rpe_m", "RPE over 1 m", "m")
    assert measured(Metric("n", "things", form="d", about="how many")) == count("n", "how many")
