"""What is said of a log without ground truth: facts, words, errors with their side and unit, sections, sources."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from data.inputs import Systematic
from data.notice import Code, notice
from data.origin import Origin
from data.result import Systematics, Trajectory
from data.worlds.registry import named_log
from eval.figures.claims import systematic_figure
from eval.judgement.causes import Terms, cause_word, explanations, terms_of
from eval.plan.calibrate import with_systematic
from eval.plan.flags.table import Output
from eval.referee.attribution import ASSOCIATIONS, ESTIMATOR, NOISE, NOTHING, UNTELLABLE, Finding
from eval.referee.effects import effects
from eval.referee.residuals import Used
from eval.referee.score import Trial
from eval.referee.truth_free import Statistic
from eval.replay.run import compare
from eval.report import diagnosis
from eval.report.diagnosis import main_sources, source_lines
from eval.report.page.blocks import Folded, Table
from eval.report.words import distance, plus_minus, say
from eval.studies.diagnosis import Blame, Row, Trust
from eval.studies.twins import Sample
from tests.builders import logs
from tests.eval.handmade import LANDMARKS, circle_log, run_with_error, true_path

MEASURED = {
    ("ekf", "nis"): Statistic(0.91, 1.0),
    ("ekf", "filter_smoother_median"): Statistic(30.3, 1.46),
    ("ekf", "filter_smoother_semidefinite"): Statistic(0.09, 1.0),
    ("ekf", "filter_smoother_largest"): Statistic(108.0, frame=61),
    ("batch", "nis"): Statistic(0.88, 1.0),
    ("batch", "residual_z1_mean"): Statistic(0.04, 0.0),
    ("batch", "residual_z1_spread"): Statistic(0.4),
    ("batch", "slope_odometry_theta_turn"): Statistic(-0.05, 0.0, 0.001),
    ("batch", "slope_z1_range"): Statistic(0.001, 0.0, 0.001),
}
TURN = Finding(NOISE, "systematic", "odometry_theta_turn", -0.05, 0.001, 900.0)


def sample(apart: float = 13.0, shift: float = 0.0, **more) -> Sample:
    """A log's, or a twin's, whose statistics are off by `shift`."""
    measured = {key: m._replace(value=m.value + shift) for key, m in MEASURED.items()}
    return Sample(measured, apart={"ekf": apart}, **more)


def said(*, twins: int = 0, association: str = "known", notices=(), **more) -> Trust:
    """A log beside `twins` twins that are 0.5 m, 0.6 m, ... from their smoother; NEES 2.9 where 3 is expected."""
    drawn = tuple(
        sample(0.5 + 0.1 * i, 0.01 * i, nees={("ekf", "online"): 2.9}, counts={"ekf": (90, 8, 1, 1)})
        for i in range(twins)
    )
    p = 1.0 / (twins + 1) if twins else math.nan
    rows = tuple(Row(e, n, m, m.expected, twins, p, p) for (e, n), m in MEASURED.items())
    return Trust("home", "slam", association, sample(), drawn, rows, notices=tuple(notices), **more)


def blamed(*findings: Finding, cause: str = NOTHING, objected: int = 0, **more) -> Trust:
    """The same beside 20 twins, with what is to blame."""
    made = said(twins=20, **more)
    keys = tuple(MEASURED)[:objected]
    return replace(made, blame=Blame(cause, findings, keys, len(MEASURED), 1 / 21 if objected else 0.6))


POLAR, POINTS = Terms(), Terms(polar=False)


def with_measured(trust, measured):
    return replace(trust, real=replace(trust.real, measured=measured))


@pytest.mark.parametrize(
    ("value", "text"), [(0.0, "0 m"), (0.0042, "4.2 mm"), (0.00999, "10 mm"), (0.01, "0.0100 m"), (13.0, "13.0 m")]
)
def test_a_length_below_a_centimetre_is_said_in_millimetres(value, text):
    assert distance(value) == text


def test_only_what_was_measured_is_a_fact_filters_first():
    apart = {"theirs": 1.0, "isam2": 2.0, "ekf-iterated": 3.0, "ekf": 4.0, "batch": math.nan}
    trust = replace(said(), real=replace(said().real, apart=apart))
    assert [(a["estimator"], a["filters"]) for a in diagnosis.facts_of(trust, POLAR)["apart"]] == [
        ("ekf", True), ("ekf-iterated", True), ("isam2", False), ("theirs", False),
    ]  # fmt: skip

    def apart(trust):
        (a,) = diagnosis.facts_of(trust, POLAR)["apart"]
        return a["rms"], a["twins"], a["beside_twins"]

    trust = said(twins=3)
    assert apart(trust) == (13.0, pytest.approx((0.5, 0.7)), True)
    lost = replace(trust.twins[0], apart={"ekf": math.nan})
    assert apart(replace(trust, twins=(lost, *trust.twins[1:]))) == (13.0, pytest.approx((0.6, 0.7)), True)
    assert apart(replace(trust, twins=(lost,))) == (13.0, (), True)
    assert apart(said()) == (13.0, (), False)


MEDIAN, SHARE = ("ekf", "filter_smoother_median"), ("ekf", "filter_smoother_semidefinite")


@pytest.mark.parametrize(("measured", "median", "semidefinite"), [
    ({}, (), None), ({MEDIAN: Statistic(2, 1.5)}, (2, 1.5), None), ({MEDIAN: Statistic(math.nan, 1.5)}, (), None),
    ({MEDIAN: Statistic(2.0)}, (), None), ({SHARE: Statistic(0.25, 1.0)}, (), 0.25),
    ({SHARE: Statistic(math.nan, 1.0)}, (), None),
])  # fmt: skip
def test_of_the_difference_only_what_is_known_is_a_fact(measured, median, semidefinite):
    (a,) = diagnosis.facts_of(with_measured(said(), measured), POLAR)["apart"]
    assert (a["median"], a["semidefinite"]) == (median, semidefinite)


def slopes(**sizes):
    return with_measured(said(), {("batch", f"slope_{name}"): Statistic(*m) for name, m in sizes.items()})


def test_nees_and_decisions_on_twins_are_means_over_those_that_have_some():
    key, other = ("ekf", "online"), ("batch", "final")
    trust = said(twins=4)
    values = ({key: 2.0, other: math.nan}, {key: 4.0}, {key: math.nan}, {key: 6.0, other: 3.5})
    twins = tuple(replace(t, nees=n) for t, n in zip(trust.twins, values, strict=True))
    assert diagnosis.facts_of(replace(trust, twins=twins), POLAR)["nees"] == ((*key, 4.0), (*other, 3.5))
    for none in (said(), replace(trust, twins=twins[2:3])):
        assert diagnosis.facts_of(none, POLAR)["nees"] == ()
    trust = said(twins=2, association="nn")
    alike, other = (80.0, 10.0, 6.0, 4.0), (60.0, 20.0, 12.0, 8.0)
    counts = ({"ekf": alike, "isam2": alike, "theirs": other, "idle": (0, 0, 0, 0)}, {"ekf": alike, "isam2": alike})
    twins = tuple(replace(t, counts=c) for t, c in zip(trust.twins, counts, strict=True))
    assert diagnosis.facts_of(replace(trust, twins=twins), POLAR)["deciding"] == (
        {"estimators": ("ekf", "isam2"), "wrong": 6.0, "missed": 4.0, "decisions": 100.0, "right": 0.9},
        {"estimators": ("theirs",), "wrong": 12.0, "missed": 8.0, "decisions": 100.0, "right": 0.8},
    )  # fmt: skip
    assert diagnosis.facts_of(replace(trust, association="known"), POLAR)["deciding"] == ()
    assert diagnosis.facts_of(said(association="nn"), POLAR)["deciding"] == ()


SIGMA = Finding(NOISE, "sigma", "z2", 0.2, gain=1000.0)
TAILS = Finding(NOISE, "tails", "readings", 38, gain=50.0)
PAIRINGS = Finding(ASSOCIATIONS, "pairings", "readings", 8, gain=300.0)
LINEAR = Finding(ESTIMATOR, "linearization", "ekf", 1.3, 0.02)


def text_of(trust, *, terms=POLAR) -> str:
    return say("diagnosis#paragraphs", trust=diagnosis.facts_of(trust, terms))


def test_a_violated_assumption_and_a_difference_without_twins_are_told_in_full():
    text = diagnosis.first_words(blamed(SIGMA, TURN, cause=NOISE, objected=5), terms=POLAR)
    assert text == (
        "The violated assumption is **the noise model**: 5 of 9 statistics lie outside the range "
        "of 20 bootstrap replicates (family-wise p 0.048). The filter (ekf) and the smoother are "
        "13.0 m RMS apart (replicates: 0.500 m to 2.40 m). The σ of bearings is "
        "stated 5.0 times too large; odometry turns 5.00 % ± 0.10 % too little."
    )
    text = diagnosis.first_words(replace(said(), indicated=TURN), terms=POLAR)
    assert text.startswith("The filter (ekf) and the smoother are 13.0 m RMS apart; their difference d has a median")
    assert "of 30.3 (expected 1.46), and P_f − P_s is positive semidefinite in 9 % of the frames" in text
    assert "indicate most of all: Odometry turns 5.00 % ± 0.10 % too little. Run" in text
    assert "`--twins`" in text
    assert "anges grow" not in text_of(said())  # one standard error is nothing


def test_each_kind_of_finding_has_its_words():
    white = Finding(ESTIMATOR, "innovations", "ekf", 1.1)
    wrong = Finding(ASSOCIATIONS, "decisions", "ekf", 0.034)
    for f, text in (
        (white, "ekf's NIS is 1.10 times its expected"),
        (wrong, "3.4 % of the decisions of ekf are wrong pairings"),
        (TAILS, "heavy tails"),
        (replace(TAILS, kind="jump", size=1.5, frames=((7, 7),)), "a motion of 1.50 m at frame 7"),
        (replace(TAILS, kind="burst", size=0.6, frames=((7, 9),)), "60 % more way than was driven in frames 7 to 9"),
        (replace(TAILS, kind="change", size=3, frames=((7, 9),)), "3.0 times as noisy in frames 7 to 9"),
        (replace(TAILS, kind="mirrored"), "bearings point to the other side"),
        (replace(TAILS, kind="correlation", size=0.9), "are correlated (0.90)"),
        (replace(TAILS, kind="displaced", name="12", size=0.5), "landmark 12 is 0.500 m off its place"),
        (replace(TAILS, kind="landmark", name="12", size=4), "landmark 12 fits 4.0 times worse"),
        (replace(PAIRINGS, size=1), "observation fits another landmark"),
        (LINEAR, "its covariance is too small"),
        (replace(LINEAR, size=0.5), "its covariance is too large"),
        (replace(TURN, other=("odometry_theta_time",)), "(or a drift of the odometry's heading)"),
    ):
        assert text in say("diagnosis#finding", f=explanations([f], POLAR)[0], terms=POLAR)


@pytest.mark.parametrize(("found", "association", "step"), [
    (TURN, "known", "`tune --fit odometry`"), (SIGMA, "known", "`tune --fit sensor`"), (SIGMA, "nn", "state it so"),
    (PAIRINGS, "known", "`--gate-known 0.9999`"), (PAIRINGS, "nn", "`--association jcbb-hindsight`"),
    (PAIRINGS, "jcbb-hindsight", "`--association known`, with labels"),
    (LINEAR, "known", "`--estimator ekf-iterated`"),
    (replace(LINEAR, name="ekf-iterated"), "known", "distrust covariances"),
])  # fmt: skip
def test_what_to_do_is_nothing_that_runs_already(found, association, step):
    assert say("diagnosis#step", f=found, terms=POLAR, association=association) == step


@pytest.mark.parametrize(("found", "step"), [(TURN, "`run --calibrate`"), (SIGMA, "state it so")])
def test_a_log_without_observations_is_not_sent_to_tune(found, step):
    log = circle_log()
    terms = terms_of(replace(log.recorded, observations=logs.NOTHING))
    assert say("diagnosis#step", f=found, terms=terms, association="known") == step


def test_unexplained_objections_missing_twins_and_failures_are_admitted_without_a_number():
    assert diagnosis.facts_of(blamed(cause=NOISE, objected=2), POLAR)["judged"]["unexplained"]
    assert "No modelled error explains them" in text_of(blamed(cause=NOISE, objected=2))
    none = notice(Code.NO_TWINS, why="no twins of home: it has 3 frames")
    assert text_of(said(notices=[none])).endswith("* No twins of home: it has 3 frames.")
    unknown = {key: m._replace(value=math.nan, se=math.nan) for key, m in said().real.measured.items()}
    trust = said()
    lost = replace(trust, real=replace(trust.real, measured=unknown, apart={"ekf": math.nan}))
    assert diagnosis.first_words(lost, terms=POLAR) == ""
    broken = [replace(f, size=math.nan, error=math.nan) for f in (TURN, SIGMA, TAILS, LINEAR)]
    for t in (
        lost,
        replace(lost, twins=(lost.real,) * 20, blame=replace(blamed(*broken, cause=NOISE).blame, p=math.nan)),
        replace(blamed(TURN, cause=NOISE, objected=2), twins=(lost.real,) * 20),
    ):
        for text in (diagnosis.first_words(t, terms=POLAR), text_of(t, terms=POINTS)):
            assert not re.search(r"\b([Nn]an|NaN|inf|None(?! of))\b", text)
            assert "* \n" not in text


def test_where_batch_failed_no_word_says_that_nothing_was_found():
    assert cause_word(said()) != UNTELLABLE
    assert cause_word(replace(said(), real=replace(said().real, failures={"batch": "singular"}))) == UNTELLABLE


COMMON = (
    *(f"odometry_{name}" for name in ("x_distance", "x_turn", "y_distance", "y_turn", "integration", "latency")),
    *(f"odometry_theta_{name}" for name in ("distance", "turn", "time")),
    *(f"z{i}_{name}" for i in (1, 2) for name in ("constant", "range")),
    *("latency", "latency_growth", "mount_x", "mount_y", "map_scale", "z2_scale"),
    *("odometry_current_x", "odometry_current_y"),
)


def phrase(name, terms, size, error):
    """A systematic error of a size in SI units, in words."""
    unit, factor = terms.unit(name)
    e = Finding(NOISE, "systematic", name, factor * size, factor * error, unit=unit)
    return say("effects#systematic", e=e, terms=terms)


def noise(name, factor, terms=POLAR, **error):
    return say("effects#noise", name=name, factor=factor, terms=terms, **error)


@pytest.mark.parametrize(("name", "size", "error", "text"), [
    ("odometry_theta_turn", -0.0492, 0.0012, "odometry turns 4.92 % ± 0.12 % too little"),
    ("odometry_x_distance", 0.05, 0.004, "odometry states distances 5.0 % ± 0.4 % too long"),
    ("odometry_theta_distance", -0.0018, 4e-5, "odometry curves 0.00180 rad/m ± 0.00004 rad/m to the right"),
    ("odometry_theta_time", 0.001, 2e-4, "the odometry's heading drifts 0.0010 rad/s ± 0.0002 rad/s to the left"),
    ("odometry_y_distance", math.radians(2.0), math.radians(0.3), "odometry points 2.0° ± 0.3° to the left of"),
    ("odometry_y_turn", 0.136, 0.023, "odometry is that of a point 0.14 m ± 0.02 m ahead of the robot's own"),
    ("odometry_x_turn", 0.2, 0.03, "odometry is that of a point 0.20 m ± 0.03 m right of the robot's own"),
    ("z1_constant", 0.12, 0.02, "ranges are 0.12 m ± 0.02 m too long"),
    ("z2_constant", math.radians(-1.0), math.radians(0.2), "bearings are 1.0° ± 0.2° too far right"),
    ("z1_range", 0.03, 0.002, "ranges grow 3.0 % ± 0.2 % too fast"),
    ("latency", 0.3, 0.03, "observations are 0.30 s ± 0.03 s older than stamped"),
    ("latency_growth", -0.003, 3e-4, "the clock of the observations falls 3.0 ms/s ± 0.3 ms/s ahead"),
    ("odometry_latency", -0.3, 0.03, "odometry is 0.30 s ± 0.03 s newer than stamped"),
    ("mount_x", 0.1, 0.02, "the sensor is mounted 0.10 m ± 0.02 m too far ahead"),
    ("mount_y", -0.1, 0.02, "the sensor is mounted 0.10 m ± 0.02 m too far right"),
    ("map_scale", 0.02, 0.002, "the map is 2.0 % ± 0.2 % too large"),
    ("odometry_integration", 1.0, 0.1, "odometry applies 100 % ± 10 % of half of each step's turn too early"),
])  # fmt: skip
def test_a_systematic_error_has_its_side_and_its_unit(name, size, error, text):
    assert phrase(name, POLAR, size, error).startswith(text)


def test_points_noise_and_frames_have_their_own_words():
    assert phrase("z1_constant", POINTS, -0.1, 0.02) == "points are 0.10 m ± 0.02 m too far behind"
    assert phrase("z2_range", POINTS, 0.01, math.nan) == "observations are rotated 0.573° counter-clockwise"
    assert phrase("z1_range", POINTS, -0.1, math.nan) == "observed distances grow 10.0 % too slowly"
    log = circle_log()
    used = Used(np.zeros(4, np.int64), LANDMARKS.xy[:1], np.array([0]))
    assert {e.name for e in effects(log.recorded, true_path(), used)} <= set(COMMON)
    assert terms_of(log.recorded) == POLAR
    assert noise("z1", 0.2186).endswith("4.6 times too large")
    assert noise("z1", 1.34).endswith("1.34 times too small")
    assert noise("z1", 0.5, error=0.01).endswith("stated 2.000 ± 0.040 times too large")
    assert noise("z2", 0.5) == "the σ of bearings is stated 2.0 times too large"
    assert noise("odometry_theta", 2.0, POINTS).startswith("the σ of odometry's heading")
    unstamped = Terms(stamped=False)
    assert phrase("latency", unstamped, 0.7, 0.03).startswith("observations are 0.70 frames ± 0.03 frames older")
    assert "0.020 rad/frame" in phrase("odometry_theta_time", unstamped, 0.02, 0.002)
    log = circle_log()
    assert terms_of(replace(log.recorded, time_is_index=True)) == unstamped


@given(
    st.sampled_from(COMMON), st.builds(Terms), st.floats(-1e6, 1e6).filter(bool), st.floats(0, 1e6) | st.just(math.nan)
)
def test_no_sentence_has_a_number_that_is_none(name, terms, size, error):
    text = phrase(name, terms, size, error)
    assert not re.search(r"\b(nan|inf|None)\b", text, re.IGNORECASE)
    assert "{" not in text


ZERO = np.zeros(3)
LOG = circle_log(truth=False, landmarks=False, name="home")


def smoother(**more):
    made = run_with_error(ZERO, estimator="batch", phases=("final",), **more)
    return replace(made, final=Trajectory(made.final.pose, 0.25 * made.final.covariance))


FILTER = run_with_error(np.array([0.1, 0.0, 0.02]))
TRIAL = Trial(LOG, "slam", (FILTER, smoother()))


def test_what_is_objected_to_stands_first_with_what_twins_show_if_there_are_any():
    frame = diagnosis.trust_frame(blamed(TURN, cause=NOISE, objected=2), terms=POLAR)
    assert len(frame) <= diagnosis.MOST
    assert set(frame["statistic"][:2]) == {"NIS per degree of freedom", "median of dᵀ(P_f − P_s)⁻¹d"}
    first = frame[frame["statistic"].str.startswith("median")].iloc[0]
    assert (first["value"], first["expected"]) == ("30.3", "1.46")
    assert first["twins' median"] == "30.4"  # 30.3, 30.31, ... 30.49
    assert first["twins, 5 to 95 %"] == "30.3 to 30.5"
    assert first["family-wise p"] == "0.048"
    frame = diagnosis.trust_frame(said(), terms=POLAR)
    assert list(frame.columns) == ["estimator", "statistic", "value", "expected"]
    turn = frame[frame["statistic"] == "a wrong scale of the odometry's turns [%]"].iloc[0]
    assert turn["value"] == "−5.00 ± 0.10"
    assert not frame["statistic"].str.contains("ranges \\[%\\]").any()
    for _, name in MEASURED:
        for terms in (POLAR, Terms(polar=False)):
            text, factor = diagnosis.statistic_words(name, terms)
            assert "_s" not in text.replace("P_s", "")
            assert factor > 0.0
    assert diagnosis.statistic_words("own_smoother_rms_x", POLAR)[0] == "RMS of d in x [σ], own final path"
    assert diagnosis.statistic_words("residual_odometry_theta_lag1", POLAR)[0] == (
        "residual of the odometry's heading, correlation at lag 1"
    )


def test_a_section_has_words_and_table(tmp_path):
    trust = blamed(TURN, cause=NOISE, objected=2)
    (section,) = diagnosis.trust_section(tmp_path, Output(), TRIAL, [trust])
    words, table, more = section.blocks
    assert section.heading == "Diagnosis without ground truth: home, slam"
    assert words.startswith("**Cause: the noise model.**")
    assert isinstance(more, Folded)
    assert len(words) < 450
    assert isinstance(table, Table)
    assert (tmp_path / "tables" / "home-slam-trust-known.csv").exists()


def test_a_log_with_truth_is_told_on_the_first_page_only_what_twins_say():
    measured = replace(TRIAL, log=circle_log(name="home"))
    assert diagnosis.first_page_words(measured, [said()]) == ""
    assert "found nothing**: none of 9" in diagnosis.first_page_words(measured, [blamed()])
    assert "`--twins`" in diagnosis.first_page_words(TRIAL, [said()])


@pytest.mark.parametrize(("name", "words", "factor"), [
    ("nis_position:gps", "NIS per degree of freedom of position fixes of gps", 1.0),
    ("largest_closure:loops", "largest NIS of closures of loops", 1.0),
    ("innovation_heading:imu/compass_lag1", "innovations of headings of imu/compass", 1.0),
    ("residual_closure:loops/theta_spread", "heading of the closures of loops, spread [σ]", 1.0),
    ("slope_position:gps/lever_x", "a source of position fixes of gps ahead of or behind its stated place [m]", 1.0),
    ("slope_heading:compass/theta", "a rotation of headings of compass [°]", 180.0 / math.pi),
    ("slope_closure:loops/scale", "a wrong scale of closures of loops [%]", 100.0),
    ("slope_pose:mocap/latency", "pose fixes of mocap with wrong time stamps [s]", 1.0),
])  # fmt: skip
def test_every_statistic_of_a_source_has_words_and_a_unit(name, words, factor):
    text, of = diagnosis.statistic_words(name, POLAR)
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
    (shown,) = explanations([finding], POLAR)
    text = " ".join(say("diagnosis#finding", f=shown, terms=POLAR).split())
    assert words in text
    assert say("diagnosis#step", f=finding, terms=POLAR, association="known") == "correct it"


GPS = {
    "estimator": "ekf", "association": "known", "phase": "online", "source": "gps", "kind": "position", "count": 100,
    "used": 95, "nis_mean": 0.97, "nis_low": 0.81, "nis_high": 1.21, "verdict": "innovations fit",
    "tp": 95, "tn": 5, "fp": 0, "fn": 0,
}  # fmt: skip


def test_the_terminal_has_a_line_for_each_source_of_the_filter_that_used_it():
    blank = dict.fromkeys(("nis_low", "nis_high"))
    smoother = GPS | blank | {"estimator": "batch", "phase": "final", "used": 100, "nis_mean": 16.0}
    loops = GPS | blank | {"source": "loops", "kind": "closure", "count": 4, "used": 0, "nis_mean": None, "fp": None}
    assert main_sources([smoother, loops, GPS]) == [GPS, loops]
    assert source_lines([smoother, loops, GPS | {"fp": 2, "fn": 5}]) == [
        "gps (position): 95 of 100 accepted, NIS 0.970 [0.810, 1.21], 7 wrong decisions (ekf)",
        "loops (closure): 0 of 4 accepted (ekf)",
    ]


ERRORS = Systematic(("scale", "curvature"), np.array([0.1, 0.05]))


def estimate(frames, mean, sigma):
    rise = np.linspace(0.0, 1.0, frames)[:, None]
    start = ERRORS.sigma
    return Systematics(ERRORS.names, rise * np.array(mean), start + rise * (np.array(sigma) - start))


@pytest.fixture(scope="module")
def calibrated_trial():
    log = with_systematic(named_log("arena:1:frames=30+scale=-0.08"), ERRORS, Origin.INFERRED)
    ekf, batch = compare(with_systematic(log, None).inputs(labels=True), "localization", ("ekf", "batch"))
    last = Systematics(ERRORS.names, np.tile([-0.081, 0.002], (30, 1)), np.tile([0.004, 0.049], (30, 1)))
    runs = (replace(ekf, errors_online=estimate(30, [-0.079, 0.001], [0.005, 0.05])), replace(batch, errors_final=last))
    return Trial(log, "localization", runs)


def test_the_table_shows_prior_estimates_truth_and_what_the_log_cannot_tell(calibrated_trial):
    table = diagnosis.errors_table(ERRORS, calibrated_trial.runs, calibrated_trial.log.truth)
    assert table.to_dict("list") == {
        "error": ["scale", "curvature"], "unit": ["", "rad/m"], "known before": ["0 ± 0.10", "0 ± 0.050"],
        "ekf (online)": ["−0.0790 ± 0.0050", "0.001 ± 0.050"], "batch (final)": ["−0.0810 ± 0.0040", "0.002 ± 0.049"],
        "true": ["−0.0800", "0"], "told": ["yes", "the log cannot tell it"],
    }  # fmt: skip


def test_batch_has_the_last_word_and_an_error_is_told_if_a_tenth_of_its_sigma_is_gone(calibrated_trial):
    assert diagnosis.best(calibrated_trial.runs) is calibrated_trial.runs[1].errors_final
    assert diagnosis.best(calibrated_trial.runs[:1]) is calibrated_trial.runs[0].errors_online
    assert diagnosis.best([replace(calibrated_trial.runs[0], errors_online=None)]) is None
    sigma = np.tile([0.091, 0.044], (5, 1))
    assert diagnosis.determined(ERRORS, Systematics(ERRORS.names, 0.0 * sigma, sigma)) == (False, True)


@pytest.mark.parametrize(("value", "sigma", "text"), [
    (-0.1053, 0.0045, "−0.1053 ± 0.0045"), (12.0, 3.4, "12.0 ± 3.4"), (0.5, 0.0, "0.500"), (3.0, 25.0, "3 ± 25"),
])  # fmt: skip
def test_estimates_have_the_decimals_of_their_sigma(value, sigma, text):
    assert plus_minus(value, sigma) == text


def test_facts_say_who_named_these_errors_or_that_no_run_ended(calibrated_trial):
    facts = diagnosis.estimated(calibrated_trial, calibrated_trial.runs)
    told = [facts[of] for of in ("names", "why", "judged", "untold")]
    assert told == [ERRORS.names, "inferred", True, ("curvature",)]
    assert say("systematic", **facts).startswith(
        "* Estimated by filter and smoother jointly with the poses: `scale`, `curvature`. A score test"
    )
    facts = diagnosis.estimated(calibrated_trial, [])
    assert (facts["judged"], facts["untold"]) == (False, ())
    assert "No run reached its end" in say("systematic", **facts)


def test_the_figure_has_a_panel_for_each_error_with_truth_prior_and_estimates(calibrated_trial):
    fig = systematic_figure(calibrated_trial.log, ERRORS, calibrated_trial.runs)
    scale, curvature = (ax for ax in fig.axes if ax.get_visible())
    assert (scale.get_ylabel(), curvature.get_ylabel()) == ("scale", "curvature [rad/m]")
    ends = [line.get_ydata()[-1] for line in scale.lines]
    assert {-0.079, -0.081, -0.08} <= {round(float(y), 3) for y in ends}
    low, high = scale.get_ylim()
    assert low < -0.08 - 0.015 < 0.0 < high
    labels = [t.get_text() for t in fig.legends[0].get_texts()]
    assert labels == ["EKF (online)", "batch (final)", "true error", "known before (±3σ)"]
