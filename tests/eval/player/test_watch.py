"""Watching a replay changes nothing, and what is written down is what the estimator knew at each instant."""

from __future__ import annotations

import numpy as np
import pytest

from association.names import METHODS
from data.inputs import Increments, Inputs, LabelledObservations, LandmarkMap, Prior
from data.log import shortened
from data.logs import open_log
from data.sensors import RelativePoint
from eval.player.scene import COARSE, own_steps
from eval.player.watch import NOT_ASKED, Watch
from eval.replay.recorder import Observer
from eval.replay.run import compare, step_by_step
from eval.replay.settings import Setup
from tests.quick import slow


class Memory(Observer):
    """Remembers everything, at full precision."""

    def __init__(self):
        self.maps, self.d2, self.said = {}, {}, {}

    def decided(self, front, frame, pairing):
        e = pairing.expectation
        for i in range(len(e.z)):
            for j, number in enumerate(e.number.tolist()):
                nu = e.z[i] - e.z_hat[j]
                nu = front.given.sensor.residual(e.z[i], e.z_hat[j]) if front.given.sensor.kind == 0 else nu
                self.d2[frame.first + i, number] = float(nu @ np.linalg.inv(e.HPHt[j] + e.R[i]) @ nu)
        for name in METHODS if len(e.number) else ():
            self.said[frame.number, name] = front.decide(e, name).decisions

    def updated(self, front, decisions, created):
        self.maps[front.k] = front.landmarks()


@pytest.fixture(scope="module")
def corridor():
    return shortened(open_log("corridor:0:people"), 12)


@pytest.fixture(scope="module")
def watched(corridor):
    memory = Memory()
    step_by_step("ekf", corridor.inputs().without_map(), "slam", "jcbb", observer=memory)
    return memory, compare(corridor.inputs(), "slam", ["ekf"], "jcbb", watch=Watch)[0]


def landmarks_at(w, frame):
    """By number, from the changes up to a frame: x, y, sigma_x, sigma_y, rho."""
    now = {}
    for i in np.flatnonzero(w.changes[:, 0] <= frame):
        number = int(w.changes[:, 1][i])
        now[number] = np.array([*w.changes[:, 3:5][i], *w.changes[:, 5:7][i], w.changes[:, 7][i]])
        if not w.changes[:, 2][i]:
            del now[number]
    return now


def test_landmarks_and_distances_are_those_of_each_instant_for_every_method(watched, corridor):
    memory, run = watched
    w = run.watched
    assert w.quantum == 1e-3
    assert w.every == 1
    for frame, state in memory.maps.items():
        now = landmarks_at(w, frame)
        assert sorted(now) == state.number.tolist()
        for number, xy, P in zip(state.number.tolist(), state.xy, state.covariance, strict=True):
            sigma = np.sqrt(np.diag(P))
            assert np.abs(now[number][:2] - xy).max() <= 0.5 * w.quantum
            assert 3 * np.abs(now[number][2:4] - sigma).max() <= 0.5 * w.quantum
    memory, run = watched
    w = run.watched
    for row, number, d2 in zip(w.pairs[:, 0].tolist(), w.pairs[:, 1].tolist(), w.pairs[:, 2], strict=True):
        assert d2 == pytest.approx(memory.d2[row, number], rel=1e-9)
    for row in {row for row, _ in memory.d2}:
        nearest = min((n for r, n in memory.d2 if r == row), key=lambda n: memory.d2[row, n])
        assert nearest in w.pairs[:, 1][w.pairs[:, 0] == row]
    paired = np.flatnonzero(run.decisions >= 0)
    assert set(zip(paired.tolist(), run.decisions[paired].tolist(), strict=True)) <= set(
        zip(w.pairs[:, 0].tolist(), w.pairs[:, 1].tolist(), strict=True)
    )
    memory, run = watched
    w, start = run.watched, corridor.recorded.start
    for (frame, name), said in memory.said.items():
        assert w.method_decisions[start[frame] : start[frame + 1], METHODS.index(name)].tolist() == said.tolist()
    assert (w.method_decisions[: start[1]] == NOT_ASKED).all()  # there was no map


