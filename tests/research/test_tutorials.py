"""What the tutorials' programs do otherwise: their gain, and their second best. Their own numbers come out."""

import numpy as np
import pytest

from association.expectation import Expectation
from association.methods import ml_ratio
from data.inputs import FrameObservations, Increment, LandmarkMap, Prior
from data.result import DISCARD, NEW
from data.sensors import RangeBearing
from eval.referee.score import metrics_row
from tests.research.tutorials import STEPS, GainFromBefore, recorded, run, running


def test_the_gain_is_formed_with_the_covariance_from_before_the_prediction():
    A = np.random.default_rng(3).normal(size=(3, 3))
    P0, mean = 0.1 * A @ A.T, np.array([0.3, -0.2, 0.7])
    known = LandmarkMap(np.array([6]), np.array([[4.0, 1.0]]))
    f = GainFromBefore(Prior(mean, P0), RangeBearing(), known)
    u, M, z, R = np.array([0.2, 0.01, 0.1]), np.diag([0.01, 0.02, 0.03]), np.array([[3.8, -0.4]]), np.diag([0.2, 0.1])
    f.predict(Increment(u, M))
    f.update(FrameObservations(z, R[None]), np.array([6]))
    c, s = np.cos(mean[2]), np.sin(mean[2])  # by the book, but for P0 in the gain
    B = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    F = np.eye(3)
    F[:2, 2] = -s * u[0] - c * u[1], c * u[0] - s * u[1]
    x, P = mean + B @ u, F @ P0 @ F.T + B @ M @ B.T
    d = known.xy[0] - x[:2]
    q = d @ d
    H = np.array([[-d[0] / q**0.5, -d[1] / q**0.5, 0.0], [d[1] / q, -d[0] / q, -1.0]])
    nu = z[0] - [q**0.5, np.arctan2(d[1], d[0]) - x[2]]
    K = P0 @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    got = f.estimate()
    np.testing.assert_allclose(got.mean, x + K @ nu, atol=1e-12)
    np.testing.assert_allclose(got.covariance, (np.eye(3) - K @ H) @ P, atol=1e-12)


@pytest.mark.parametrize(("squared", "as_written", "as_taught"), [
    ((0.1, 0.12), 0, DISCARD),  # the second best comes after the best, and is never seen
    ((0.12, 0.1), DISCARD, DISCARD),
    ((0.1, 5.0), 0, 0),
    ((5.0, 0.1), 1, 1),
    ((5.0, 6.0), NEW, NEW),
    ((1.0, 2.0), DISCARD, DISCARD),  # "new" at 0.84 does not beat 1.0 clearly
    ((2.0, 1.0), DISCARD, DISCARD),
    ((11.0, 20.0), NEW, NEW),
])  # fmt: skip
def test_the_running_minimum_forgets_a_second_best_that_comes_later(squared, as_written, as_taught):
    z_hat = np.column_stack([np.sqrt(squared), np.zeros(2)])  # unit innovation covariance: d^2 as given
    H, zero = np.zeros((2, 2, 2)), np.zeros(2, np.int64)
    e = Expectation(
        np.arange(2), z_hat, H, zero, np.zeros((1, 2)), np.eye(2)[None], np.zeros(1, np.int64),
        lambda z, z_hat: z - z_hat, lambda indices: np.zeros((2 * len(indices), 2 * len(indices))), None,
    )  # fmt: skip
    assert running(e).tolist() == [as_written]
    assert ml_ratio(e, None).tolist() == [as_taught]


@pytest.mark.slow
@pytest.mark.parametrize(("step", "lost"), [(1, False), (2, True), (3, False), (4, True)])
def test_on_their_own_recording_the_tutorials_give_the_numbers_of_their_programs(shared_data, step, lost):
    names = ("MRCLAM_Dataset1.zip", "Landmark_Groundtruth.corrected.dat")
    log = recorded(step, *(shared_data / "mrclam" / name for name in names))
    row, (squares, rmse) = metrics_row(run(step, log), "online", log, None), STEPS[step].original
    assert float(row["sse_position_m2"]) == pytest.approx(squares, rel=2e-4)
    assert float(row["rmse_position_m"]) == pytest.approx(rmse, abs=1e-4)
    assert (rmse > 1.0) == lost
