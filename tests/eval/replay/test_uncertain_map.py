"""Localization in an uncertain map: consistent where its sigmas are used, far from it where they are not."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from data.inputs import FrameObservations, Increment, LandmarkMap, Prior, Systematic
from data.notice import Code
from data.sensors import RelativePoint
from data.worlds.parameters import surveyed
from data.worlds.registry import named_log
from ekf.localizer import EkfLocalizer
from eval.referee.consistency import nees
from eval.replay.run import compare, filter_known, step_by_step
from eval.replay.settings import FILTERS, Setup
from eval.studies.twins import source_of, twin
from graph.incremental import Isam2Smoother
from tests.eval.replay.test_several_sensors import RADIO, drive
from tests.quick import slow

SIGMA = 0.1
ALL = (*FILTERS, "isam2", "fixed-lag", "batch")


def world(seed, keys="frames=60"):
    """An arena whose map is off by 0.1 m in each coordinate, and says so."""
    return named_log(f"arena:{seed}:sigma_map={SIGMA}+{keys}")


def as_exact(log):
    return replace(log, recorded=replace(log.recorded, map=log.recorded.map.exact))


def last_nees(run, log):
    assert run.failure is None
    t = run.trajectory(run.phases[-1])
    return float(nees(t.pose, t.covariance, log.truth.pose, "pose")[-1])


def bounds(runs):
    """Between which the mean of so many NEES lies in 99 % of studies."""
    low, high = chi2.ppf([0.005, 0.995], 3 * runs) / runs
    return low, high


def means(logs, names, association):
    total = dict.fromkeys(names, 0.0)
    for log in logs:
        for run in compare(log.inputs(labels=association == "known"), "localization", names, association):
            total[run.estimator] += last_nees(run, log) / len(logs)
    return total


@pytest.mark.parametrize(("association", "names", "runs", "frames"), [
    ("known", ("ekf", "ekf-invariant", "batch"), 10, 40), slow("known", ALL, 100, 200),
    slow("jcbb", ("ekf", "isam2", "batch"), 100, 60), slow("jcbb-hindsight", ("ekf", "isam2", "batch"), 100, 60),
])  # fmt: skip
def test_with_its_sigmas_the_nees_is_within_its_bounds_and_without_far_outside(association, names, runs, frames):
    logs = [world(seed, f"frames={frames}") for seed in range(runs)]
    low, high = bounds(runs)
    for name, mean in means(logs, names, association).items():
        assert low < mean < high, (name, mean)
    for name, mean in means([as_exact(log) for log in logs], ("ekf",), "known").items():
        assert mean > 3.0 * high, (name, mean)


@pytest.mark.parametrize("name", FILTERS)
def test_the_compiled_loop_gives_the_bytes_of_single_steps(name):
    log = world(1, "frames=30")
    some = log.recorded.map.sigma * (np.arange(25) % 3 > 0)[:, None]  # every third is exact
    inputs = replace(log.inputs(labels=True), map=replace(log.recorded.map, sigma=some))
    quick, steps = filter_known(inputs, "localization", name=name), step_by_step(name, inputs, "localization")
    np.testing.assert_array_equal(quick.online.pose, steps.online.pose)
    np.testing.assert_array_equal(quick.online.covariance, steps.online.covariance)
    for part in ("xy", "covariance", "first_frame", "times_seen"):
        np.testing.assert_array_equal(getattr(quick.map, part), getattr(steps.map, part))


def test_expectations_hold_the_landmarks_errors_before_and_after_the_first_observation():
    """HPH' and the joint covariance are those of the joint state, whichever landmarks are in it."""
    known = LandmarkMap(np.array([2, 5, 9]), np.array([[3.0, 1.0], [2.0, -2.0], [4.0, 0.0]]),
                        sigma=np.array([[0.3, 0.1], [0.2, 0.4], [0.0, 0.0]]))  # fmt: skip
    prior, sensor = Prior(np.array([0.1, -0.2, 0.3]), np.diag([0.04, 0.09, 0.01])), RelativePoint()
    R = np.diag([0.02, 0.01])
    seen = FrameObservations(sensor.predict(prior.mean, known.xy[:1]) + 0.1, R[None])
    whole = np.diag([0.04, 0.09, 0.01, *(known.sigma.ravel() ** 2)])
    f, s = EkfLocalizer(prior, sensor, known), Isam2Smoother(prior, sensor, known, threshold=1e-9, skip=1)
    mean = np.concatenate([prior.mean, known.xy.ravel()])

    def jacobian():
        _, Hx, Hl = sensor.linearize(mean[:3], mean[3:].reshape(3, 2))
        H = np.zeros((6, 9))
        for j in range(3):
            H[2 * j : 2 * j + 2, :3], H[2 * j : 2 * j + 2, 3 + 2 * j : 5 + 2 * j] = Hx[j], Hl[j]
        return H

    for estimator, tolerance in ((f, 1e-12), (s, 1e-7)):
        e = estimator.expect(seen)
        H = jacobian()
        np.testing.assert_array_equal(e.number, known.id)
        np.testing.assert_allclose(e.joint(np.arange(3)), H @ whole @ H.T, atol=tolerance)
        np.testing.assert_allclose(e.HPHt[1], (H @ whole @ H.T)[2:4, 2:4], atol=tolerance)
    f.update(seen, np.array([2]))
    H = jacobian()[:2]
    K = np.linalg.solve(H @ whole @ H.T + R, H @ whole).T
    mean, whole = mean + K @ (seen.z[0] - sensor.predict(prior.mean, known.xy[:1])[0]), whole - K @ H @ whole
    H, e = jacobian(), f.expect(seen)
    np.testing.assert_allclose(e.joint(np.arange(3)), H @ whole @ H.T, atol=1e-12)
    assert f.size == 5
    f.predict(Increment(np.array([0.1, 0.0, 0.0]), 1e-4 * np.eye(3)))
    assert f.expect(seen).HPHt[1].trace() > e.HPHt[1].trace()


