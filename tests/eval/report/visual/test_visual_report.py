"""The report on a log made from images: formulas that say what the code computes, figures, statistics, section."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import replace
from itertools import combinations

import cv2
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from data import se2
from data.motion import ARC, VelocityModel, VelocityNoise, preintegrate, step
from data.pictures import Detection, Evidence, Found, InView, VisualSetup
from data.sensors import RelativePoint
from ekf import kernels
from eval.page.document import Formula, Picture, Report, Table, write_report
from eval.page.equations import Equation, Matrix, Where, formula_figure, latex
from eval.page.tables import drop_blank_columns
from eval.plan.options import Options
from eval.referee.score import Trial
from eval.report.visual import models
from eval.report.visual.figures import MOST_TILES, OUTLINE, Tile, contact_sheet, plan_figure
from eval.report.visual.sections import PictureStatistics, detection_table, statistics_of, tiles_of, visual_sections
from tests.eval.handmade import FRAMES, circle_log, run_with_error

TOKEN = re.compile(r"(?:\\[a-zA-Z]+|[a-zA-Z]'?)(?:[_^](?:\{\w\}|\w|\\[a-z]+))*|\d+|[-+(){}]|\\,|\s+")


def evaluate(text: str, value: dict[str, float]) -> float:
    """A formula of sums, products, fractions, sines and cosines, with the symbols' values."""
    tokens = TOKEN.findall(text)
    assert "".join(tokens) == text
    tokens = [t for t in tokens if t.strip() and t != r"\,"]

    def take(expected: str | None = None) -> str:
        token = tokens.pop(0)
        assert expected is None or token == expected
        return token

    def total() -> float:
        sign = -1.0 if tokens[0] == "-" else 1.0
        if tokens[0] in "+-":
            take()
        result = sign * product()
        while tokens and tokens[0] in ("+", "-"):
            result += product() if take() == "+" else -product()
        return result

    def product() -> float:
        result = factor()
        while tokens and tokens[0] not in ("+", "-", ")", "}"):
            result *= factor()
        return result

    def enclosed(left: str, right: str) -> float:
        take(left)
        result = total()
        take(right)
        return result

    def factor() -> float:
        if tokens[0] == "(":
            return enclosed("(", ")")
        token = take()
        if token == r"\dfrac":
            above = enclosed("{", "}")
            return above / enclosed("{", "}")
        if token in (r"\sin", r"\cos"):
            return float(getattr(np, token[1:])(factor()))
        if token == r"\Delta":
            return value[r"\Delta " + take()]
        return float(token) if token.isdigit() else value[token]

    result = total()
    assert not tokens
    return result


def array(matrix: Matrix, value: dict[str, float]) -> np.ndarray:
    factor = evaluate(matrix.factor, value) if matrix.factor else 1.0
    return factor * np.array([[evaluate(entry, value) for entry in row] for row in matrix.rows])


def central(f, at: np.ndarray, h: float = 1e-6) -> np.ndarray:
    steps = h * np.eye(len(at))
    return np.stack([(f(at + s) - f(at - s)) / (2 * h) for s in steps], axis=-1)


def test_the_evaluator_of_formulas_knows_arithmetic():
    value = {"a": 2.0, "b'": 3.0, "d_x": 5.0, "x^c_j": 7.0, r"\Delta t": 0.5, r"\theta": np.pi / 6}
    assert evaluate(r"-a (b' - d_x) + \dfrac{x^c_j - 1}{a b'}", value) == pytest.approx(5.0)
    assert evaluate(r"a\,\Delta t \sin\theta + 4 \cos(\theta + \theta)", value) == pytest.approx(2.5)


# motion

MOTIONS = [
    ((1.0, -2.0, 0.4), (0.3, 0.5), 0.25),
    ((0.0, 3.0, np.pi - 0.01), (0.8, 1.5), 0.1),
    ((-4.0, 0.2, -2.9), (-0.5, -0.9), 0.5),
    ((2.0, 2.0, 1.6), (0.4, 1e-3), 0.2),
]


