"""Words on fixes and closures: every statistic of a source, every finding, the lines of the terminal."""

import math
from dataclasses import replace

import pytest

from eval.referee.attribution import NOISE, Finding
from eval.report.diagnosis import Step, Terms, advice, explanations, statistic_words
from eval.report.sources import SourceFacts, main_sources, source_lines
from eval.report.words import say

TERMS = Terms()


@pytest.mark.parametrize(("name", "words", "factor"), [
    ("nis_position:gps", "NIS per degree of freedom of position fixes of gps", 1.0),
    ("largest_closure:loops", "largest NIS of closures of loops", 1.0),
    ("innovation_heading:my_compass_lag1", "innovations of headings of my_compass", 1.0),
    ("residual_closure:loops/theta_spread", "heading of the closures of loops, spread [σ]", 1.0),
    ("slope_position:gps/lever_x", "a source of position fixes of gps ahead of or behind its stated place [m]", 1.0),
    ("slope_heading:compass/theta", "a rotation of headings of compass [°]", 180.0 / math.pi),
    ("slope_closure:loops/scale", "a wrong scale of closures of loops [%]", 100.0),
    ("slope_pose:mocap/latency", "pose fixes of mocap with wrong time stamps [s]", 1.0),
])  # fmt: skip
def test_every_statistic_of_a_source_has_words_and_a_unit(name, words, factor):
    text, of = statistic_words(name, TERMS)
    assert words in text
    assert of == pytest.approx(factor)


@pytest.mark.parametrize(("finding", "words"), [
    (Finding(NOISE, "systematic", "position:gps/x", 0.5, 0.04), "of gps are 0.50 m ± 0.04 m too far in +x"),
    (Finding(NOISE, "systematic", "position:gps/latency", -0.5, 0.04), "are 0.50 s ± 0.04 s newer than stamped"),
    (Finding(NOISE, "sigma", "position:gps", 3.0), "position fixes of gps is stated 3.0 times too small"),
    (Finding(NOISE, "outliers", "closure:loops", 2.0, outliers=2), "2 of the closures of loops are outliers"),
    (Finding(NOISE, "correlation", "position:gps", 0.8), "successive position fixes of gps are correlated (0.80)"),
])  # fmt: skip
def test_every_finding_about_a_source_names_it(finding, words):
    (shown,) = explanations([finding], TERMS)
    text = " ".join(say("diagnosis#finding", f=shown, terms=TERMS).split())
    assert words in text
    todo = advice([finding], labels=True)
    assert Step.SOURCE in todo.steps
    assert Step.FIT not in todo.steps
    assert todo.sources == (finding.name.split(":")[1].split("/")[0],)


GPS = SourceFacts(
    "ekf", "known", "online", "gps", "position", 100, 95, 0.97, 0.81, 1.21, "innovations fit", (95, 5, 0, 0)
)


def test_the_terminal_has_a_line_for_each_source_of_the_filter_that_used_it():
    smoother = replace(GPS, estimator="batch", phase="final", used=100, nis=16.0, low=math.nan, high=math.nan)
    loops = replace(GPS, source="loops", kind="closure", count=4, used=0, nis=math.nan, low=math.nan, outcomes=None)
    found = [smoother, loops, GPS]
    assert main_sources(found) == [GPS, loops]
    assert source_lines(found) == [
        "gps (position): 95 of 100 accepted, NIS 0.970 [0.810, 1.21], 0 wrong decisions (ekf)",
        "loops (closure): 0 of 4 accepted (ekf)",
    ]
    assert GPS.wrong == 0
    assert replace(GPS, outcomes=(90, 3, 2, 5)).wrong == 7
