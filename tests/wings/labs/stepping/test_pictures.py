"""Figures and poses of a step show what was decided and computed, in the robot frame, for every kind of sensor."""

import dataclasses

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from association.decide import decide
from association.expectation import Expectation
from data.log import shortened
from data.logs import open_log
from data.pose_measurements import MEASURED, FixKind, expected_fix
from data.result import MapState, PoseEstimate
from data.sensors import RangeBearing, RelativePoint
from data.truth import Truth
from data.worlds.arena import Arena, simulate
from eval.figures.style import drawing
from eval.referee.confusion import OUTCOMES
from eval.replay.run import step_by_step
from eval.replay.settings import Setup
from wings.labs.stepping import pictures
from wings.labs.stepping.command import main
from wings.labs.stepping.problem import Matching, TruthRow
from wings.labs.stepping.text import COMPONENTS, columns_of_run, poses_block, run_text

PLAIN = RelativePoint(max_range=5.0)


def judged(h: int, g: int) -> int:
    return OUTCOMES.index(("tp" if h == g else "fp") if h >= 0 else ("fn" if g >= 0 else "tn"))


def problem(gate: float | None = 0.99, **changed) -> Matching:
    """Landmarks 3, 4, 5 at x = 1, 2, 4; observations beside 3, between 3 and 4 but nearer to 4, and far away."""
    z_hat = np.array([[1.0, 0.0], [2.0, 0.0], [4.0, 0.0]])
    z = np.array([[1.05, 0.0], [1.85, 0.0], [0.0, 3.0]])
    e = Expectation.from_arrays(
        z, z_hat, 0.06 * np.eye(6), np.tile(0.01 * np.eye(2), (3, 1, 1)), number=np.array([3, 4, 5])
    )
    decisions = {name: decide(name, e, gate, gate).decisions for name in ("nn", "singles", "ml", "jcbb")}
    right = np.array([3, 5, -1])
    truth = {name: TruthRow(right, np.array([judged(h, g) for h, g in zip(d, right)])) for name, d in decisions.items()}
    m = Matching("by hand", e, PLAIN, gate, {"truth": right, **decisions}, "jcbb", truth, right)
    return dataclasses.replace(m, **changed)


def painted(paint, *arguments) -> Figure:
    with drawing():
        fig = Figure(layout="none")
        paint(fig, *arguments)
        fig.draw_without_rendering()
    return fig


def written(ax: Axes, colour: str) -> list[str]:
    return [t.get_text() for t in ax.texts if t.get_color() == colour]


def titles(fig: Figure) -> list[str]:
    return [ax.get_title() or ax.get_title(loc="left") for ax in fig.axes]


def test_the_field_of_view_is_what_the_sensor_says_is_in_view():
    assert pictures.field_of_view(RelativePoint()) is None
    sensor = RangeBearing(max_range=5.0, min_angle=-0.5, max_angle=1.0, rotation=0.4, translation=(0.2, 0.1))
    outline = pictures.field_of_view(sensor)
    z = sensor.predict(np.zeros(3), outline)
    assert np.all(sensor.in_view(z[1:-1], margin_range=1e-9, margin_angle=1e-9))
    assert z[1:-1, 0] == pytest.approx(5.0)
    assert (z[1, 1], z[-2, 1]) == pytest.approx((-0.5, 1.0))
    assert z[[0, -1], 0] == pytest.approx(0.0)


def test_matching_shows_all_methods_side_by_side_with_their_counts_and_marks_the_one_that_updates():
    fig = painted(pictures.paint_matching, problem())
    assert titles(fig) == [
        "ground truth: 2 paired, 1 new, 0 discarded", "NN: TP 1  TN 1  FP 1  FN 0", "SINGLES: TP 1  TN 1  FP 1  FN 0",
        "ML: TP 1  TN 1  FP 1  FN 0", "JCBB (updates): TP 1  TN 1  FP 1  FN 0",
    ]  # fmt: skip
    assert [ax.spines["left"].get_linewidth() > 1.5 for ax in fig.axes] == [False] * 4 + [True]
    # landmarks that somebody may be paired with are named; the wrong observation is in every method's panel, all of
    # them in the first
    assert [written(ax, pictures.LANDMARK) for ax in fig.axes] == [["3", "4", "5"]] * 5
    assert [written(ax, "#202020") for ax in fig.axes] == [["0", "1", "2"], *[[]] * 4]
    assert [written(ax, pictures.BAD) for ax in fig.axes] == [[], *[["1"]] * 4]