def moved(pose: np.ndarray, control: np.ndarray, dt: float) -> np.ndarray:
    """The code's motion; its heading not wrapped, so that it can be differentiated."""
    mean, G = np.zeros(3), np.zeros((3, 2))
    step(ARC, control[0] * dt, control[1] * dt, mean, G)
    after = se2.compose(pose, mean)
    return np.array([*after[:2], pose[2] + mean[2]])


def motion_values(pose, control, dt) -> dict[str, float]:
    value = {"x": pose[0], "y": pose[1], r"\theta": pose[2], "v": control[0], r"\omega": control[1], r"\Delta t": dt}
    arc = dict(models.ARC_TERMS.terms)
    arc_first = {**dict(models.COMMAND_TERMS.terms[:2]), **arc, **dict(models.COMMAND_TERMS.terms[2:])}
    for symbol, meaning in arc_first.items():
        value[symbol] = evaluate(meaning, value)
    return value


@pytest.mark.parametrize(("pose", "control", "dt"), MOTIONS)
def test_the_typeset_motion_model_and_its_jacobians_are_the_codes(pose, control, dt):
    pose, control = np.array(pose), np.array(control)
    value = motion_values(pose, control, dt)
    assert array(models.NEXT_POSE, value)[:, 0] == pytest.approx(moved(pose, control, dt), abs=1e-12)
    F = central(lambda p: moved(p, control, dt), pose)
    G = central(lambda u: moved(pose, u, dt), control)
    assert array(models.POSE_JACOBIAN, value) == pytest.approx(F, abs=1e-8)
    assert array(models.CONTROL_JACOBIAN, value) == pytest.approx(G, abs=1e-8)


@pytest.mark.parametrize(("pose", "control", "dt"), MOTIONS)
def test_the_filter_propagates_the_covariance_that_the_typeset_jacobians_give(pose, control, dt):
    sigma = (0.01, np.radians(4.0))
    value = motion_values(np.array(pose), control, dt)
    F, G = array(models.POSE_JACOBIAN, value), array(models.CONTROL_JACOBIAN, value)
    Q = array(models.CONTROL_NOISE, {r"\sigma_v^2": sigma[0] ** 2, r"\sigma_\omega^2": sigma[1] ** 2})
    P = np.array([[0.04, 0.01, 0.002], [0.01, 0.09, -0.003], [0.002, -0.003, 0.01]])
    model = VelocityModel(VelocityNoise("velocity", sigma))
    time = np.array([0.0, dt])
    made, _ = preintegrate(model, time, np.full(2, control[0]), np.full(2, control[1]), time)
    mean, covariance = np.array(pose), P.copy()
    kernels.predict(mean, covariance, 3, made.mean[1], made.covariance[1], kernels.NEWEST)
    assert covariance == pytest.approx(F @ P @ F.T + G @ Q @ G.T, abs=1e-12)


# observation

SIGHTS = [
    ((1.0, -2.0, 0.4), (3.0, 1.0), np.pi / 2, (0.0, 0.0)),
    ((0.0, 3.0, np.pi - 1e-9), (-2.0, 2.5), 2.9, (0.1, -0.2)),
    ((-4.0, 0.2, -2.9), (-4.5, 3.0), -0.3, (-0.05, 0.3)),
]


