"""The visual lab's three questions: numbers by hand, and a picture and a table for each that show what they say."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from data.result import Trajectory
from eval.plan.flags.table import Output
from eval.referee.score import Trial
from eval.report.page.blocks import Picture, Table
from tests.eval.handmade import FRAMES, SIGMA, circle_log, run_with_error
from tests.wings.camera.report.handmade import evidence
from wings.labs import visual

RISING = np.outer(np.linspace(0.0, 1.0, FRAMES), [0.6, 0.8, 0.0])
"""From nothing to 1 m off."""


@pytest.fixture
def saved(monkeypatch):
    found = {}
    monkeypatch.setattr(visual, "save_for_page", lambda draw, folder, stem: found.update({stem: draw()}))
    return found


def localized(estimator, error, *, phases=("online",), **other):
    made = run_with_error(error, estimator=estimator, task="localization", phases=phases, mapped=False, **other)
    return replace(made, association="none") if estimator == "dead-reckoning" else made


RUNS = (
    localized("dead-reckoning", RISING),
    localized("ekf", np.array([0.03, 0.04, 0.0])),
    localized("batch", np.array([0.0, 0.01, 0.0]), phases=("final",)),
)


def trial(runs=RUNS, *, truth=True, name="visual:1"):
    return Trial(replace(circle_log(truth=truth, known_map=True, name=name), evidence=evidence()), "localization", runs)


def answers(folder, *given, **options):
    return visual.visual_hand_in(folder, Output(formats=("csv",), quick=True, **options), given or [trial()])


def lines(sections):
    return [s.blocks[0] for s in sections]


def test_each_question_is_answered_in_a_line_with_the_numbers_of_its_runs(tmp_path):
    sections = answers(tmp_path, no_plots=True)
    assert [s.heading.partition(":")[0] for s in sections] == ["Question 1", "Question 2", "Question 3"]
    # a circle of 4 m around in 39 chords, to which the growing error adds nothing but itself
    length = sum(np.linalg.norm(b - a) for a, b in pairwise(RUNS[0].online.pose[:, :2]))
    rising = np.sqrt(np.mean(np.linspace(0.0, 1.0, FRAMES) ** 2))
    first, second, third = (s.facts for s in sections)
    assert first == pytest.approx({"length": length, "off": 1.0, "sigma": SIGMA.max()})
    assert second == {"pictures": 6, "frames": 40, "observations": 4}
    assert {r["estimator"]: r["rmse"] for r in third["runs"]} == pytest.approx(
        {"dead-reckoning": rising, "ekf": 0.05, "batch": 0.01}
    )
    assert lines(sections)[1:] == [
        "**6 pictures were found in 40 frames, four corners each: 4 observations.**",
        f"**The filter's position RMSE is 0.0500 m, from commands alone {rising:.3f} m, smoothed 0.0100 m.**",
    ]


def test_the_table_has_a_row_for_each_phase_with_its_errors_and_its_sigma_at_the_end(tmp_path):
    growing = Trajectory(RUNS[1].online.pose, np.linspace(0.1, 1.0, FRAMES)[:, None, None] * np.eye(3))
    runs = (RUNS[0], replace(RUNS[1], online=growing), RUNS[2])
    table = next(b for b in answers(tmp_path, trial(runs), no_plots=True)[2].blocks if isinstance(b, Table)).frame
    assert table[["estimator", "phase"]].to_numpy().tolist() == [
        ["dead-reckoning", "online"], ["ekf", "online"], ["batch", "final"],
    ]  # fmt: skip
    np.testing.assert_allclose(table["largest error [m]"].astype(float), [1.0, 0.05, 0.01])
    np.testing.assert_allclose(table["RMSE [m]"].astype(float)[1:], [0.05, 0.01])
    np.testing.assert_allclose(table["σ at the end [m]"].astype(float), [0.2, 1.0, 0.2])


def test_the_third_question_says_how_sure_the_filter_is_and_whether_rightly(tmp_path):
    """Sigmas grow linearly to 5 times at the end; the error is 5 cm, in a heading that is right."""
    growing = replace(
        RUNS[1].online, covariance=np.linspace(1.0, 5.0, FRAMES)[:, None, None] ** 2 * RUNS[1].online.covariance
    )
    runs = (RUNS[0], replace(RUNS[1], online=growing), RUNS[2])
    section = answers(tmp_path, trial(runs), no_plots=True)[2]
    c, widest = section.facts["certainty"], 3.0 * SIGMA[:2].max()
    assert (c["last"], c["largest"], c["median"]) == pytest.approx((5.0 * widest, 5.0 * widest, 3.0 * widest))
    assert c["heading"] == pytest.approx(15.0 * np.degrees(SIGMA[2]))
    assert c["inside"] == 1.0
    scale = np.linspace(1.0, 5.0, FRAMES) ** 2
    assert c["nees"] == pytest.approx(np.mean(((0.03 / SIGMA[0]) ** 2 + (0.04 / SIGMA[1]) ** 2) / scale))
    said = section.blocks[1]
    assert f"is {5.0 * widest:.3g}" in said
    assert "inside 3σ in 100 % of the frames (98.9 % expected)" in said
    blind = answers(tmp_path, trial(runs, truth=False), no_plots=True)[2].blocks[1]
    assert "How sure it is" in blind
    assert "NEES" not in blind


def test_without_a_true_path_no_error_is_said(tmp_path):
    sections = answers(tmp_path, trial(truth=False), no_plots=True)
    first, _, third = lines(sections)
    assert "off" not in first
    assert "errors are unknown" in third
    (table,) = (b for b in sections[2].blocks if isinstance(b, Table))
    assert not any("error" in c or "RMSE" in c for c in table.frame)


def test_only_localization_on_a_log_made_from_images_is_handed_in_and_of_several_the_first(tmp_path):
    plain = Trial(circle_log(known_map=True), "localization", RUNS)
    mapping, variants = replace(trial(), task="slam"), replace(trial(), variant_of="visual:1")
    assert answers(tmp_path, plain, mapping, variants, no_plots=True) == []
    sections = answers(
        tmp_path, plain, mapping, variants, trial(name="visual:7"), trial(name="visual:8"), no_plots=True
    )
    text = "".join(b for s in sections for b in s.blocks if isinstance(b, str))
    assert "visual:7" in text
    assert "visual:8" not in text


def test_plots_are_drawn_for_pages_and_images_are_png_alone(saved, tmp_path):
    sections = visual.visual_hand_in(tmp_path, Output(formats=("csv",)), [trial()])
    stems = [b.stem for s in sections for b in s.blocks if isinstance(b, Picture)]
    assert stems == ["lab-motion", "visual_1-detections", "lab-plan", "lab-error"]
    assert sorted(saved) == sorted({*stems} - {"visual_1-detections"})
    assert [f.name for f in (tmp_path / "figures").iterdir()] == ["visual_1-detections.png"]


@pytest.mark.parametrize(
    ("asked", "scale", "drawn"), [("1", 1.0, 1), ("5", 1.0, 5), ("auto", 1.0, 1), ("auto", 1e-2, 50)]
)
def test_the_caption_and_the_legend_of_a_plan_state_one_factor(asked, scale, drawn, saved, tmp_path):
    runs = [replace(r, online=smaller(r.online, scale), final=smaller(r.final, scale)) for r in RUNS]
    sections = visual.visual_hand_in(
        tmp_path, Output(formats=("csv",), quick=True, ellipses=asked), [trial(tuple(runs))]
    )
    (caption,) = (b.caption for b in sections[2].blocks if isinstance(b, Picture) and b.stem == "lab-plan")
    larger = f"drawn {drawn} times larger"
    said = "in their size" if drawn == 1 else larger
    assert caption == f"`visual:1`: 3σ ellipses {said}. World frame, no alignment."
    legend = [t.get_text() for t in saved["lab-plan"].legends[0].get_texts()]
    assert ("3σ ellipses" if drawn == 1 else f"3σ ellipses, {larger}") in legend


def smaller(path, scale):
    """A path whose standard deviations are `scale` times as large."""
    return path and replace(path, covariance=scale**2 * path.covariance)
