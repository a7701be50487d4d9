"""What the report says and shows of an estimator that is not ours: by what it has, as it is in no list of names."""

from __future__ import annotations

from eval.figures.growth import growing as for_growth
from eval.figures.kinds import for_map, for_panels
from eval.judgement.runs import filters_in, judged_runs, smoothers_in
from eval.referee.result_files import rows_of
from eval.referee.score import Trial, score
from eval.replay.settings import associations
from tests.eval.handmade import circle_log, run_with_error

LOG = circle_log()


def made(*runs):
    return Trial(LOG, "slam", tuple(run_with_error(0.01 * (i + 1), **run) for i, run in enumerate(runs)))


def test_who_has_a_final_row_is_a_smoother_and_who_has_none_a_filter():
    trial = made({"estimator": "mine"}, {"estimator": "theirs", "phases": ("online", "final")}, {"estimator": "ekf"})
    rows = judged_runs(rows_of(score([trial]).metrics))
    assert [n for n in filters_in(rows) if n in ("mine", "theirs", "ekf")] == ["ekf", "mine"]
    assert [n for n in smoothers_in(rows) if n in ("mine", "theirs", "ekf")] == ["theirs"]


def test_who_brought_an_estimator_sees_it_in_the_figures():
    names = ["ekf", "ekf-iterated", "isam2", "batch", "gnc", "mine"]
    trial = made(*({"estimator": n, "association": a} for a in ("known", "nn", "jcbb", "way") for n in names))
    for shown in (for_map(trial), for_panels(trial.runs), for_growth(trial)):
        assert "mine" in {r.estimator for r in shown}
        assert "ekf" in {r.estimator for r in shown}
    assert associations(trial.runs) == ["known", "way", "jcbb", "nn"]
