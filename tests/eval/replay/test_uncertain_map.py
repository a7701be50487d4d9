"""Localization in an uncertain map: consistent where its sigmas are used, far from it where they are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from data.inputs import FrameObservations, Increment, LandmarkMap, Prior, Systematic
from data.log import Log
from data.notice import Code
from data.result import Run
from data.se2 import Array
from data.sensors import RelativePoint
from data.worlds.parameters import surveyed
from data.worlds.registry import named_log
from ekf.localizer import EkfLocalizer
from eval.referee.consistency import nees
from eval.referee.score import Trial
from eval.replay.estimators import OPTIONS
from eval.replay.run import compare, filter_known, step_by_step
from eval.replay.settings import FILTERS, Setup
from eval.studies.twins import source_of, twin
from graph.incremental import Isam2Smoother
from tests.eval.replay.test_several_sensors import RADIO, drive
from tests.quick import slow
from wings.audit.worst_factors import graph_at_end

SIGMA = 0.1
ALL = (*FILTERS, "isam2", "fixed-lag", "batch")


def world(seed: int, keys: str = "frames=60") -> Log:
    """An arena whose map is off by 0.1 m in each coordinate, and says so."""
    return named_log(f"arena:{seed}:sigma_map={SIGMA}+{keys}")


def as_exact(log: Log) -> Log:
    """The same log with the same map, which claims to be exact."""
    assert log.recorded.map is not None
    return replace(log, recorded=replace(log.recorded, map=log.recorded.map.exact))


def last_nees(run: Run, log: Log) -> float:
    """NEES of the last pose."""
    assert run.failure is None
    assert log.truth.pose is not None
    t = run.trajectory(run.phases[-1])
    return float(nees(t.pose, t.covariance, log.truth.pose, "pose")[-1])


def bounds(runs: int, dof: int = 3) -> tuple[float, float]:
    """Between which the mean of so many NEES lies in 99 % of studies."""
    low, high = chi2.ppf([0.005, 0.995], runs * dof) / runs
    return float(low), float(high)


def means(logs: list[Log], names: tuple[str, ...], association: str) -> dict[str, float]:
    """Mean over logs of the last pose's NEES by estimator."""
    total = dict.fromkeys(names, 0.0)
    for log in logs:
        for run in compare(log.inputs(labels=association == "known"), "localization", names, association):
            total[run.estimator] += last_nees(run, log) / len(logs)
    return total


def test_with_its_sigmas_the_nees_is_within_its_bounds_and_without_far_outside() -> None:
    logs = [world(seed, "frames=40") for seed in range(10)]
    low, high = bounds(len(logs))
    for name, mean in means(logs, ("ekf", "ekf-invariant", "batch"), "known").items():
        assert low < mean < high, (name, mean)
    for name, mean in means([as_exact(log) for log in logs], ("ekf",), "known").items():
        assert mean > 3.0 * high, (name, mean)


@pytest.mark.slow
@pytest.mark.parametrize("association", ["known", "jcbb", "jcbb-hindsight"])
def test_nees_of_a_hundred_runs(association: str) -> None:
    labels = association == "known"
    logs = [world(seed, "frames=200" if labels else "frames=60") for seed in range(100)]
    low, high = bounds(len(logs))
    for name, mean in means(logs, ALL if labels else ("ekf", "isam2", "batch"), association).items():
        assert low < mean < high, (name, mean)
    for name, mean in means([as_exact(log) for log in logs], ("ekf", "batch"), "known").items():
        assert mean > 3.0 * high, (name, mean)


def test_landmarks_learn_and_their_errors_fit_their_covariances() -> None:
    squared, sigma = list[Array](), list[Array]()
    for seed in range(6):
        log = world(seed)
        assert log.truth.landmarks is not None
        for run in compare(log.inputs(labels=True), "localization", ["ekf"]):
            assert run.map is not None
            off = run.map.xy - log.truth.landmarks.xy
            squared.append(np.einsum("li,li->l", off, np.linalg.solve(run.map.covariance, off[..., None])[..., 0]))
            sigma.append(np.sqrt(np.diagonal(run.map.covariance, axis1=1, axis2=2))[run.map.times_seen > 20])
            assert (run.map.first_frame[run.map.times_seen > 0] >= 0).all()
    low, high = bounds(6 * 25, 2)
    assert low < np.mean(squared) < high
    assert np.concatenate(sigma).max() < 0.8 * SIGMA


