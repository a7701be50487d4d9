"""Health of a robot that localizes, and a smoother begun anew where it was carried off."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom, chi2, poisson

from association.decide import known_decisions
from data import se2
from data.inputs import FrameObservations
from data.result import DISCARD
from data.sensors import RelativePoint
from eval.replay.hindsight import constants
from eval.replay.hindsight.localizing_frontend import Health, LocalizingFrontEnd, Stretches, recovered, watch
from eval.replay.run import driven
from eval.replay.settings import Setup
from graph.incremental import Isam2Smoother
from tests.builders.logs import increments_of, inputs_of, map_of, observations_of
from tests.graph.worlds import SENSORS, circle


def alarms(frames, state=None):
    """Frames in which an alarm begins, and the last state; frames are (offered, paired, nis, dof)."""
    state, found = state or Health(), []
    for k, frame in enumerate(frames):
        before, state = state, watch(state, *frame)
        if state.lost and not before.lost:
            found.append(k)
            state = recovered(state)
    return found, state


def healthy_frames(rng, n, seen=(1, 9), share=0.99, scale=1.0):
    for _ in range(n):
        offered = int(rng.integers(*seen))
        paired = int(rng.binomial(offered, share))
        yield offered, paired, scale * rng.chisquare(2 * paired) if paired else 0.0, 2 * paired


@pytest.mark.parametrize(("share", "scale"), [
    pytest.param(0.99, 1.0, id="plain", marks=pytest.mark.slow),
    pytest.param(0.99, 0.05, id="conservative", marks=pytest.mark.slow),
    pytest.param(0.9, 1.0, id="10%", marks=pytest.mark.slow), pytest.param(0.7, 1.0, id="30%"),
])  # fmt: skip
def test_false_alarms_stay_below_one_in_ten_thousand_frames(share, scale):
    found, _ = alarms(healthy_frames(np.random.default_rng(0), 40_000, share=share, scale=scale))
    assert len(found) <= 4


def test_being_lost_is_not_learned_to_be_normal():
    _, state = alarms([(4, 4, 8.0, 8)] * 50)
    for _ in range(5):
        state = watch(state, 4, 0, 0.0, 0)
    assert state.lost
    share = state.share
    for _ in range(100):
        state = watch(state, 4, 0, 0.0, 0)
    assert state.share == share > 0.85


def test_what_a_frame_adds_is_a_log_likelihood_ratio():
    p, q, r = 0.9, 0.9 * constants.LOST_SHARE, constants.LOST_SCALE
    before = Health(unpaired=5.0, misfit=4.0, share=p, strays=0.1)
    after = watch(before, 3, 1, 7.0, 2)
    assert after.unpaired == pytest.approx(5.0 + binom.logpmf(1, 3, q) - binom.logpmf(1, 3, p), rel=1e-12)
    clutter = watch(replace(before, strays=1.5), 3, 1, 7.0, 2)
    assert clutter.unpaired == pytest.approx(5.0 + poisson.logpmf(2, 3 * (1 - q)) - poisson.logpmf(2, 1.5), rel=1e-12)
    assert after.misfit == pytest.approx(4.0 + chi2.logpdf(7.0, 2, scale=r) - chi2.logpdf(7.0, 2), rel=1e-12)
    gain = 3.0 / (before.learned + 3.0)
    assert (after.share, after.strays) == pytest.approx((p + gain * (1.0 / 3.0 - p), 0.1 + gain * (2.0 - 0.1)))


def test_a_frame_without_observations_says_nothing():
    state = Health(unpaired=3.0)
    assert watch(state, 0, 0, 0.0, 0) == state


def test_after_recovery_there_is_no_suspicion_and_nothing_is_forgotten():
    state = Health(unpaired=20.0, misfit=3.0, share=0.8, scale=2.0, learned=500.0, lost=True)
    assert recovered(state) == Health(share=0.8, scale=2.0, learned=500.0)


AT = 8


def run(inputs, decisions, amended=None, late=None):
    """Final path; at frame `AT` the smoother is begun anew, at the end `amended` frames are decided about as `late`."""
    s = Stretches(lambda prior: Isam2Smoother(prior, inputs.sensor, inputs.map), inputs.prior)
    o = inputs.observations
    for k in range(len(inputs)):
        if k:
            s.predict(inputs.increment(k))
        rows = slice(inputs.start[k], inputs.start[k + 1])
        if rows.stop > rows.start:
            s.update(inputs.frame_observations(k), decisions[rows])
        if k == AT:
            s.reset(s.estimate().mean + 0.01, 0.01 * np.eye(3))
    if amended is not None:
        rows = np.flatnonzero(np.isin(o.frame, amended))
        s.amend(o.frame[rows], FrameObservations(o.z[rows], o.R[rows]), late[rows])
    return s.finish().final.pose


def test_only_what_the_present_smoother_saw_is_amended():
    inputs, _, _ = circle(SENSORS["range-bearing"], frames=16, landmarks=10, see=1.0)
    decisions, _ = known_decisions(inputs)
    seen = inputs.observations.frame
    assert {3, AT, AT + 1, AT + 4} <= set(seen.tolist())
    none = np.full(len(decisions), DISCARD)
    plain = run(inputs, decisions)
    assert np.array_equal(run(inputs, decisions, [3, AT], decisions), plain)
    for frame in (AT + 1, AT + 4):
        expected = run(inputs, np.where(seen == frame, DISCARD, decisions))
        assert np.abs(run(inputs, decisions, [3, AT, frame], none) - expected).max() < 1e-6
        assert np.abs(plain - expected).max() > 1e-3


def carried_off(frames=24, at=10):
    """(Inputs, true path, true id of each observation): a robot among 60 trees, put somewhere else unseen."""
    rng, sensor = np.random.default_rng(0), RelativePoint(max_range=8.0)
    xy, step = rng.uniform(-20.0, 20.0, (60, 2)), np.array([0.3, 0.0, 0.05])
    truth = np.tile([-8.0, -6.0, 0.4], (frames, 1))
    for k in range(1, frames):
        truth[k] = se2.compose(np.array([9.0, 7.0, -2.0]) if k == at else truth[k - 1], step)
    there = [sensor.predict(pose, xy) for pose in truth]
    frame, who = np.nonzero([sensor.in_view(z) for z in there])
    z = np.array(there)[frame, who] + 0.05 * rng.standard_normal((len(who), 2))
    sigma = np.array([0.02, 0.02, 0.01])
    mean = step + sigma * rng.standard_normal((frames, 3))
    increments, seen = increments_of(mean, np.diag(sigma**2)), observations_of(frame, z, 0.05**2)
    inputs = inputs_of(increments, seen, sensor, map_of(xy), start=truth[0], spread=1e-4)
    return inputs, truth, who


@pytest.mark.parametrize("name", ["ekf", "isam2"])
def test_a_robot_that_was_carried_off_goes_on_from_where_it_is_found(name):
    inputs, truth, who = carried_off()
    front = LocalizingFrontEnd(name, "jcbb-hindsight", inputs, Setup())
    run = driven(name, front, inputs, "localization")
    assert run.failure is None
    assert front.alarms == front.found == [10]
    assert run.decisions.tolist() == run.final_decisions.tolist() == who.tolist()
    assert (run.created == -1).all()
    # its place is all that the frame tells: nothing is left to be compared with it
    assert np.isnan(run.innovations.nis).tolist() == [k == 10 for k in range(24)]
    assert run.innovations.dof[[9, 10, 11]].tolist() == [12, 0, 12]
    for path in (run.online, run.final):
        if path is not None:
            error = se2.pose_error(path.pose, truth)
            assert (np.abs(error) < 4.0 * np.sqrt(np.diagonal(path.covariance, axis1=1, axis2=2))).all()
            assert np.hypot(error[:, 0], error[:, 1]).max() < 0.1