@pytest.mark.parametrize(("pose", "corner", "turn", "shift"), SIGHTS)
def test_the_typeset_observation_model_and_its_jacobians_are_the_codes(pose, corner, turn, shift):
    pose, corner = np.array(pose), np.array(corner)
    sensor = RelativePoint(rotation=turn, translation=shift)
    value = {
        "x": pose[0], "y": pose[1], r"\theta": pose[2], "l_{x}": corner[0], "l_{y}": corner[1], r"\varphi": turn,
        "T_x": shift[0], "T_z": shift[1],
    }  # fmt: skip
    symbol, meaning = models.ANGLE
    value[symbol] = evaluate(meaning, value)
    seen = sensor.predict(pose, corner[None])[0]
    assert array(models.EXPECTED, value)[:, 0] == pytest.approx(seen, abs=1e-12)
    chain = array(models.ROTATION, value) @ se2.rotation(pose[2]).T @ (corner - pose[:2]) + shift
    assert chain == pytest.approx(seen, abs=1e-12)
    value |= {"x^c_j": seen[0], "z^c_j": seen[1]}
    H, L = array(models.OBSERVATION_JACOBIAN, value), array(models.CORNER_JACOBIAN, value)
    assert pytest.approx(central(lambda p: sensor.predict(p, corner[None])[0], pose), abs=1e-8) == H
    assert pytest.approx(central(lambda c: sensor.predict(pose, c[None])[0], corner), abs=1e-8) == L
    Hx, Hl = sensor.jacobians(pose, corner[None])
    assert pytest.approx(Hx[0], abs=1e-12) == H
    assert pytest.approx(Hl[0], abs=1e-12) == L


# typesetting


def test_all_that_is_checked_above_is_what_is_typeset():
    shown = [part for m in models.MODELS for line in m.lines if isinstance(line, Equation) for part in line.right]
    for matrix in (
        models.NEXT_POSE, models.POSE_JACOBIAN, models.CONTROL_JACOBIAN, models.CONTROL_NOISE, models.ROTATION,
        models.EXPECTED, models.OBSERVATION_JACOBIAN, models.CORNER_JACOBIAN,
    ):  # fmt: skip
        assert any(part is matrix for part in shown)
    assert models.COMMAND_TERMS in models.MOTION.lines
    assert models.ARC_TERMS in models.MOTION.lines
    assert " = ".join(models.ANGLE) in latex(models.OBSERVATION.lines)


