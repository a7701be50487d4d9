"""The report on a log made from images: statistics counted on paper, pictures on the plan, and contact sheets."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from data.truth_windows import scored
from eval.plan.flags.table import Output
from eval.referee.score import Trial
from eval.report.page.blocks import Formula, Picture, Table
from eval.report.page.files import drop_blank_columns
from eval.report.words import say
from tests.eval.handmade import circle_log, run_with_error
from tests.wings.camera.report.handmade import CORNERS, GREY, SQUARE, evidence
from wings.camera import report as visual
from wings.camera.detector import YELLOW
from wings.camera.report import contact_sheet, detection_table, plan_figure, statistics_of, tiles_of, visual_sections


def test_statistics_of_hand_made_detections_are_those_counted_on_paper():
    first, second, third = statistics_of(evidence()).to_dict("records")
    counts = ["detections", "frames in view", "of these found", "wrong"]
    assert [[row[c] for c in counts] for row in (first, second, third)] == [[4, 4, 2, 1], [2, 4, 1, 1], [0, 0, 0, 0]]
    assert (first["recall [%]"], first["inliers, median"], first["not found: no depth"]) == (50.0, 45.5, 1)
    # four corners off by 0.3 sqrt 2 and four by 0.5
    assert first["corner error, median [px]"] == pytest.approx(0.5 * (0.3 * np.sqrt(2.0) + 0.5))
    assert second["corner error, median [px]"] == 0.0
    assert (third["recall [%]"], third["corner error, median [px]"]) == (None, None)


def test_without_truth_the_table_says_nothing_about_misses_and_errors():
    table = drop_blank_columns(detection_table(statistics_of(evidence(truth=False))))
    assert list(table.columns) == ["picture", "detections", "inliers, median", "not found: no depth"]
    assert table["detections"].tolist() == [4, 2], "not of a picture that was never found"


def test_the_table_counts_reasons_in_columns_the_most_frequent_first():
    refused = ({"no depth": 1}, {"too few inliers": 4, "no depth": 1}, {"not seen": 9})
    made = evidence()
    table = detection_table(statistics_of(replace(made, found=replace(made.found, refused=refused))))
    assert list(table.columns)[-2:] == ["not found: too few inliers", "not found: no depth"]
    assert table.iloc[:, -2:].to_numpy().tolist() == [[0, 1], [4, 1]]
    assert table["recall [%]"].tolist() == [50.0, 25.0]
    assert table["not judged"].tolist() == [1, 0]


def test_tiles_hold_the_frame_in_rgb_with_outlines_of_what_was_found_and_what_was_missed():
    (image, lines), third = tiles_of(evidence())
    assert lines == ["frame 2, 1.0 s"]
    assert image[0, 0].tolist() == [200, 20, 30]
    scale = image.shape[1] / GREY.shape[1]
    u, v = ((SQUARE[0] + 0.5) * scale).round().astype(int)
    assert np.abs(image[v - 3 : v + 4, u - 3 : u + 4].astype(int) - YELLOW).sum(-1).min() < 60
    assert third[1][1:] == ["in view, not found: 0, 1"]


# section
def trials(**what) -> list[Trial]:
    log = scored(replace(circle_log(known_map=True, name="visual:1"), evidence=evidence(**what)))
    localized = (
        run_with_error(
            np.full(3, 0.3), estimator="dead-reckoning", association="none", task="localization", mapped=False
        ),
        run_with_error(np.full(3, 0.05), task="localization", mapped=False),
        run_with_error(np.full(3, 0.01), estimator="batch", task="localization", phases=("final",), mapped=False),
    )
    return [Trial(log, "localization", localized), Trial(log, "slam", (run_with_error(np.full(3, 0.05)),))]


@pytest.mark.slow
def test_the_section_of_a_log_is_written_once_with_a_plan_for_each_task(tmp_path):
    made = visual_sections(tmp_path, Output(), [*trials(), Trial(circle_log(), "slam", ())])
    assert [s.heading for s in made] == ["Pictures as landmarks: visual:1"]
    blocks = made[0].blocks
    assert [b for b in blocks if isinstance(b, Formula)] == [m.formula for m in visual.MODELS]
    assert [b.stem for b in blocks if isinstance(b, Picture)] == [
        "visual_1-localization-plan", "visual_1-slam-plan", "visual_1-detections",
    ]  # fmt: skip
    assert [b.stem for b in blocks if isinstance(b, Table)] == ["visual_1-detections"]
    assert (tmp_path / "tables" / "visual_1-models.tex").read_text() == say("models/all", models=visual.MODELS) + "\n"
    text = " ".join(b for b in blocks if isinstance(b, str))
    assert "Of 8 pictures in view 3 were found (37.5 %). Wrong: 2." in text
    assert "0.700 px" in text
    assert "0.00400 z²" in text
    assert "φ = 90.0°" not in text  # the numbers are the log's sensor's, not the setup's


def test_formulas_are_shown_also_without_plots(tmp_path):
    made = visual_sections(tmp_path, Output(no_plots=True, formats=("csv",)), trials(truth=False))
    assert sum(isinstance(b, Formula) for b in made[0].blocks) == 3
    assert not (tmp_path / "figures").exists()
    assert [p.name for p in (tmp_path / "tables").iterdir()] == ["visual_1-detections.csv"]
    assert not any(isinstance(b, Picture) for b in made[0].blocks)


def test_the_plan_shows_each_picture_on_its_wall_with_its_number_behind_it():
    log = circle_log(known_map=True)
    fig = plan_figure(log, [run_with_error(np.zeros(3), task="localization", mapped=False)], CORNERS)
    fig.draw_without_rendering()
    ax = fig.axes[0]
    walls = [line.get_xydata() for line in ax.lines if line.get_linewidth() > 3]
    assert np.array(walls) == pytest.approx(CORNERS[:, :2])
    numbers = {t.get_text(): t for t in ax.texts}
    assert sorted(numbers) == ["0", "1", "2"]
    for i, middle in enumerate(CORNERS[:, :2].mean(axis=1)):
        box = numbers[str(i)].get_window_extent()
        at = ax.transData.inverted().transform(0.5 * (box.min + box.max))
        assert np.linalg.norm(at) > np.linalg.norm(middle) + 0.1  # all hang facing the middle of the room
        assert np.linalg.norm(at - middle) < 0.6
    assert not any(line.get_marker() == "+" for line in ax.lines)
    assert "pictures (number behind)" in [t.get_text() for t in fig.legends[0].get_texts()]
    assert ax.get_aspect() == 1.0


def test_a_sheet_shows_each_frame_with_its_lines():
    fig = contact_sheet([(GREY, ["frame 7", "in view: 4"]), (GREY, ["frame 8"])], "Sheet")
    FigureCanvasAgg(fig).draw()
    assert [ax.images[0].get_array().shape for ax in fig.axes] == [GREY.shape, GREY.shape]
    assert [t.get_text() for ax in fig.axes for t in ax.texts] == ["frame 7\nin view: 4", "frame 8"]