def test_an_enlarged_frame_shows_a_wrong_observation_its_landmark_and_the_right_one():
    fig = pictures.enlarged_figure(problem(), ["nn"])
    assert np.ptp(fig.axes[0].get_xlim()) == pytest.approx(2.0 * 0.8 * (4.0 - 1.85))


@pytest.mark.slow
def test_another_method_gets_a_panel_of_its_own_one_without_decisions_says_why_and_without_truth_they_are_counted():
    m = problem()
    more = {**m.decisions, "ml": "singular innovation covariance", "gnn": m.decisions["nn"]}
    truth = {**m.truth, "gnn": m.truth["nn"]}
    fig = painted(pictures.paint_matching, dataclasses.replace(m, decisions=more, truth=truth, chosen="gnn"))
    assert len(fig.axes) == 6
    assert titles(fig)[3] == "ML: singular innovation covariance"
    assert titles(fig)[5].startswith("GNN (updates): TP 1")
    decisions = {name: d for name, d in m.decisions.items() if name != "truth"}
    fig = painted(pictures.paint_matching, dataclasses.replace(m, decisions=decisions, truth={}, right=None))
    assert titles(fig)[0] == "NN: 2 paired, 1 new, 0 discarded"
    assert len(fig.axes) == 4


def test_compatibility_tells_of_true_pairs_that_do_not_fit():
    fig = painted(pictures.paint_compatibility, problem())
    assert titles(fig) == ["by hand: compatibility (2 pairs), robot frame"]
    assert "true pair that is not compatible" in [t.get_text() for t in fig.legends[0].get_texts()]


def test_a_landmark_far_away_does_not_make_the_scene_small():
    m = problem()
    z_hat = m.expectation.z_hat.copy()
    z_hat[2] = [400.0, 0.0]
    fig = painted(
        pictures.paint_matching, dataclasses.replace(m, expectation=dataclasses.replace(m.expectation, z_hat=z_hat))
    )
    assert np.ptp(fig.axes[0].get_xlim()) < 20.0


def test_observations_are_numbered_and_none_is_no_mistake():
    e = problem().expectation
    fig = painted(pictures.paint_observations, PLAIN, e.z, e.R, "title")
    assert [t.get_text() for t in fig.axes[0].texts] == ["0", "1", "2"]
    painted(pictures.paint_observations, PLAIN, np.empty((0, 2)), np.empty((0, 2, 2)), "nothing")


def test_ground_truth_marks_what_is_seen_and_who_is_no_landmark():
    log = open_log("corridor:0:people")
    fig = painted(pictures.paint_ground_truth, log, 14, "step 14")
    labels = fig.axes[0].get_legend_handles_labels()[1]
    who = log.truth.landmark_of[slice(*log.recorded.start[14:16].tolist())]
    assert f"{len(set(who[who >= 0].tolist()))} observed" in labels
    assert f"{(who == -1).sum()} of no landmark" in labels
    (robot,) = [line for line in fig.axes[0].lines if line.get_label() == "true pose"]
    assert np.allclose(robot.get_xydata()[0], log.truth.pose[14, :2])
    dark = dataclasses.replace(log, truth=Truth(landmarks=log.truth.landmarks))
    assert "no true pose here" in titles(painted(pictures.paint_ground_truth, dark, 14, "step 14"))[0]


def test_the_map_shows_landmarks_robot_and_path_of_the_estimate():
    log = simulate(Arena(frames=6), 0)
    now = PoseEstimate(np.array([1.0, 2.0, 0.5]), np.diag([0.01, 0.04, 0.001]))
    landmarks = MapState(np.array([0, 4]), np.array([[3.0, 3.0], [5.0, 1.0]]), np.tile(0.09 * np.eye(2), (2, 1, 1)))
    fig = painted(pictures.paint_map, log, 3, "ekf", np.array([[0.0, 0.0], [1.0, 2.0]]), now, landmarks, "here")
    assert "2 landmarks, numbered" in fig.axes[0].get_legend_handles_labels()[1]
    assert [t.get_text() for t in fig.axes[0].texts] == ["0", "4"]
    ellipses = [p.get_extents() for c in fig.axes[0].collections for p in c.get_paths()]
    assert any(box.width == pytest.approx(2 * 3 * 0.1, rel=0.01) for box in ellipses)  # the robot's, 3 sigma
    assert any(box.width == pytest.approx(2 * 3 * 0.3, rel=0.01) for box in ellipses)
    empty = MapState(np.empty(0, int), np.empty((0, 2)), np.empty((0, 2, 2)))
    painted(pictures.paint_map, log, 0, "isam2", np.zeros((1, 2)), now, empty, "nothing yet")