def test_a_matrix_becomes_a_matrix_aligned_at_the_equals_sign():
    lines = (Equation("A", (Matrix((("1", "x"), ("0", r"\alpha")), "2"),)), Where((("x", "y"),)))
    assert latex(lines) == (
        "\\begin{aligned}\n"
        "A &= 2 \\begin{bmatrix} 1 & x \\\\ 0 & \\alpha \\end{bmatrix} \\\\[1ex]\n"
        "& \\mathrm{where}\\quad x = y\n"
        "\\end{aligned}"
    )


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="no LaTeX on this machine")
def test_the_latex_of_the_models_compiles_and_fits_the_page(tmp_path):
    body = models.models_latex()
    (tmp_path / "m.tex").write_text(
        "\\documentclass{article}\n\\usepackage{amsmath}\n\\begin{document}\n" + body + "\\end{document}\n"
    )
    made = subprocess.run(
        ["pdflatex", "-interaction=nonstopmode", "m.tex"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert made.returncode == 0, made.stdout[-2000:]
    assert "Overfull" not in made.stdout


@pytest.mark.parametrize("model", models.MODELS, ids=lambda m: m.name)
def test_nothing_in_the_picture_of_a_formula_overlaps_or_is_cut(model):
    fig = formula_figure(model.lines)
    fig.set_dpi(400)  # letters are hinted to whole pixels
    fig.draw_without_rendering()
    boxes = [t.get_window_extent() for t in fig.texts] + [a.get_window_extent() for a in fig.artists]
    assert len(fig.texts) > 20
    assert len(fig.artists) == 2 * sum(
        isinstance(p, Matrix) for e in model.lines if isinstance(e, Equation) for p in e.right
    )
    for box in boxes:
        assert box.x0 >= 0
        assert box.y0 >= 0
        assert box.x1 <= fig.bbox.x1
        assert box.y1 <= fig.bbox.y1
    for a, b in combinations(boxes[: len(fig.texts)], 2):
        shared = np.minimum(a.max, b.max) - np.maximum(a.min, b.min)
        assert shared.min() < 0.3 * 400 / 72  # pt


# figures

CORNERS = np.array([
    [[-2.0, 6.0], [-1.0, 6.0], [-1.0, 6.0], [-2.0, 6.0]],
    [[6.0, 1.0], [6.0, 0.0], [6.0, 0.0], [6.0, 1.0]],
    [[1.0, -6.0], [0.0, -6.0], [0.0, -6.0], [1.0, -6.0]],
])  # fmt: skip
SQUARE = np.array([[10.0, 20.0], [40.0, 20.0], [40.0, 50.0], [10.0, 50.0]])
GREY = np.full((90, 120, 3), 90, np.uint8)


def found_at(picture: int, offset: tuple[float, float] = (0.0, 0.0)) -> Detection:
    return Detection(picture, SQUARE + offset, np.zeros((4, 3)), 40)


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
        # all hang facing the middle of the room
        assert np.linalg.norm(at) > np.linalg.norm(middle) + 0.1
        assert np.linalg.norm(at - middle) < 0.6
    assert not any(line.get_marker() == "+" for line in ax.lines)
    labels = [t.get_text() for t in fig.legends[0].get_texts()]
    assert "pictures (number behind)" in labels
    assert ax.get_aspect() == 1.0


def test_a_sheet_outlines_what_was_found_and_numbers_it_at_the_upper_left_corner():
    fig = contact_sheet([Tile("frame 7", GREY, [found_at(3), found_at(5, (50.0, -18.0))], ["in view: 4"])], "Sheet")
    canvas = FigureCanvasAgg(fig)
    canvas.draw()
    ax = fig.axes[0]
    outlines = [line.get_xydata() for line in ax.lines if len(line.get_xydata()) == 5]
    assert np.array(outlines)[:, :4] == pytest.approx(np.array([SQUARE, SQUARE + (50.0, -18.0)]))
    picture = np.asarray(canvas.buffer_rgba())[..., :3].astype(int)
    u, v = ax.transData.transform([25.0, 20.0])
    assert v > ax.transData.transform([25.0, 50.0])[1]  # upright
    spot = picture[round(picture.shape[0] - v) - 2 : round(picture.shape[0] - v) + 3, round(u)]
    wanted = [int(OUTLINE[i : i + 2], 16) for i in (1, 3, 5)]
    assert np.abs(spot - wanted).sum(axis=1).min() < 60
    tags = {t.get_text(): t.get_window_extent() for t in ax.texts}
    assert sorted(tags) == ["3", "5"]
    for number, corner in (("3", SQUARE[0]), ("5", SQUARE[0] + (50.0, -18.0))):
        box, at = tags[number], ax.transData.transform(corner)
        assert np.hypot(*(at - np.clip(at, box.min, box.max))) < 8
        # also where the picture hangs at the image's upper edge
        assert box.y1 <= ax.bbox.y1 + 1


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, MOST_TILES])
def test_a_sheet_of_any_size_keeps_images_and_words_apart_and_on_the_page(count):
    shapes = [(90, 120), (120, 90), (60, 120)]
    tiles = [
        Tile(f"frame {k}", np.zeros((*shapes[k % 3], 3), np.uint8), [], ["refused: " + "too few inliers, " * (k % 4)])
        for k in range(count)
    ]
    fig = contact_sheet(tiles, "A title")
    fig.canvas.draw()
    boxes = [*(ax.get_window_extent() for ax in fig.axes), *(t.get_window_extent() for t in fig.texts)]
    assert len(fig.axes) == count
    for ax, tile in zip(fig.axes, tiles, strict=True):
        assert ax.bbox.width / ax.bbox.height == pytest.approx(tile.rgb.shape[1] / tile.rgb.shape[0], rel=1e-6)
    for box in boxes:
        assert min(box.x0, box.y0) >= -0.5
        assert box.x1 <= fig.bbox.x1 + 0.5
        assert box.y1 <= fig.bbox.y1 + 0.5
    inner = [b.shrunk(0.98, 0.9) for b in boxes]
    assert not any(a.overlaps(b) for a, b in combinations(inner, 2))


