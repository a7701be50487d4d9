"""Tables for a paper: as wide as said, by the metrics of the fonts and by pdflatex; names to read; fine print apart."""

import re
from pathlib import Path

import matplotlib
import pandas as pd
import pytest

from data.errors import UsageError
from eval.report.page import files as latex
from eval.report.page.files import WIDTHS, check_columns, sheet, short_caption, text_width, write_table

AFM = Path(matplotlib.get_data_path()) / "fonts" / "afm"
RUNS = [("dead-reckoning", "none", "online"), ("ekf", "jcbb", "online"), ("isam2", "jcbb-hindsight", "online"),
        ("isam2", "jcbb-hindsight", "final"), ("batch-huber", "known", "final")]  # fmt: skip
FRAME = pd.DataFrame(
    [
        {
            "estimator": e, "association": a, "phase": p, "position RMSE [m]": 0.1234 * k,
            "heading RMSE [deg]": 1.5 * k, "largest position error [m]": 0.77, "landmark RMSE [m]": 0.21,
            "RMS from batch [m]": 0.05,
            "pose NEES (expected 3)": 2.9, "NIS per dof (expected 1)": 1.01, "95 % bounds of NIS": "0.952–1.049",
            "lag-1 correlation of innovations ± SE (expected 0)": "0.003 ± 0.022",
            "inside 3σ (expected 98.9) [%]": 99.5, "accepted": 1606, "rejected": 12,
        }
        for k, (e, a, p) in enumerate(RUNS, start=1)
    ]
)  # fmt: skip


def test_numbers_and_names_are_no_wider_than_taken_for():
    """em of each letter from the metric file of Computer Modern that comes with matplotlib; small faces are wider."""
    afm = (AFM / "cmr10.afm").read_text(encoding="latin-1")
    wide = {chr(int(code)): float(w) / 1000.0 for code, w in re.findall(r"^C (\d+) ; WX ([\d.]+)", afm, re.M)}
    for size, face in (("footnotesize", 8.0 * 17 / 16), ("scriptsize", 7.0 * 9 / 8)):
        for word in ("estimator", "iSAM2,", "JCBB", "(online)", "0.952", "1606", "landmarks", "overconfident", "NEES"):
            assert face * sum(wide[c] for c in word) < 1.3 * text_width(word, size)
            assert face * sum(wide[c] for c in word) < text_width(word, size) or word.isupper()


def tabular(tex: str) -> str:
    return re.search(r"\\begin\{tabular\}.*\\end\{tabular\}", tex, re.S)[0]


@pytest.mark.parametrize("width", ["column", "page"])
def test_it_fits_and_says_what_was_left_out(width):
    made = sheet(FRAME, "t", "Errors", width)
    assert made.width <= WIDTHS[width]
    assert "resizebox" not in made.tex
    assert (r"\begin{table*}" in made.tex) == (width == "page")
    heads = tabular(made.tex).split(r"\midrule")[0]
    shown = heads.count("&") + 1
    assert shown + len(made.left_out) == 13  # twelve numbers, and a name for the row
    assert all(word in heads for word in ("RMSE", "NEES", "NIS"))
    rows = [line for line in made.tex.splitlines() if line.endswith(r" \\")]
    assert {re.sub(r"\\&", "", r).count("&") for r in rows} == {shown - 1}


def test_rows_have_names_to_read_and_what_is_the_same_in_all_is_said_once():
    body = tabular(sheet(FRAME, "t", "Errors", "page").tex)
    for name in (
        "dead reckoning &", "EKF, JCBB &", "iSAM2, JCBB, hindsight (online)", "(final)", "batch, Huber, known",
    ):  # fmt: skip
        assert name in body
    assert [latex.log(n) for n in ("victoria-park", "arena:0", "corridor:3:people+range=8", "my_log", "x:y")] == [
        "Victoria Park", "arena 0", "corridor 3 (people, range 8)", "my_log", "x:y",
    ]  # fmt: skip
    made = sheet(FRAME.assign(association="jcbb", log="arena:1"), "t", "Errors", "page")
    assert made.common == ("arena 1", "association JCBB")
    assert r"\caption{Errors (arena 1, association JCBB)}" in made.tex
    assert "JCBB" not in tabular(made.tex)


def test_columns_asked_for_are_kept_in_order_and_unknown_ones_are_an_error():
    made = sheet(FRAME, "t", "Errors", "column", ("nis", "rmse_position_m", "tp"))
    heads = tabular(made.tex).split(r"\midrule")[0]
    assert heads.count("&") == 2
    assert heads.index("NIS") < heads.index("RMSE")
    assert made.left_out == ()
    nothing = sheet(FRAME, "t", "Errors", "column", ("tp", "fp"))
    assert nothing.tex == sheet(FRAME, "t", "Errors", "column").tex  # a table that has none of them is as always
    wanted = ("rmse_position_m", "rmse_heading_deg", "max_position_m", "rmse_landmark_m", "rms_from_batch_m",
              "nees_pose", "nis", "bounds", "innovation_lag1", "accepted")  # fmt: skip
    made = sheet(FRAME, "t", "Errors", "column", wanted)
    assert made.width > WIDTHS["column"]
    assert "IS WIDER THAN 252 pt" in made.tex
    check_columns(("rmse_position_m", "tp", "verdict"))
    with pytest.raises(UsageError, match=r"--columns rmse_positon_m: no column .*; do you mean rmse_position_m"):
        check_columns(("rmse_positon_m",))


def test_captions_are_short_and_tables_with_the_same_fine_print_share_a_note(tmp_path):
    fine = "Errors in the world frame, no alignment."
    assert short_caption("arena_0-slam-comparison", f"arena:0, slam. {fine}") == "Errors and consistency: arena 0, SLAM"
    for log in ("arena:0", "arena:1"):
        stem = f"{log.replace(':', '_')}-slam-comparison"
        write_table(FRAME, tmp_path, stem, f"{log}, slam. {fine}", ("csv", "md", "tex"), "page")
    notes = (tmp_path / "notes.tex").read_text()
    assert notes.count(fine) == 1
    assert r"\textbf{Tables~\ref{tab:arena_0-slam-comparison}, \ref{tab:arena_1-slam-comparison}.}" in notes
    assert "NEES: pose NEES (expected 3)" in notes
    assert fine in (tmp_path / "arena_0-slam-comparison.md").read_text()
