"""SLAM without odometry or labels: frames placed by geometry, where a motion prior is all that is stated; what such a
frame is told of the run so far, and what is kept of it.
"""

from types import SimpleNamespace

import numpy as np
import pytest
from gtsam.symbol_shorthand import L, X

from data.inputs import FrameObservations, Increment
from data.notice import Code, notice
from data.result import NEW
from data.se2 import pose_error, wrap_angle
from data.worlds.registry import named_log
from ekf.slam import EkfSlam
from eval.referee.score import confusion_of
from eval.replay.hindsight import mapper as module
from eval.replay.hindsight.mapper import UncertainMotion
from eval.replay.run import compare
from eval.replay.settings import Setup
from graph.incremental import Isam2Smoother

METHOD = "jcbb-hindsight"
SEEDS = (0, 8, 9)


@pytest.fixture(scope="module")
def primed():
    return [named_log(f"corridor:{seed}:no-odometry+forward") for seed in SEEDS]


def rmse(run, log, phase="online"):
    error = pose_error(run.trajectory(phase).pose, log.truth.pose)[:, :2]
    return float(np.sqrt((error**2).sum(axis=1).mean()))


# seed 8 has a joint marginal that gtsam takes for singular
@pytest.mark.parametrize(("name", "seeds"), [
    ("ekf", [9]), *(pytest.param(*case, marks=pytest.mark.slow) for case in (("ekf-iterated", [9]), ("isam2", [8]))),
])  # fmt: skip
def test_the_corridor_is_mapped_without_odometry_and_without_labels(primed, name, seeds):
    for log in (primed[SEEDS.index(seed)] for seed in seeds):
        (run,) = compare(log.inputs(), "slam", [name], METHOD)
        assert run.failure is None
        assert rmse(run, log) < 0.15
        assert confusion_of(run, log, "final").fp == 0
        assert 87 <= len(run.map) <= 89
        assert Code.PLACED in [note.code for note in run.notes]


@pytest.fixture
def begun(primed):
    """A filter and a smoother that saw the first frame and moved once, and the observations of the second."""
    inputs = primed[0].inputs().without_map()
    o = inputs.observations
    first, second = (FrameObservations(o.z[o.frame == k], o.R[o.frame == k]) for k in (0, 1))
    both = EkfSlam(inputs.prior, inputs.sensor), Isam2Smoother(inputs.prior, inputs.sensor)
    for estimator in both:
        estimator.update(first, np.full(len(first.z), NEW))
        estimator.predict(inputs.increment(1))
    return *both, second


def test_an_expectation_elsewhere_is_the_tangent_there_taken_to_the_mean(begun):
    pose = np.array([1.1, -0.1, 1.2])
    ekf, _, observations = begun
    e = ekf.expect(observations).elsewhere(pose)
    state, P = ekf.mean, ekf.covariance

    def h(x):
        return ekf.sensor.predict(x[:3], x[3:].reshape(-1, 2)).ravel()

    there = np.concatenate([pose, state[3:]])
    step = 1e-6 * np.eye(len(there))
    H = np.stack([(h(there + s) - h(there - s)) / 2e-6 for s in step], axis=1)
    np.testing.assert_allclose(e.z_hat.ravel(), h(there) + H @ (state - there), atol=1e-7)
    np.testing.assert_allclose(e.joint(np.arange(len(e.number))), H @ P @ H.T, atol=1e-7)
    for i in range(len(e.number)):
        np.testing.assert_allclose(e.HPHt[i], (H @ P @ H.T)[2 * i : 2 * i + 2, 2 * i : 2 * i + 2], atol=1e-7)


def test_a_smoother_begins_where_it_is_told_to(begun):
    _, isam2, observations = begun
    labels = np.full(len(observations.z), -2)
    turn = 3.0  # what is seen of five landmarks, from a pose that Gauss-Newton does not find from the prediction
    pose = np.array([0.6, 0.1, turn])
    labels[:5] = [1, 3, 5, 7, 9]
    xy = isam2.landmarks().xy[[1, 3, 5, 7, 9]]
    z = observations.z.copy()
    z[:5] = isam2.sensor.predict(pose, xy)
    isam2.update(FrameObservations(z, observations.R), labels, at=pose)
    assert np.abs(pose_error(isam2.estimate().mean, pose)).max() < 0.05