@pytest.mark.parametrize("count", [0, MOST_TILES + 1])
def test_a_sheet_of_too_few_or_too_many_frames_is_refused(count):
    with pytest.raises(ValueError, match=f"{count} frames"):
        contact_sheet([Tile("a", GREY, [], [])] * count, "Sheet")


# statistics


def evidence(*, truth: bool = True) -> Evidence:
    """Pictures 0 and 1 in view in frames 0 to 3, side by side; what was found is written out below."""
    places = {0: SQUARE, 1: SQUARE + (60.0, 0.0)}
    rows = [  # frame, claimed picture, where
        (0, 0, places[0] + 0.3), (0, 1, places[1]),
        (1, 0, places[1]),  # lies on the other one
        (2, 0, places[0] + (0.0, 0.5)), (2, 1, places[1] + (0.0, 30.0)),  # off its place, at nothing
        (5, 0, places[0]),  # nothing in view by the truth
    ]  # fmt: skip
    frame, picture = np.array([r[0] for r in rows]), np.array([r[1] for r in rows])
    ok, image = cv2.imencode(".png", np.dstack([GREY[..., 0] * 0 + c for c in (30, 20, 200)]))
    assert ok
    found = Found(
        100.0 + 0.5 * np.arange(FRAMES), np.zeros(FRAMES), np.zeros(FRAMES), frame, picture,
        np.array([40, 60, 50, 41, 62, 90]), np.array([r[2] for r in rows]), np.zeros((len(rows), 4, 3)),
        ({"no depth": 1}, {}, {}), ((2, image.tobytes()), (3, image.tobytes())), focal=500.0,
        pixel_noise=0.7, depth_noise=0.004,
    )  # fmt: skip
    seen = InView(np.repeat(np.arange(4), 2), np.tile([0, 1], 4), np.tile(np.stack([places[0], places[1]]), (4, 1, 1)))
    prior = circle_log().recorded.prior
    return Evidence(VisualSetup(np.pi / 2, (0.0, 0.1), CORNERS, prior), found, seen if truth else None)


def test_statistics_of_hand_made_detections_are_those_counted_on_paper():
    first, second, third = statistics_of(evidence())
    assert (first.detected, first.in_view, first.found_in_view, first.wrong) == (4, 4, 2, 1)
    assert first.recall == 0.5
    assert first.median_inliers == 45.5
    # four corners off by 0.3 sqrt 2 and four by 0.5
    assert first.corner_error == pytest.approx(0.5 * (0.3 * np.sqrt(2.0) + 0.5))
    assert first.refused == {"no depth": 1}
    assert (second.detected, second.in_view, second.found_in_view, second.wrong) == (2, 4, 1, 1)
    assert second.corner_error == 0.0
    assert (third.detected, third.in_view, third.recall, third.corner_error) == (0, 0, None, None)


def test_without_truth_the_table_says_nothing_about_misses_and_errors():
    table = drop_blank_columns(detection_table(statistics_of(evidence(truth=False))))
    assert list(table.columns) == ["picture", "detections", "inliers, median", "not found: no depth"]
    assert table["detections"].tolist() == [4, 2, 0]


def test_the_table_counts_reasons_in_columns_the_most_frequent_first():
    stats = [
        PictureStatistics(0, 9, 10, 9, 40.0, 0.5, 0, {"no depth": 1}),
        PictureStatistics(1, 2, 0, 0, None, None, 1, {"too few inliers": 4, "no depth": 1}),
    ]
    table = detection_table(stats)
    assert list(table.columns)[-2:] == ["not found: too few inliers", "not found: no depth"]
    assert table.iloc[:, -2:].to_numpy().tolist() == [[0, 1], [4, 1]]
    assert table["recall [%]"].tolist() == [90.0, None]
    assert table["not judged"].tolist() == [0, 1]