WORLD = "mixed:7:jumps=true+closure_gap=2+closure_period=1"


def run_of(estimator="ekf", frames=40, gate=0.99, **changes):
    log = shortened(open_log(WORLD), frames)
    inputs = log.inputs(labels=True)
    return log, step_by_step(estimator, inputs, "localization", setup=Setup(gate_poses=gate), **changes)


@pytest.mark.parametrize("estimator", ["ekf", "ekf-iterated", "isam2", "fixed-lag"])
def test_the_first_fixes_innovation_and_sigmas_are_those_of_the_prior(estimator):
    log, run = run_of(estimator, frames=2)
    inputs, mean, P = log.recorded, log.recorded.prior.mean, log.recorded.prior.covariance
    rows = list(MEASURED[FixKind.POSITION])
    z_hat, H = expected_fix(mean, FixKind.POSITION, inputs.fixes.sources[0])
    S = H @ P @ H.T + inputs.fixes.covariance[0][np.ix_(rows, rows)]
    first = columns_of_run(log, run, 0)[0]
    assert (first["measurement"], first["source"], first["hypothesis"]) == ("fix 0", "gps", "accepted")
    nu = [f"{v:.3g}" for v in inputs.fixes.z[0, :2] - z_hat]
    assert [first[f"innovation {c}"] for c in COMPONENTS] == [*nu, ""]
    assert [first[f"its sigma {c}"] for c in COMPONENTS] == [*(f"{v:.3g}" for v in np.sqrt(np.diag(S))), ""]


@pytest.mark.parametrize("estimator", ["ekf", "isam2"])
def test_the_gate_decides_and_a_wrong_one_that_is_left_out_is_right(estimator):
    log, run = run_of(estimator)
    each = [c for k in range(len(log.recorded)) for c in columns_of_run(log, run, k)]
    assert {c["frames"] != "" for c in each} == {True, False}
    for c in each:
        assert (c["hypothesis"] == "accepted") == (float(c["NIS"]) < float(c["gate 0.99"]))
    wrong = [c for c in each if c["ground truth"] == "outlier"]
    assert wrong
    assert all((c["correct"] == "1") == (c["hypothesis"] == "rejected") for c in wrong)


def test_a_column_per_measurement_has_blanks_where_nothing_is_measured():
    log, run = run_of()
    columns = next(c for k in range(40) if len(c := columns_of_run(log, run, k)) == 3)
    assert [c["measurement"] for c in columns] == ["fix 0", "fix 1", "closure 0"]
    assert [c["source"] for c in columns] == ["gps", "compass", "loops"]
    assert [bool(c["innovation x [m]"]) for c in columns] == [True, False, True]
    assert [c["gate 0.99"] for c in columns] == ["9.21", "6.63", "11.3"]
    assert poses_block(7, columns).startswith("step 7: 2 fixes and 1 closure\nmeasurement")
    assert poses_block(7, []) == ""


def test_the_walk_prints_them_before_the_observations_and_as_the_run_says(capsys):
    assert main([WORLD, "--frames", "30", "--association", "known", "--run-through", "--gate-poses", "0.99"]) == 0
    out = capsys.readouterr().out
    log, run = run_of(frames=30)
    assert out.split("\n", 1)[1].startswith(run_text(log, run).split("whole run")[0])
    assert out.index("step 0: 2 fixes") < out.index("step 0: 3 observations")
    assert main([WORLD, "--frames", "30", "--association", "known", "--run-through", "--lab-text"]) == 0
    assert "fix" not in capsys.readouterr().out


def test_an_estimator_without_fixes_has_none_and_says_so(capsys, tmp_path):
    (tmp_path / "plain.py").write_text(
        "from ekf.localizer import EkfLocalizer\n" "class Plain:\n" "    tasks = ('localization',)\n"
        "    def __init__(self, *given):\n" "        self.f = EkfLocalizer(*given[:3])\n"
        "    def predict(self, i): self.f.predict(i)\n" "    def update(self, o, d): self.f.update(o, d)\n"
        "    def estimate(self): return tuple(self.f.estimate())\n"
    )  # fmt: skip
    named = f"{tmp_path}/plain.py:Plain"
    assert main([WORLD, "--frames", "5", "--association", "known", "--run-through", "--estimator", named]) == 0
    out = capsys.readouterr().out
    assert "step 0: 3 observations" in out
    assert "step 0: 2 fixes" not in out
    assert "fixes" in out.split("NIS per")[-1]