@pytest.mark.parametrize("name", FILTERS)
def test_the_compiled_loop_gives_the_bytes_of_single_steps(name: str) -> None:
    log = world(1, "frames=30")
    assert log.recorded.map is not None
    some = log.recorded.map.sigma * (np.arange(25) % 3 > 0)[:, None]  # every third is exact
    inputs = replace(log.inputs(labels=True), map=replace(log.recorded.map, sigma=some))
    quick, steps = filter_known(inputs, "localization", name=name), step_by_step(name, inputs, "localization")
    assert quick.online is not None
    assert steps.online is not None
    np.testing.assert_array_equal(quick.online.pose, steps.online.pose)
    np.testing.assert_array_equal(quick.online.covariance, steps.online.covariance)
    assert quick.map is not None
    assert steps.map is not None
    for part in ("xy", "covariance", "first_frame", "times_seen"):
        np.testing.assert_array_equal(getattr(quick.map, part), getattr(steps.map, part))


def test_a_map_whose_sigmas_are_zero_gives_the_bytes_of_an_exact_one() -> None:
    log = named_log("arena:1:frames=30")
    inputs = log.inputs(labels=True)
    assert inputs.map is not None
    zero = replace(inputs, map=replace(inputs.map, sigma=np.zeros((25, 2))))
    for name in FILTERS:
        one, other = (filter_known(i, "localization", name=name) for i in (inputs, zero))
        assert one.online is not None
        assert other.online is not None
        np.testing.assert_array_equal(one.online.pose, other.online.pose)
        np.testing.assert_array_equal(one.online.covariance, other.online.covariance)


def test_expectations_hold_the_landmarks_errors_before_and_after_the_first_observation() -> None:
    """HPH' and the joint covariance are those of the joint state, whichever landmarks are in it."""
    known = LandmarkMap(np.array([2, 5, 9]), np.array([[3.0, 1.0], [2.0, -2.0], [4.0, 0.0]]),
                        sigma=np.array([[0.3, 0.1], [0.2, 0.4], [0.0, 0.0]]))  # fmt: skip
    prior, sensor = Prior(np.array([0.1, -0.2, 0.3]), np.diag([0.04, 0.09, 0.01])), RelativePoint()
    R = np.diag([0.02, 0.01])
    seen = FrameObservations(sensor.predict(prior.mean, known.xy[:1]) + 0.1, R[None])
    whole = np.diag([0.04, 0.09, 0.01, *(known.sigma.ravel() ** 2)])
    f, s = EkfLocalizer(prior, sensor, known), Isam2Smoother(prior, sensor, known, threshold=1e-9, skip=1)
    mean = np.concatenate([prior.mean, known.xy.ravel()])

    def jacobian() -> Array:
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


def test_a_landmark_beyond_the_gate_of_an_exact_map_is_paired_within_that_of_an_uncertain_one() -> None:
    log = world(2, "frames=40")
    used, exact = (
        step_by_step("ekf", each.inputs(), "localization", "jcbb", finish=False) for each in (log, as_exact(log))
    )
    paired, true = (used.decisions >= 0), log.truth.landmark_of
    assert true is not None
    assert (used.decisions[paired] == true[paired]).mean() > 0.99
    assert paired.mean() > 0.97, "the gate is 0.99"
    assert (exact.decisions >= 0).mean() < 0.92


@pytest.mark.parametrize("name", ["ekf", *(slow(name) for name in ALL[1:])])
def test_ranges_to_beacons_whose_places_are_uncertain(name: str) -> None:
    used, exact = list[float](), list[float]()
    for seed in range(8):
        log = surveyed(drive(seed, (RADIO,)), 0.5, seed)
        for each, found in ((log, used), (as_exact(log), exact)):
            (run,) = compare(each.inputs(labels=True), "localization", [name])
            found.append(last_nees(run, log))
    low, high = bounds(8)
    assert low < np.mean(used) < high
    assert np.mean(exact) > 2.0 * high


def test_fixes_and_closures_beside_an_uncertain_map() -> None:
    """Kept poses lie behind the landmarks in the state."""
    log = named_log("mixed:0:sigma_map=0.1+frames=60")
    runs = compare(log.inputs(labels=True), "localization", ["ekf", "ekf-invariant", "batch"])
    for run in runs:
        assert last_nees(run, log) < chi2.ppf(0.999, 3)
        assert run.final is None or run.total_nis is None or run.total_nis[0] < chi2.ppf(0.9999, run.total_nis[1])


def test_errors_that_cannot_matter_are_left_out_and_a_notice_says_so() -> None:
    log = named_log("arena:1:frames=30+sigma_map=0.0003")
    inputs = log.inputs(labels=True)
    assert inputs.map is not None
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


