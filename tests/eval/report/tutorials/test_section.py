"""The section on the tutorials: its figure has the table's rows, and the originals' numbers where they belong."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from eval.figures.studies import Known, knowledge_figure
from eval.figures.style import style_of
from eval.plan.flags.options import read_options
from eval.plan.tutorials import ABOUT
from eval.referee.score import Trial, score
from eval.report.page.blocks import Picture, Table
from eval.report.tutorials import tutorial_sections, variant_note
from tests.eval.handmade import circle_log, run_with_error


@pytest.fixture
def trials():
    log = circle_log(name="d1r1")
    made = [Trial(log, "slam", (run_with_error(np.array([0.3, 0.0, 0.0])),))]
    for step, association in ((3, "known"), (4, "ml-ratio")):
        source = {**log.source, "original": [14924.0, 0.448]} if step == 3 else log.source
        changed = replace(log, name=f"d1r1:tutorial-step{step}", source=source)
        run = run_with_error(np.array([0.4, 0.3, 0.0]), association=association)
        made.append(Trial(changed, "slam", (run,), "d1r1", ABOUT))
    return made


def test_the_originals_numbers_stand_beside_their_row_alone(trials, tmp_path):
    (section,) = tutorial_sections(tmp_path, read_options(["--quick"]).output, trials, score(trials))
    table, picture = section.blocks
    assert isinstance(table, Table)
    assert isinstance(picture, Picture)
    assert (tmp_path / "figures" / f"{picture.stem}.png").exists()
    row = table.frame.set_index("run")
    assert row.loc["tutorial-step3", "original RMSE [m]"] == 0.448
    assert row.loc["tutorial-step3", "original Σ e² [m²]"] == 14924.0
    assert row["original RMSE [m]"].notna().sum() == 1
    assert row.loc["tutorial-step4", "Σ e² [m²]"] == pytest.approx(40 * 0.25)
    assert "Octave" in table.caption
    metrics = score(trials).metrics
    notes = [variant_note(t, metrics[metrics["log"] == t.log.name]) for t in trials[1:]]
    assert "The original program: 14924 m², position RMSE 0.448 m." in notes[0]
    assert "original program" not in notes[1]


def test_without_plots_there_is_the_table_alone(trials, tmp_path: Path):
    (section,) = tutorial_sections(tmp_path, read_options(["--no-plots"]).output, trials, score(trials))
    assert [type(b) for b in section.blocks] == [Table]


def test_the_figure_shows_errors_originals_and_the_share_of_wrong_decisions():
    rows = [
        Known("tutorial-step1, known", "map and labels", "ekf", True, 0.158, 0.158, None),
        Known("ours: batch (final), known", "map and labels", "batch", False, 0.026, None, None),
        Known("tutorial-step2, ml", "map", "ekf", True, 1.161, 1.161, 0.25),
        Known("ours: ekf (online), nn", "map", "ekf", False, None, None, 0.5),
    ]
    fig = knowledge_figure("d1r1", rows)
    error, wrong = fig.axes
    said = [
        style_of("batch").label,
        style_of("ekf").label,
        "a tutorial's treatment, run here",
        "the tutorial's own program",
    ]
    (legend,) = (x for x in (*fig.legends, error.get_legend(), wrong.get_legend()) if x is not None)
    assert sorted(t.get_text() for t in legend.get_texts()) == sorted(said)
    assert [t.get_text() for t in error.get_yticklabels()] == [r.label for r in rows]
    drawn = sorted(float(line.get_xdata()[0]) for line in error.get_lines())
    assert drawn == [0.026, 0.158, 0.158, 1.161, 1.161]
    assert [bar.get_width() for bar in wrong.patches if bar.get_height() == pytest.approx(0.7)] == [25.0, 50.0]
    assert {t.get_text() for t in error.texts} == {"given: map and labels", "given: map"}