@pytest.mark.parametrize("association", ["known", slow("jcbb"), "jcbb-hindsight"])
@pytest.mark.parametrize("estimator", ["ekf", "isam2"])
def test_watching_changes_no_number(corridor, estimator, association):
    inputs = corridor.inputs(labels=association == "known")
    plain, seen = (compare(inputs, "slam", [estimator], association, watch=w)[0] for w in (None, Watch))
    for phase in plain.phases:
        assert np.array_equal(plain.trajectory(phase).pose, seen.trajectory(phase).pose, equal_nan=True)
        assert np.array_equal(plain.trajectory(phase).covariance, seen.trajectory(phase).covariance, equal_nan=True)
    assert plain.decisions.tolist() == seen.decisions.tolist()
    assert np.array_equal(plain.map.covariance, seen.map.covariance)
    assert plain.watched is None
    assert len(seen.watched.changes[:, 0])
    assert seen.watched.covariances == (estimator == "ekf")


def test_a_landmark_that_leaves_the_map_leaves_the_picture(corridor):
    run = compare(corridor.inputs(), "slam", ["ekf"], "nn", Setup(maintain=True), Watch)[0]
    w = run.watched
    gone = np.flatnonzero(run.removed >= 0)
    assert len(gone)
    last = len(corridor.recorded) - 1
    assert sorted(landmarks_at(w, last)) == run.map.number.tolist()
    assert not set(gone.tolist()) & set(landmarks_at(w, last))
    assert sorted(w.changes[:, 1][w.changes[:, 2] == 0]) == gone.tolist()  # each once


def test_steps_of_each_landmark_add_up_to_its_values():
    number = np.array([4, 7, 4, 4, 7])
    values = np.array([[1.0], [10.0], [3.0], [2.0], [11.0]])
    assert own_steps(number, values)[:, 0].tolist() == [1.0, 10.0, 2.0, -1.0, 1.0]
    assert 0 < COARSE < 0.02


def test_kept_are_the_nearest_twelve_in_the_gate_and_who_was_paired_however_far():
    # the robot stands exactly at the origin, so a distance is that of the reading from the landmark, in sigmas
    x = 1.0 + 0.1 * np.arange(16)
    number, z = 2 * np.arange(16) + 1, np.array([[1.0, 0.05], [12.0, 0.0], [-9.0, 0.0]])
    inputs = Inputs(
        Prior(np.zeros(3), np.zeros((3, 3))), np.array([0.0]), Increments(np.zeros((1, 3)), np.zeros((1, 3, 3))),
        LabelledObservations(np.zeros(3, np.int64), z, np.tile(np.eye(2), (3, 1, 1)), np.array([31, 7, 1])),
        RelativePoint(max_range=20.0), LandmarkMap(number, np.column_stack([x, np.zeros(16)])),
    )  # fmt: skip
    run = compare(inputs, "localization", ["ekf"], "known", watch=Watch)[0]
    w = run.watched
    assert run.decisions.tolist() == [31, 7, 1]
    kept = {0: [*range(12), 15], 1: [3, 15], 2: [0]}
    pairs = [(row, int(number[j])) for row, each in kept.items() for j in each]
    assert list(zip(w.pairs[:, 0].tolist(), w.pairs[:, 1].tolist(), strict=True)) == pairs
    d2 = [(x[j] - z[row, 0]) ** 2 + z[row, 1] ** 2 for row, each in kept.items() for j in each]
    assert w.pairs[:, 2] == pytest.approx(d2, abs=1e-9)
    seen = [*range(12), 15]
    assert w.seen[:, 0].tolist() == [0] * 13
    assert w.seen[:, 1].tolist() == number[seen].tolist()
    assert w.seen[:, 2:4] == pytest.approx(np.column_stack([x[seen], np.zeros(13)]), abs=1e-12)
    assert w.seen[:, 4:6] == pytest.approx(np.zeros((13, 2)), abs=1e-12)
    nearest = w.method_decisions[:, METHODS.index("nn")]
    assert nearest[0] == 1
    assert (nearest[1:] < 0).all()  # more than 9 sigma from all