def test_what_a_map_adds_to_a_nees_stays_below_its_bound() -> None:
    """The bound holds for every pose; here the mean over maps of what ignoring the errors adds."""
    added, bound = list[float](), 0.0
    for seed in range(20):
        log = named_log(f"arena:{seed}:sigma_map=0.02+frames=25")
        bound = log.recorded.map_effect
        both = as_exact(log), named_log(f"arena:{seed}:frames=25")
        one, other = (filter_known(each.inputs(labels=True), "localization") for each in both)
        added.append(last_nees(one, log) - last_nees(other, log))
    assert 0.0 < np.mean(added) < bound


def test_a_range_error_is_refused_beside_an_uncertain_map() -> None:
    inputs = replace(world(0, "frames=20").inputs(labels=True), systematic=Systematic(("range",), np.array([0.1])))
    for run in compare(inputs, "localization", ["ekf", "isam2"]):
        assert run.failure is not None
        assert "range" in run.failure.why


@pytest.mark.slow
def test_other_systematic_errors_are_estimated_beside_an_uncertain_map() -> None:
    log = world(0, "frames=20")
    inputs = log.inputs(labels=True)
    scale = replace(inputs, systematic=Systematic(("scale", "bearing"), np.array([0.1, 0.1])))
    ekf, isam2, batch = compare(scale, "localization", ["ekf", "isam2", "batch"])
    for run in (ekf, isam2, batch):
        assert last_nees(run, log) < chi2.ppf(0.999, 3)
    assert isam2.final is not None
    assert batch.final is not None
    np.testing.assert_allclose(isam2.final.pose, batch.final.pose, atol=1e-6)


def test_twins_draw_the_map_anew_about_the_smoothers() -> None:
    log = world(3, "frames=20")
    inputs = log.inputs(labels=True)
    batch = compare(inputs, "localization", ["ekf", "batch"])[-1]
    assert batch.map is not None
    source = source_of(log, batch, (), Setup())
    drawn, again, other = (twin(source, seed) for seed in (1, 1, 2))
    assert drawn.recorded.map is not None
    assert again.recorded.map is not None
    assert other.recorded.map is not None
    assert drawn.truth.landmarks is not None
    np.testing.assert_array_equal(drawn.truth.landmarks.xy, batch.map.xy)
    np.testing.assert_array_equal(drawn.recorded.map.xy, again.recorded.map.xy)
    assert not np.isclose(drawn.recorded.map.xy, other.recorded.map.xy).any()
    off = np.array([twin(source, seed).recorded.map.xy - batch.map.xy for seed in range(20)]) / SIGMA  # type: ignore[union-attr]
    assert abs(np.mean(off**2) - 1.0) < 0.2


@pytest.mark.parametrize(("sigma", "kinds"), [(0.1, 4), (0.0003, 3)])
def test_the_graph_that_batch_ends_with_has_the_priors_it_used(sigma: float, kinds: int) -> None:
    log = named_log(f"arena:1:frames=12+sigma_map={sigma}")
    run = compare(log.inputs(labels=True), "localization", ["ekf", "batch"])[-1]
    graph = graph_at_end(Trial(log, "localization", (run,)), run)
    assert len(graph.statistics.kinds.names) == kinds, "prior, odometry, observations, and landmarks of the map"
    assert run.total_nis is not None
    assert graph.statistics.freedom == run.total_nis[1]


@pytest.mark.parametrize("name", FILTERS)
def test_a_landmark_that_joins_late_changes_nothing_beside_kept_poses(name: str) -> None:
    """In front of the kept poses, whenever it is: as if all landmarks had been states from the first frame on."""
    log = named_log("mixed:0:sigma_map=0.1+frames=60+max_range=4+closure_gap=5+closure_radius=6")
    inputs, ends = log.inputs(labels=True), list[Array]()
    assert inputs.map is not None
    assert inputs.closures is not None
    for early in (True, False):
        f = EkfLocalizer(inputs.prior, inputs.sensor, inputs.map, OPTIONS[name])
        f.keep(inputs.closures.last_use())
        if early:
            f._join(np.arange(len(inputs.map.id)))
        sizes = list[tuple[int, int]]()
        for k in range(len(inputs)):
            frame = inputs.frame(k)
            if frame.increment is not None:
                f.predict(frame.increment)
            if frame.closures is not None:
                f.close_loops(frame.closures, None)
            assert frame.label is not None
            f.update(frame.observations, frame.label)
            sizes.append((f.size, f.kept))
        grew = {size for size, kept in sizes if kept}
        assert (len(grew) > 2) != early, "landmarks join beside kept poses"
        ends.append(np.concatenate([f.estimate().mean, f.estimate().covariance.ravel(), f.landmarks().xy.ravel()]))
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-10)
