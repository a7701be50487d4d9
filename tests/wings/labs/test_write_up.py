"""The text to go on from: a page for each answer and each log, with the figures and tables that were written."""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from eval.referee.score import Trial, score
from eval.report.page.blocks import Folded, Formula, Picture, Section, Table
from eval.report.page.files import add_note
from tests.eval.handmade import circle_log, run_with_error
from wings.labs.write_up import log_page, tex, write_up

SIDE = np.array([0.0, 1.0, 0.0])
RUNS = (
    run_with_error(0.01 * SIDE, estimator="dead-reckoning", mapped=False), run_with_error(0.5 * SIDE),
    run_with_error(0.2 * SIDE, association="nn"), run_with_error(0.1 * SIDE, estimator="batch", phases=("final",)),
)  # fmt: skip
TRIAL = Trial(circle_log(name="hall"), "slam", RUNS)


def picture(name, caption):
    return Picture(name, caption, "alt")


def pages(folder, trials=(TRIAL,), answers=(), sections=()):
    write_up(folder, trials, score(list(trials)), answers, sections)
    text = (folder / "write-up.tex").read_text(encoding="utf-8")
    assert text.endswith("\\end{document}\n")
    body = text.split("\\begin{document}\n", 1)[1]
    return re.findall(r"\\begin\{page\}\{(.*?)\}\n(.*?)\\end\{page\}", body, re.DOTALL)


def with_files(folder, *names):
    for name in names:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text("", encoding="utf-8")


@pytest.mark.parametrize(("markdown", "latex"), [
    ("**Two** of `a_b`, 5 %", r"\textbf{Two} of \texttt{a\_b}, 5 \%"),
    ("see [the docs](https://x.y/z) for ω → φ", r"see the docs for $\omega$ $\to$ $\varphi$"),
    ("**not closed", "**not closed"), ("* one\n* two\n", "one\n\ntwo"), ("plain", "plain"),
])  # fmt: skip
def test_code_bold_and_links_are_as_they_are_meant(markdown, latex):
    assert tex(markdown) == latex


def test_a_log_has_a_page_with_its_map_and_error_beside_each_other_and_their_captions(tmp_path):
    with_files(
        tmp_path, "figures/hall-slam-map.png", "figures/hall-slam-error.png", "figures/hall-slam-difference.png",
        "tables/hall-slam-comparison.tex",
    )  # fmt: skip
    shown = Section("Log", (picture("hall-slam-map", "The map."), picture("hall-slam-nees", "The NEES."), "The map."))
    ((title, body),) = pages(tmp_path, sections=[shown])
    assert title == "hall, slam"
    assert re.findall(r"\\beside\{(.*?)\}\{0.4\}\{figures/(.*?)\}", body) == [
        ("0.480", "hall-slam-map"), ("0.480", "hall-slam-error"),
    ]  # fmt: skip
    assert re.findall(r"footnotesize (.*?)\\par", body) == ["The map."]
    assert re.findall(r"\\input\{(.*?)\}", body) == ["tables/hall-slam-comparison.tex"]


def test_one_picture_alone_is_not_wider_than_six_tenths_and_none_leaves_nothing(tmp_path):
    ((_, bare),) = pages(tmp_path)
    assert "beside" not in bare
    assert r"\par" not in bare
    with_files(tmp_path, "figures/hall-slam-difference.png", "tables/hall-slam-association.tex")
    ((_, body),) = pages(tmp_path)
    assert re.findall(r"\\beside\{(.*?)\}\{0.4\}\{figures/(.*?)\}", body) == [("0.600", "hall-slam-difference")]
    assert re.findall(r"\\input\{(.*?)\}", body) == ["tables/hall-slam-association.tex"]


def test_the_nearest_to_the_truth_is_named_in_each_phase_but_never_dead_reckoning(tmp_path):
    page = log_page(tmp_path, TRIAL, score([TRIAL]), ())
    assert (page["frames"], page["observations"]) == (40, 4)
    assert [(b[0], round(b[1], 9), *b[2:]) for b in page["best"]] == [
        ("online", 0.2, "ekf", "nn"), ("final", 0.1, "batch", "known"),
    ]  # fmt: skip
    ((_, body),) = pages(tmp_path)
    assert "Least position RMSE with all data:\n0.1 m (batch, known).\n" in body
    blind = Trial(circle_log(name="hall", truth=False), "slam", RUNS)
    assert log_page(tmp_path, blind, score([blind]), ())["best"] == []


def test_a_log_s_page_tells_of_its_own_task_alone_and_trials_beside_it_have_none(tmp_path):
    known = Trial(circle_log(name="hall", known_map=True), "localization", (replace(RUNS[1], task="localization"),))
    found = dict(pages(tmp_path, [TRIAL, known, replace(TRIAL, log=circle_log(name="other"), variant_of="hall")]))
    assert list(found) == ["hall, slam", "hall, localization"]
    assert "0.5 m (ekf, known)" in found["hall, localization"]
    assert "with all data" not in found["hall, localization"]


def test_answers_come_first_with_every_block_and_notes_last(tmp_path):
    (tmp_path / "tables").mkdir()
    add_note(tmp_path / "tables", "q1", "What q1 means.")
    add_note(tmp_path / "tables", "elsewhere", "What q1 means.")
    add_note(tmp_path / "tables", "trust", "What no page shows.")
    table = Table(pd.DataFrame({"a": [1]}), "caption", stem="q1")
    blocks = (
        "**Yes.**", table, replace(table, stem=""), picture("lab", "Paths, 5 %."), Formula("x = 1", "<math></math>"),
        Folded("more", ("* one\n* two",)),
    )  # fmt: skip
    found = pages(tmp_path, answers=[Section("Question 1: how?", blocks)])
    assert [title for title, _ in found] == ["Question 1: how?", "hall, slam", "What the tables mean"]
    body = found[0][1]
    assert r"\textbf{Yes.}" in body
    assert body.count(r"\input{") == 1
    assert r"\input{tables/q1.tex}" in body
    assert "{figures/lab}\\\\\n{\\footnotesize Paths, 5 \\%.}" in body
    assert "\\[\nx = 1\n\\]" in body
    assert "one\n\ntwo" in body
    # a reference to a table that no page has would be printed as ??
    assert found[2][1].strip() == "{\\footnotesize \\textbf{Table~\\ref{tab:q1}.}\nWhat q1 means.\\par}"
