"""Words of the first screen from rows made by hand: whom to trust, whose fault, and what of an error is the frame's."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from data.inputs import Observations
from eval.judgement.causes import cause_word
from eval.judgement.judgement import Gauge, Online, Verdict, conclusion
from eval.judgement.runs import Counts, Methods, RunJudgement
from eval.referee.attribution import ASSOCIATIONS, ESTIMATOR, NOISE, NOTHING, UNTELLABLE, Finding
from eval.referee.truth_free import Statistic
from eval.report.overview import associations, claims, drawn, gauge_statement, introduction, trust_mark
from eval.report.page.blocks import Value
from eval.studies.diagnosis import Blame, Trust
from eval.studies.sampled import Sample
from tests.eval.judged import BLIND, LOG, judgement

EKF = {"estimator": "ekf", "association": "known", "phase": "online", "status": "ok", "nis": 1.0, "nis_lower": 0.9,
       "nis_upper": 1.1, "rmse_position_m": 0.404, "rmse_aligned_m": 0.112}  # fmt: skip
BATCH = EKF | {"estimator": "batch", "phase": "final", "rmse_position_m": 0.048, "rmse_aligned_m": 0.044}


def facts(filtered=EKF, smoothed=BATCH, log=LOG, trust=None, newest=None, unused=frozenset(), task="slam"):
    return judgement(filtered, newest, smoothed, log=log, task=task, trust=trust, idle=unused)


@pytest.mark.parametrize(
    ("filtered", "smoothed", "word", "tone"),
    [
        (EKF, BATCH, "smoother", "good"),
        (EKF, BATCH | {"rmse_aligned_m": 0.111}, "either", "good"),
        (EKF | {"rmse_aligned_m": 0.01}, BATCH, "filter", "fair"),
        (EKF, BATCH | {"nees_pose": 9.5}, "path: smoother", "fair"),
        (EKF, BATCH | {"nees_pose": 400.0}, "filter", "fair"),
        (EKF | {"nees_pose": 400.0}, BATCH | {"nees_pose": 400.0}, "neither", "bad"),
        (EKF | {"lost_why": "0 used", "lost_frame": 7, "nees_pose": 1.1}, BATCH, "smoother", "good"),
        (EKF | {"status": "implausible"}, BATCH, "smoother", "fair"),
        (EKF, BATCH | {"status": "diverged"}, "filter", "fair"),
        (EKF | {"lost_why": "0 used", "lost_frame": 7}, BATCH | {"status": "diverged"}, "neither", "bad"),
        (EKF, None, "only ekf", "none"),
        (None, None, "nothing ran", "none"),
    ],
)
def test_the_word_follows_the_errors_and_who_got_to_the_end(filtered, smoothed, word, tone):
    mark = trust_mark(facts(filtered, smoothed))
    assert (mark.word, mark.tone) == (word, tone)


def test_a_violated_assumption_takes_the_tick_and_names_its_size():
    turned = Finding(NOISE, "systematic", "z2_constant", 0.0332, 0.002, gain=100.0)
    found = Trust("home", "slam", "known", Sample({}), (), (), Blame(NOISE, (turned,), (("batch", "s"),), 40, 0.01))
    mark = trust_mark(facts(trust=found))
    assert (mark.word, mark.tone) == ("path: smoother", "fair")
    assert "1.90° ± 0.11° too far to the left" in mark.note
    sound = replace(found, blame=Blame(NOTHING, (), (), 40, 0.4))
    assert trust_mark(facts(trust=sound)).tone == "good"


def test_no_cause_is_named_where_the_solution_itself_is_broken():
    off = Finding(NOISE, "systematic", "z2_constant", 0.0332, 0.002, gain=100.0)
    blame = Blame(UNTELLABLE, (off,), (("batch", "s"),), 40, 0.01)
    found = Trust("blind", "slam", "known", Sample({}), (), (), blame)
    mark = trust_mark(facts(log=BLIND, trust=found))
    assert (mark.word, mark.tone) == ("cannot be told", "bad")
    assert "1.9" not in mark.note


def test_a_log_without_observations_is_dead_reckoning():
    nothing = Observations(np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 2, 2)))
    empty = replace(LOG.recorded, observations=nothing)
    both = frozenset({("ekf", "known"), ("batch", "known")})
    mark = trust_mark(facts(log=replace(LOG, recorded=empty), unused=both))
    assert (mark.word, mark.tone) == ("neither", "bad")
    assert "the log has no observations" in mark.note


def test_an_estimate_that_used_no_reading_is_not_to_be_trusted():
    both = frozenset({("ekf", "known"), ("batch", "known")})
    mark = trust_mark(facts(unused=both))
    assert mark.word == "neither"
    assert "ekf used almost no observation;" in mark.note


@pytest.mark.parametrize(
    ("nis", "word", "tone"),
    [(1.0, "innovations fit", "good"), (1.6, "NIS too large", "bad"), (0.5, "NIS too small", "fair")],
)
def test_what_the_filter_claims_is_a_word_a_colour_and_a_number(nis, word, tone):
    mark = claims(facts(EKF | {"nis": nis}))
    assert mark is not None
    assert (mark.word, mark.tone, mark.note) == (word, tone, f"NIS {nis:.2f}" if nis >= 1 else f"NIS {nis:.3f}")


def trust(cause=None, *findings, measured=None, objected=()):
    blame = None if cause is None else Blame(cause, tuple(findings), tuple(objected), 40, 0.01)
    return Trust("blind", "slam", "known", Sample(measured or {}), (), (), blame)


@pytest.mark.parametrize(
    ("said", "word"),
    [
        (trust(NOTHING), "nothing"),
        (trust(ASSOCIATIONS, Finding(ASSOCIATIONS, "pairings", "readings", 9)), "associations"),
        (trust(ESTIMATOR, Finding(ESTIMATOR, "linearization", "ekf", 1.6)), "estimator"),
        (trust(NOISE, Finding(NOISE, "systematic", "odometry_theta_turn", 0.1)), "odometry"),
        (trust(NOISE, Finding(NOISE, "systematic", "z2_constant", 0.1)), "sensor"),
        (trust(NOISE, Finding(NOISE, "sigma", "odometry_x", 2.0)), "odometry"),
        (trust(NOISE, Finding(NOISE, "tails", "readings", 12)), "sensor"),
        (trust(NOISE, objected=[("batch", "residual_odometry_x_lag1")]), "odometry"),
        (trust(measured={("batch", "slope_z1_constant"): Statistic(0.4, 0.0, 0.01)}), "sensor"),
        (trust(measured={("batch", "slope_z1_constant"): Statistic(0.02, 0.0, 0.01)}), "nothing"),
        (
            trust(
                measured={
                    ("batch", "slope_z1_constant"): Statistic(0.01, 0.0, 0.01),
                    ("batch", "slope_odometry_theta_turn"): Statistic(-0.4, 0.0, 0.01),
                }
            ),
            "odometry",
        ),
        (
            trust(
                measured={
                    ("batch", "slope_z1_constant"): Statistic(0.3, 0.0, 0.01),
                    ("batch", "slope_odometry_theta_turn"): Statistic(0.9, 0.0, 0.1),
                    ("batch", "slope_odometry_x_way"): Statistic(9.0, 0.0, 0.0),
                    ("batch", "residual_odometry_theta_spread"): Statistic(1.8),
                }
            ),
            "sensor",
        ),
        (trust(measured={("batch", "residual_odometry_theta_spread"): Statistic(1.8)}), "odometry"),
        (
            trust(
                measured={
                    ("batch", "residual_odometry_theta_spread"): Statistic(1.8),
                    ("batch", "residual_z1_spread"): Statistic(2.8),
                    ("batch", "residual_z2_spread"): Statistic(math.nan),
                }
            ),
            "sensor",
        ),
    ],
)
def test_the_cause_is_one_word_also_without_twins(said, word):
    assert cause_word(said) == word
    f = facts(EKF | {"rmse_position_m": math.nan}, BATCH | {"rmse_position_m": math.nan}, BLIND, said)
    assert (f.verdict, f.cause.word) == (Verdict.CAUSE, word)
    said = "path: smoother" if word == "nothing" else f"cause: {word}"
    assert trust_mark(f).word == said
    told = "use the smoother" if word == "nothing" else "use the path of the smoother, but do not trust covariances"
    assert introduction([f]).endswith(f"one referee. Without ground truth on blind: {told}.")


@pytest.mark.parametrize(
    ("nis", "tone", "note"),
    [
        (1.0, "good", "no fault found; --twins tests this"),
        (0.81, "fair", "covariances too large (NIS 0.81, 95 % bounds 0.88-1.03); --twins looks for the cause"),
        (1.6, "fair", "covariances too small (NIS 1.6, 95 % bounds 0.88-1.03); --twins looks for the cause"),
    ],
)
def test_a_rejected_nis_is_named_where_nothing_else_was_found(nis, tone, note):
    blank = {"rmse_position_m": None}
    own = {"nis": nis, "nis_lower": 0.88, "nis_upper": 1.03}
    slight = trust(measured={("batch", "slope_z1_constant"): Statistic(0.02, 0.0, 0.01)})
    mark = trust_mark(facts(EKF | blank | own, BATCH | blank, BLIND, slight))
    assert (mark.word, mark.tone, mark.note) == ("path: smoother", tone, note)


def test_the_sentences_say_what_was_compared_and_how_much_better_where_both_got_there():
    bad = facts(EKF | {"status": "implausible"})
    assert introduction([facts()]) == (
        "Filter (ekf) and smoother (batch) on identical inputs from 1 log, scored by one "
        "referee. Offline, use the smoother (the filter's RMSE is 8.42 times as large)."
    )
    found = conclusion([facts(), bad])
    assert (found.logs, found.filters, found.smoothers, found.everywhere) == (1, ("ekf",), ("batch",), True)
    assert (found.filter_fails, found.ratios) == (1, pytest.approx((8.417, 8.417), abs=1e-3))
    assert introduction([facts(), bad]).endswith("8.42 times as large); the filter failed on 1 log.")


def test_rows_of_one_log_are_told_apart_by_their_task():
    closer = facts(EKF | {"rmse_position_m": 0.01}, task="localization")
    found = conclusion([facts(), closer])
    assert (found.smoother, found.filter) == (("home (slam)",), ("home (localization)",))
    said = introduction([facts(), closer])
    assert "Offline, use the smoother on home (slam) (the" in said
    assert said.endswith("the filter is more accurate on home (localization).")


@pytest.mark.parametrize(
    ("rmse", "online", "note"),
    [
        (0.4041, Online.EQUAL, "offline; online, ekf and isam2 are equally accurate"),
        (0.3, Online.OTHER, "online isam2 0.300 m"),
        (0.1, Online.FAR_BETTER, "online, too (isam2 0.100 m)"),
        (None, Online.UNKNOWN, "offline"),
    ],
)
def test_an_online_smoother_tells_later_data_from_the_kind_of_estimator(rmse, online, note):
    f = facts(newest=EKF | {"estimator": "isam2", "rmse_position_m": rmse})
    assert f.compared.online == online
    assert trust_mark(f).note == note


def test_the_error_of_the_frame_is_told_from_that_of_the_path():
    text = gauge_statement(facts())
    assert "`ekf` 0.112 m instead of 0.404 m, `batch` 0.0440 m instead of 0.0480 m" in text
    assert "(ratio 2.55 instead of 8.42)" in text
    assert facts().compared.gauge == Gauge((0.404, 0.048), (0.112, 0.044), mostly=True, ratio_differs=True)
    same = facts(EKF | {"rmse_aligned_m": 0.4})
    assert not same.compared.gauge.mostly
    assert "After alignment, almost the same: `ekf`" in gauge_statement(same)
    assert facts(task="localization").compared.gauge is None


def test_a_small_map_shows_every_path_inside_its_frame_and_is_the_same_each_time():
    way = np.column_stack([np.linspace(0, 5, 400), np.linspace(0, 40, 400)])
    far = np.vstack([way, [[1e7, 1e7]], [[np.nan, np.nan]]])
    svg = drawn([(way, ("#000", 1.0)), (far, ("#111", 1.0))])
    assert svg == drawn([(way, ("#000", 1.0)), (far, ("#111", 1.0))])
    assert svg.count("<polyline") == 2
    first = [tuple(map(float, p.split(","))) for p in svg.split('points="')[1].split('"')[0].split()]
    assert all(0.0 <= x <= 96.0 and 0.0 <= y <= 60.0 for x, y in first)
    # standing, as the path does in the map figure
    assert max(y for _, y in first) - min(y for _, y in first) > 50.0
    assert drawn([(np.full((3, 2), np.nan), ("#000", 1.0))]) == ""


def test_no_association_method_is_called_the_best_where_path_and_decisions_disagree():
    """Seen: the one with the fewest wrong decisions called the best, though its path was the worst."""
    hindsight, first, jcbb = (
        RunJudgement("ekf", name, "online", rmse=rmse, counts=Counts(*counts))
        for name, rmse, counts in (
            ("jcbb-hindsight", 17.1, (205, 125, 200, 71)),
            ("jcbb-first", 9.22, (0, 194, 356, 51)),
            ("jcbb", 9.0, (147, 80, 250, 71)),
        )
    )
    agreed = Methods(hindsight, first, hindsight, usable=True, nearest=None, measured=True, dead_reckoning=20.0)

    def shown(methods):
        return associations(replace(facts(), methods=methods))[0]

    assert shown(agreed) == Value("jcbb-hindsight", "200 FP / 71 FN, 17.1 m (ekf)")
    disputed = replace(agreed, nearest=first)
    both = "200 FP / 71 FN, 17.1 m (ekf); by path jcbb-first 356 FP / 51 FN, 9.22 m (ekf)"
    assert shown(disputed) == Value("by decisions jcbb-hindsight", both)
    assert shown(replace(disputed, usable=False)) == Value("none; by decisions jcbb-hindsight", both)
    assert jcbb.counts.mostly_wrong
    assert not hindsight.counts.mostly_wrong
