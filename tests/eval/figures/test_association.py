"""Bars of decisions, and uncertainties: what they show of runs counted by hand, legible and cut nowhere."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from eval.figures.claims import closing_frame, growth_figure
from eval.figures.error import OUTCOME_COLOURS, bars, confusion_figure
from eval.figures.figure_style import PHONE, USUAL, figure_style
from eval.figures.style import settle
from eval.referee.score import Trial
from tests.eval.figures.looks import SEEN_BY, lab, within
from tests.eval.handmade import circle_log, run_with_error
from tests.eval.handmade_lab import DISCARD, FOOLED, NEW, lab_log, lab_run
from tests.quick import slow

LOG = lab_log(people=True)
KEPT = replace(LOG, name=f"{LOG.name}:maintain")
KNOWN, FOOL = lab_run(LOG, "known"), lab_run(LOG, "nn", error=0.3, changes=FOOLED)


def trial(*runs, log=LOG, **more) -> Trial:
    return Trial(log, "slam", runs, **more)


def test_estimators_with_the_same_decisions_share_a_bar_and_revised_ones_have_two():
    jcbb = [lab_run(LOG, "jcbb", estimator=e, changes={2: DISCARD}) for e in ("isam2", "batch")]
    dead = replace(KNOWN, estimator="dead-reckoning", association="none")
    shown = bars(trial(dead, KNOWN, lab_run(LOG, "known", estimator="batch"), lab_run(LOG, "jcbb"), *jcbb))
    assert [b.label for b in shown] == ["known (EKF, batch)", "jcbb (EKF)", "jcbb (iSAM2, batch)"]
    assert [b.counts.fn for b in shown] == [0, 0, 1]
    tidy = lab_run(KEPT, "jcbb", changes={4: NEW, 7: 2}, removed={2: 4})
    shown = bars(trial(KNOWN), [trial(tidy, log=KEPT, variant_of=LOG.name)])
    assert [b.label for b in shown] == [
        "known (EKF)", "jcbb (EKF), maintain, online", "jcbb (EKF), maintain, final",
    ]  # fmt: skip
    assert [b.counts.fp for b in shown] == [0, 1, 0]
    same = lab_run(KEPT, "jcbb", changes={4: NEW}, removed={2: 4})
    assert [b.label for b in bars(trial(same, log=KEPT))] == ["jcbb (EKF)"]
    assert bars(trial(KNOWN, log=replace(LOG, truth=replace(LOG.truth, landmark_of=None)))) == []


def test_every_bar_is_as_long_as_there_are_observations_and_fp_and_fn_stand_in_numbers():
    ax = confusion_figure("decisions", bars(trial(KNOWN, FOOL))).axes[0]
    widths = np.array([[patch.get_width() for patch in container] for container in ax.containers])
    assert widths.sum(axis=0).tolist() == [13.0, 13.0]
    begins = np.array([[patch.get_x() for patch in container] for container in ax.containers])
    assert begins[1:] == pytest.approx(np.cumsum(widths, axis=0)[:-1])
    # by hand: 10 pairings or foundings of points and 3 people left out; NN: see handmade_lab
    assert widths[:, 0].tolist() == [8.0, 5.0, 0.0, 0.0, 0.0]
    assert widths[:, 1].tolist() == [4.0, 3.0, 3.0, 2.0, 1.0]
    assert [t.get_text() for t in ax.texts] == ["FP", "0", "5", "FN", "0", "1"]


@pytest.mark.parametrize("seen", SEEN_BY.values(), ids=SEEN_BY.keys())
def test_outcome_colours_stay_apart_for_colour_blind_readers(seen):
    for a, b in combinations(OUTCOME_COLOURS.values(), 2):
        assert np.linalg.norm(lab(a, seen) - lab(b, seen)) > 20.0, (a, b)


METHODS = ("known", "nn", "ml", "ml-ratio", "singles", "gnn", "jcbb", "jcbb-first")
MANY = [lab_run(LOG, m, estimator=e, changes={i: DISCARD}) for i, m in enumerate(METHODS, 2) for e in ("ekf", "isam2")]
BESIDE = [trial(lab_run(KEPT, "jcbb", changes={4: NEW, 7: 2}, removed={2: 4}), log=KEPT, variant_of=LOG.name)]


@pytest.mark.parametrize("runs", [slow([]), slow([KNOWN]), MANY], ids=["none", "one", "many"])
@pytest.mark.parametrize("kind", ["association", "growth"])
def test_nothing_is_cut_or_covered_by_the_legend(kind, runs):
    shown = trial(*runs)
    fig = {
        "association": lambda: confusion_figure(f"{LOG.name}, slam: decisions", bars(shown, BESIDE)),
        "growth": lambda: growth_figure(LOG, runs[:2]),
    }[kind]()
    fig.draw_without_rendering()
    for ax in fig.axes:
        assert within(ax.get_tightbbox(), fig.bbox)
        for text in (t for t in ax.texts if t.get_text()):
            assert within(text.get_window_extent(), fig.bbox)
            assert not ax.get_window_extent().overlaps(text.get_window_extent())
    for legend in fig.legends:
        box = legend.get_window_extent()
        assert within(box, fig.bbox)
        assert not any(box.overlaps(ax.get_tightbbox()) for ax in fig.axes)


def test_on_a_phone_long_names_leave_room_for_the_bars():
    """Seen: the bars of four estimators with equal decisions had no width, and their names were cut."""
    alike = [lab_run(LOG, "known", estimator=e) for e in ("ekf", "isam2", "batch", "ekf-iterated")]
    with figure_style(replace(USUAL, width=PHONE)):
        fig = confusion_figure("decisions", bars(trial(*alike)))
        settle(fig)
    assert within(fig.axes[0].get_tightbbox(), fig.bbox)
    assert fig.axes[0].get_window_extent().width > 0.3 * fig.bbox.width


def test_a_loop_is_closed_when_a_landmark_is_seen_after_a_good_part_of_the_run():
    log = circle_log()
    run = run_with_error(np.zeros(3))
    assert closing_frame(log, run) is None
    o = log.recorded.observations
    late = replace(log, recorded=replace(log.recorded, observations=replace(o, frame=np.array([0, 1, 14, 30]))))
    assert closing_frame(late, run) == 14  # 13 frames unseen, of 40
    assert closing_frame(late, replace(run, decisions=np.array([NEW, 0, DISCARD, 0]))) == 30