@pytest.mark.parametrize("name", ["ekf", *(slow(name) for name in ALL[1:])])
def test_ranges_to_beacons_whose_places_are_uncertain(name):
    used, exact = [], []
    for seed in range(8):
        log = surveyed(drive(seed, (RADIO,)), 0.5, seed)
        for each, found in ((log, used), (as_exact(log), exact)):
            (run,) = compare(each.inputs(labels=True), "localization", [name])
            found.append(last_nees(run, log))
    low, high = bounds(8)
    assert low < np.mean(used) < high
    assert np.mean(exact) > 2.0 * high


def test_fixes_and_closures_beside_an_uncertain_map():
    """Kept poses lie behind the landmarks in the state."""
    log = named_log("mixed:0:sigma_map=0.1+frames=60")
    for run in compare(log.inputs(labels=True), "localization", ["ekf", "ekf-invariant", "batch"]):
        assert last_nees(run, log) < chi2.ppf(0.999, 3)
        assert run.final is None or run.total_nis is None or run.total_nis[0] < chi2.ppf(0.9999, run.total_nis[1])


def test_errors_that_cannot_matter_are_left_out_and_a_notice_says_so():
    inputs = named_log("arena:1:frames=30+sigma_map=0.0003").inputs(labels=True)
    assert inputs.map_effect < 0.03
    runs = compare(inputs, "localization", ["ekf", "batch"])
    exact = compare(replace(inputs, map=inputs.map.exact), "localization", ["ekf", "batch"])
    for one, other in zip(runs, exact, strict=True):
        phase = one.phases[-1]
        np.testing.assert_array_equal(one.trajectory(phase).pose, other.trajectory(phase).pose)
        assert one.map is None
    assert [n.code for n in runs[0].notes].count(Code.MAP_AS_EXACT) == 1
    assert all(
        n.code is not Code.MAP_AS_EXACT for n in compare(world(1).inputs(), "localization", ["ekf"], "nn")[0].notes
    )


def test_a_range_error_is_refused_beside_an_uncertain_map():
    inputs = replace(world(0, "frames=20").inputs(labels=True), systematic=Systematic(("range",), np.array([0.1])))
    for run in compare(inputs, "localization", ["ekf", "isam2"]):
        assert run.failure is not None
        assert "range" in run.failure.why


def test_twins_draw_the_map_anew_about_the_smoothers():
    log = world(3, "frames=20")
    batch = compare(log.inputs(labels=True), "localization", ["ekf", "batch"])[-1]
    source = source_of(log, batch, (), Setup())
    drawn, again, other = (twin(source, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(drawn.truth.landmarks.xy, batch.map.xy)
    np.testing.assert_array_equal(drawn.recorded.map.xy, again.recorded.map.xy)
    assert not np.isclose(drawn.recorded.map.xy, other.recorded.map.xy).any()
    off = np.array([twin(source, seed).recorded.map.xy - batch.map.xy for seed in range(20)]) / SIGMA
    assert abs(np.mean(off**2) - 1.0) < 0.2
