"""Pictures of the corridor lab and update times: who is drawn how, and what is said of the numbers drawn."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.colors import to_hex

from data.log import Log
from eval.figures.style import colour_of_method
from eval.referee.score import Trial
from eval.replay.settings import Setup
from tests.eval.handmade_lab import FRAMES, NEW, POINTS, lab_log, lab_run
from wings.labs import sections
from wings.labs.sections import TRUE_PATH, Shown, maintenance_figure, people_figure, update_times


def shown(method="jcbb-first", *, people=True, error=0.1, **more) -> Shown:
    log = lab_log(people=people)
    run = lab_run(log, method, error=error, changes={4: NEW} if people else {}, **more)
    return Shown(Trial(log, "slam", (run,)), run)


@pytest.fixture(scope="module")
def people():
    return people_figure([shown("nn", people=False)], [shown("nn", error=0.4)])


@pytest.fixture(scope="module")
def kept():
    return maintenance_figure(shown(), shown(removed={2: 2}))


def by_marker(ax, marker):
    return [line for line in ax.lines if line.get_marker() == marker]


def paths_in(ax):
    return [line for line in ax.lines if line.get_marker() == "None"]


def test_a_map_has_true_points_and_path_faintly_below_and_people_that_are_landmarks_above_all(people):
    ax = people.axes[0]
    (points,), (dots,), (persons,) = (by_marker(ax, m) for m in ("+", ".", "s"))
    truth, believed = paths_in(ax)
    order = [x.get_zorder() for x in (points, truth, believed, dots, persons)]
    assert order == sorted(set(order))
    assert points.get_xydata() == pytest.approx(POINTS.xy)
    assert (len(dots.get_xydata()), len(persons.get_xydata())) == (2, 1)
    assert truth.get_color() == TRUE_PATH
    assert to_hex(believed.get_color()).upper() == to_hex(dots.get_color()).upper() == colour_of_method("nn")


def test_the_scene_is_the_square_around_truth_and_points_with_a_tenth_of_room_at_each_side(people):
    ax = people.axes[0]
    assert ax.get_xlim() == pytest.approx((-0.2, 2.2))  # from the robot at the origin to two points 2 m ahead
    assert ax.get_ylim() == pytest.approx((-0.95, 1.45))
    assert ax.get_aspect() == 1.0


def test_the_error_is_drawn_with_people_and_dashed_without_and_its_largest_is_said(people):
    below = people.axes[1]
    quiet, busy = below.lines
    assert quiet.get_ydata() == pytest.approx([0.0, *[0.1] * 4])
    assert busy.get_ydata() == pytest.approx([0.0, *[0.4] * 4])
    assert quiet.get_linestyle() == "--"
    assert busy.get_linestyle() == "-"
    texts = [t.get_text() for t in below.get_legend().get_texts()]
    assert texts == ["without people: at most 0.100 m", "with people: at most 0.400 m"]
    assert below.get_ylim()[0] == 0.0
    assert people.axes[0].get_title(loc="left").endswith("with people: the map at the end")


def test_removed_landmarks_are_crosses_where_they_had_been_initialized(kept):
    without, with_it = kept.axes[:2]
    assert [len(x.get_xydata()) for x in by_marker(without, "x")] == [0]
    (cross,) = by_marker(with_it, "x")
    # the person is seen at (3, 1) from a robot that believes itself 0.1 m to the left
    assert cross.get_xydata() == pytest.approx(np.array([[3.0, 1.1]]))
    (dots,) = by_marker(with_it, ".")
    assert paths_in(with_it)[1].get_zorder() < cross.get_zorder() < dots.get_zorder()
    assert 3.0 <= cross.get_markersize() <= 5.0
    assert [ax.get_title(loc="left") for ax in kept.axes[:2]] == [
        "JCBB without maintenance: 3 landmarks", "JCBB with maintenance: 2 landmarks",
    ]  # fmt: skip


BLIND = 2
"""A frame in which nothing is seen."""


def log() -> Log:
    full = lab_log()
    seen = full.recorded.observations
    kept = seen.frame != BLIND
    recorded = replace(full.recorded, observations=seen.only(kept))
    return replace(full, recorded=recorded, truth=replace(full.truth, landmark_of=full.truth.landmark_of[kept]))


@pytest.mark.parametrize("association", ["known", "nn"])
def test_every_frame_has_its_times_and_one_without_readings_no_update(association):
    found = update_times(log(), "ekf", association, [Setup(), Setup(maintain=True)], repeats=1)
    assert len(found) == 2
    for each in found:
        assert each.update.shape == each.maintenance.shape == (FRAMES,)
        assert (each.update[np.arange(FRAMES) != BLIND] > 0.0).all()
        assert each.update[BLIND] == 0.0
        assert (each.maintenance > 0.0).all()
        assert max(each.update.max(), each.maintenance.max()) < 10.0


def test_of_each_setup_the_fastest_run_counts_and_setups_take_turns(monkeypatch):
    # by turn and setup: s that pass between two looks at the clock, four of them in a frame, two where nothing is seen
    paces = [3.0, 1.0, 2.0, 5.0]
    each = 4 * (FRAMES - 1) + 2
    stamps = iter(np.cumsum(np.repeat(paces, each)).tolist())
    monkeypatch.setattr(sections, "time", SimpleNamespace(perf_counter=lambda: next(stamps)))
    found = update_times(log(), "ekf", "nn", [Setup(), Setup(maintain=True)], repeats=2)
    for of_setup, pace in zip(found, (2.0, 1.0), strict=True):
        assert of_setup.update.tolist() == [0.0 if k == BLIND else pace for k in range(FRAMES)]
        assert of_setup.maintenance.tolist() == [pace] * FRAMES
    assert next(stamps, None) is None