def test_tiles_hold_the_frame_in_rgb_with_its_detections_and_what_was_missed():
    second, third = tiles_of(evidence())
    assert second.name == "frame 2, 1.0 s"
    assert second.rgb[0, 0].tolist() == [200, 20, 30]
    assert [d.picture for d in second.detections] == [0, 1]
    assert second.notes == []
    assert third.notes == ["in view, not found: 0, 1"]


# section


def trials(**what) -> list[Trial]:
    log = replace(circle_log(known_map=True, name="visual:1"), evidence=evidence(**what))
    localized = (
        run_with_error(
            np.full(3, 0.3), estimator="dead-reckoning", association="none", task="localization", mapped=False
        ),
        run_with_error(np.full(3, 0.05), task="localization", mapped=False),
        run_with_error(np.full(3, 0.01), estimator="batch", task="localization", phases=("final",), mapped=False),
    )
    return [Trial(log, "localization", localized), Trial(log, "slam", (run_with_error(np.full(3, 0.05)),))]


def test_the_section_of_a_log_is_written_once_with_a_plan_for_each_task(tmp_path):
    made = visual_sections(tmp_path, Options(), [*trials(), Trial(circle_log(), "slam", ())])
    assert [s.heading for s in made] == ["Pictures as landmarks: visual:1"]
    blocks = made[0].blocks
    assert [b.stem for b in blocks if isinstance(b, Formula)] == ["visual_1-motion", "visual_1-observation"]
    assert [b.stem for b in blocks if isinstance(b, Picture)] == [
        "visual_1-localization-plan", "visual_1-slam-plan", "visual_1-detections",
    ]  # fmt: skip
    assert [b.stem for b in blocks if isinstance(b, Table)] == ["visual_1-detections"]
    assert (tmp_path / "tables" / "visual_1-models.tex").read_text() == models.models_latex()
    text = " ".join(b for b in blocks if isinstance(b, str))
    assert "Of 8 pictures in view 3 were found (37.5 %). Wrong: 2." in text
    assert "0.700 px" in text
    assert "0.00400 z²" in text
    assert "φ = 90.0°" not in text  # the numbers are the log's sensor's, not the setup's


def test_formulas_are_in_the_html_as_images_that_say_their_latex_and_in_markdown_as_latex(tmp_path):
    made = visual_sections(tmp_path, Options(quick=True), trials())
    write_report(tmp_path, Report("Title", "command", ("First.",), tuple(made)))
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert page.count('<div class="formula"><img ') == 2
    assert "\\begin{bmatrix} 1 &amp; 0 &amp; -d_x \\sin\\theta" in page
    assert not re.search(r"https?://|<script", page)
    text = (tmp_path / "report.md").read_text(encoding="utf-8")
    for model in models.MODELS:
        assert f"```math\n{latex(model.lines)}\n```" in text


def test_formulas_are_shown_also_without_plots(tmp_path):
    made = visual_sections(tmp_path, replace(Options(), no_plots=True, formats=("csv",)), trials(truth=False))
    assert sorted(p.name for p in (tmp_path / "figures").iterdir()) == [
        "visual_1-motion.png",
        "visual_1-observation.png",
    ]
    assert [p.name for p in (tmp_path / "tables").iterdir()] == ["visual_1-detections.csv"]
    assert not any(isinstance(b, Picture) for b in made[0].blocks)


def test_a_log_without_images_has_no_such_section(tmp_path):
    assert visual_sections(tmp_path, Options(), [Trial(circle_log(), "slam", ())]) == []
    assert not any(tmp_path.iterdir())