def test_an_update_at_a_pose_is_one_gauss_newton_step_from_there(begun):
    ekf, _, observations = begun
    decisions = np.full(len(observations.z), -2)
    decisions[[0, 3, 5]] = [2, 4, 6]
    pose = np.array([1.0, 0.0, 2.0 * np.pi + 0.9])  # however the angle is written
    e = ekf.expect(observations).elsewhere(pose)
    chosen = np.array([2, 4, 6])
    mean, S = ekf.mean, e.joint(chosen)
    nu = (observations.z[[0, 3, 5]] - e.z_hat[chosen]).ravel()
    for i, R in enumerate(observations.R[[0, 3, 5]]):
        S[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] += R
    _, Hx, Hl = ekf.sensor.linearize(pose, mean[3:].reshape(-1, 2)[chosen])
    H = np.zeros((6, len(mean)))
    for i, c in enumerate(chosen):
        H[2 * i : 2 * i + 2, :3], H[2 * i : 2 * i + 2, 3 + 2 * c : 5 + 2 * c] = Hx[i], Hl[i]
    gain = ekf.covariance @ H.T @ np.linalg.inv(S)
    expected, P = mean + gain @ nu, ekf.covariance - gain @ H @ ekf.covariance
    assert ekf.update(observations, decisions, at=pose).nis == pytest.approx(nu @ np.linalg.solve(S, nu))
    assert wrap_angle(float(ekf.mean[2] - expected[2])) == pytest.approx(0.0, abs=1e-8)
    np.testing.assert_allclose(np.delete(ekf.mean, 2), np.delete(expected, 2), atol=1e-8)
    np.testing.assert_allclose(ekf.covariance, P, atol=1e-8)


def test_a_large_joint_covariance_is_the_same_in_parts(primed):
    inputs = primed[0].inputs().without_map()
    isam2, o = Isam2Smoother(inputs.prior, inputs.sensor), inputs.observations
    first = FrameObservations(o.z[o.frame == 0], o.R[o.frame == 0])
    isam2.update(first, np.full(len(first.z), NEW))
    for keys in ([L(3), X(0), L(1)], [X(0), *(L(n) for n in range(len(first.z)))]):
        whole = isam2._engine.isam.jointMarginalCovariance(keys).fullMatrix()
        np.testing.assert_allclose(isam2._engine._in_parts(keys), whole, atol=1e-12)


STEP = Increment(np.zeros(3), np.diag([0.04, 0.01, 0.001]))
E = SimpleNamespace(elsewhere=object(), number=np.array([3, 5]))


class Placing:
    """`place` and what it was asked; it finds what it is told to."""

    def __init__(self, monkeypatch):
        self.asked, self.found, self.uncertain = [], None, True
        monkeypatch.setattr(module, "place", self.place)
        monkeypatch.setattr(module, "too_uncertain", lambda e, sensor, motion: self.uncertain)
        ledger = SimpleNamespace(sensor="sensor", frames=4, rates=lambda numbers: numbers / 10.0)
        self.motion = UncertainMotion(ledger, Setup(gate=0.9, new_gate=0.95))

    def place(self, e, sensor, predicted, motion, memory, gate, new_gate):
        self.asked.append((motion.copy(), [p.tolist() for p in memory[0]], memory[1].tolist(), memory[2]))
        assert (e, sensor, gate, new_gate) == (E, "sensor", 0.9, 0.95)
        return self.found

    def frame(self, *decisions, sudden=0):
        self.found = SimpleNamespace(decisions=np.array(decisions), sudden=sudden) if decisions else None
        return self.motion.place(E, np.zeros(3))


@pytest.fixture
def placing(monkeypatch):
    return Placing(monkeypatch)


def test_where_the_prediction_is_good_enough_or_nothing_can_be_linearized_elsewhere_no_frame_is_placed(placing):
    assert placing.motion.place(SimpleNamespace(elsewhere=None), np.zeros(3)) is None
    placing.uncertain = False
    assert placing.frame(1) is None
    assert (placing.asked, placing.motion.placed) == ([], 0)


def test_motion_adds_up_until_a_frame_is_paired(placing):
    for k, paired in enumerate((False, False, True, False)):
        placing.motion.move(STEP)
        placing.motion.see(np.full(3, float(k)), paired)
        placing.frame()
    motions = [motion for motion, *_ in placing.asked]
    # the first frame is where the map begins, paired or not
    for motion, steps in zip(motions, (0, 1, 0, 1), strict=True):
        assert motion == pytest.approx(steps * STEP.covariance)


def test_it_knows_from_where_was_seen_how_often_each_landmark_is_and_how_much_is_stray(placing):
    placing.motion.see(np.array([1.0, 2.0, 3.0]), True)
    placing.frame(4, -1, 0, sudden=2)
    placing.frame(7)
    placing.frame()
    assert [seen for _, seen, _, _ in placing.asked] == [[[1.0, 2.0, 3.0]]] * 3
    assert [rates for _, _, rates, _ in placing.asked] == [[0.3, 0.5]] * 3
    # of a uniform prior; then 2 were paired, 2 not; then one more
    assert [strays for *_, strays in placing.asked] == pytest.approx([1 / 2, 3 / 6, 3 / 7])
    assert placing.motion.placed == 2


@pytest.mark.parametrize(("placed", "hangs"), [(1, False), (2, False), (3, True)])
def test_it_is_said_how_many_frames_were_placed_and_whether_the_path_hangs_on_it(placing, placed, hangs):
    assert placing.motion.notes() == []
    for _ in range(placed):
        placing.frame(1)
    assert placing.motion.notes() == [notice(Code.PLACED, frames=placed, mostly=hangs)]
