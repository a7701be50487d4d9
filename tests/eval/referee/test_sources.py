"""Fixes and closures by source: NIS behind the gate, decisions against truth, and what deserves a notice."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from data.log import shortened
from data.logs import open_log
from data.notice import Code
from data.pose_measurements import Closures, Fixes, FixKind, FixSource, PoseUpdated
from data.words import sentence
from eval.judgement.judgement import Verdict, judge
from eval.judgement.runs import Objection
from eval.referee import consistency
from eval.referee.diagnostics import notices
from eval.referee.lost import unused
from eval.referee.score import Trial, score
from eval.referee.sources import outcomes_of, score_source, scores_of, source_notices, sources_of
from eval.referee.truth_free import of_online
from eval.replay.run import compare
from tests.eval.handmade import FRAMES, circle_log, run_with_error
from tests.quick import slow

DOF = {FixKind.POSITION: 2, FixKind.HEADING: 1, FixKind.POSE: 3}


def fixes(count=60, kind=FixKind.POSITION):
    frame = np.sort(np.arange(count) % FRAMES)
    return Fixes(
        frame, np.full(count, int(kind)), np.zeros(count), np.zeros((count, 3)), np.tile(np.eye(3), (count, 1, 1)),
        (FixSource("gps"),),
    )  # fmt: skip


def closures(count=20):
    later = np.sort(1 + np.arange(count) % (FRAMES - 1))
    eye = np.tile(np.eye(3), (count, 1, 1))
    return Closures(np.zeros(count), later, np.zeros((count, 3)), eye, np.zeros(count), ("loops",))


def drawn(rng, count, dof, *, gate=None, scale=1.0):
    """Innovations as a consistent filter has them, in units of `scale` sigmas, and which pass the gate."""
    white = np.full((count, 3), np.nan)
    columns = {1: [2], 2: [0, 1], 3: [0, 1, 2]}[dof]
    white[:, columns] = scale * rng.standard_normal((count, dof))
    nis = np.nansum(white**2, axis=1)
    used = np.ones(count, bool) if gate is None else nis < scipy.stats.chi2.ppf(gate, dof)
    return PoseUpdated(used, nis, np.full(count, dof), white, np.full((count, 3, 3), np.nan), gate)


def log_with(of_fixes=None, of_closures=None, **truth):
    log = circle_log()
    recorded = replace(log.recorded, fixes=of_fixes, closures=of_closures)
    return replace(log, recorded=recorded, truth=replace(log.truth, **truth))


def run_with(**innovations):
    return replace(run_with_error(np.zeros(3)), **innovations)


def scored(found, log, **truth):
    (source,) = sources_of(log.recorded)
    return score_source(run_with(fixes=found), source, "online", log.truth)


def test_sources_are_taken_apart_and_scored_by_chi_square_without_a_gate():
    found = drawn(np.random.default_rng(0), 60, 2)
    s = scored(found, log_with(fixes()))
    assert s.nis_dof == 120
    assert s.nis_mean == pytest.approx(found.nis.sum() / 120)
    np.testing.assert_allclose((s.nis_low, s.nis_high), scipy.stats.chi2.ppf([0.025, 0.975], 120) / 120)
    found = sources_of(log_with(replace(fixes(6), kind=np.array([0, 1, 0, 1, 2, 0])), closures()).recorded)
    assert [(s.name, s.kind, len(s.rows)) for s in found] == [
        ("gps", "position", 3), ("gps", "heading", 2), ("gps", "pose", 1), ("loops", "closure", 20),
    ]  # fmt: skip
    used = np.array([True, True, False, False, True, False])
    assert outcomes_of(used, np.array([1, 0, 0, 1, -1, -1])) == (1, 1, 1, 1)
    found = drawn(np.random.default_rng(0), 4, 3)._replace(used=np.array([True, False, True, True]))
    log = log_with(of_closures=closures(4), closure_inlier=np.array([1, 0, 0, 1]))
    rows = score([Trial(log, "slam", (run_with(closures=found),))]).sources
    assert rows[["source", "kind", "count", "used", "tp", "tn", "fp", "fn"]].values.tolist() == [
        ["loops", "closure", 4, 3, 2, 1, 1, 0]
    ]


@pytest.mark.parametrize("kind", [FixKind.POSITION, slow(FixKind.HEADING), slow(FixKind.POSE)])
def test_behind_a_gate_a_consistent_filter_fits_and_one_whose_sigma_is_off_does_not(kind):
    """Of logs with 60 fixes 95 % fit; sigmas off by a third are found in most."""
    rng, log = np.random.default_rng(1), log_with(fixes(kind=kind))
    words = {
        scale: [scored(drawn(rng, 60, DOF[kind], gate=0.99, scale=scale), log).verdict for _ in range(120)]
        for scale in (1.0, 1.35, 0.7)
    }
    assert 0.90 <= np.mean([w == consistency.FIT for w in words[1.0]]) <= 0.99
    assert np.mean([w == consistency.LARGE for w in words[1.35]]) > 0.5
    assert np.mean([w == consistency.SMALL for w in words[0.7]]) > 0.7


@pytest.mark.parametrize(("scale", "nis"), [(1.8, "too small, or they are biased"), (0.4, "covariance is too large")])
def test_a_source_with_a_wrong_covariance_is(scale, nis):
    rng, log = np.random.default_rng(4), log_with(fixes())
    found = source_notices(run_with(fixes=drawn(rng, 60, 2, scale=scale)), log.recorded)
    assert [n.code for n in found] == [Code.SOURCE_NIS]
    assert nis in sentence(found[0])


def test_a_source_with_outliers_is_rejected_and_one_that_cannot_be_used_is_unused():
    rng, log = np.random.default_rng(5), log_with(fixes())
    found = drawn(rng, 60, 2, gate=0.99)
    used = found.used.copy()
    used[:10] = False
    (notice,) = source_notices(run_with(fixes=found._replace(used=used)), log.recorded)
    assert notice.code == Code.SOURCE_REJECTED
    assert notice.named["rejected"] >= 10
    assert notice.named["expected"] == pytest.approx(0.6)
    log = log_with(of_closures=closures())
    (notice,) = source_notices(run_with(), log.recorded)
    assert (notice.code, notice.named["count"]) == (Code.SOURCE_UNUSED, 20)
    assert [n.code for n in notices([Trial(log, "slam", (run_with(),))])].count(Code.SOURCE_UNUSED) == 1


def nothing_seen(**sources):
    log = log_with(**sources)
    o = log.recorded.observations
    recorded = replace(log.recorded, observations=replace(o, frame=o.frame[:0], z=o.z[:0], R=o.R[:0]))
    empty = np.empty(0, np.int64)
    run = replace(run_with(), decisions=empty, final_decisions=empty, created=empty)
    return replace(log, recorded=recorded, truth=replace(log.truth, landmark_of=None)), run


def test_only_an_estimate_that_used_closures_is_more_than_dead_reckoning():
    log, run = nothing_seen(of_closures=closures())
    assert unused(run, log.recorded).code == Code.UNUSED
    found = drawn(np.random.default_rng(0), 20, 3)
    assert unused(replace(run, closures=found), log.recorded) is None
    assert unused(replace(run, closures_final=found), log.recorded) is None
    rejected = found._replace(used=np.zeros(20, bool))
    assert unused(replace(run, closures=rejected), log.recorded).code == Code.UNUSED


def statistics(found, log):
    return of_online(run_with(fixes=found), None, log.recorded)


def test_a_source_has_statistics_of_its_own():
    log, found = log_with(fixes()), drawn(np.random.default_rng(6), 60, 2, gate=0.99)
    own = statistics(found, log)
    assert own["nis_position:gps"].value == pytest.approx(found.nis[found.used].sum() / (2 * found.used.sum()))
    assert own["nis_position:gps"].expected == pytest.approx(0.9535, abs=1e-4)
    lag1 = own["innovation_position:gps_lag1"]
    assert abs(lag1.value) < 4.0 * lag1.se


def test_the_largest_innovation_of_a_source_has_the_significance_of_the_largest_of_so_many():
    """Rejected ones included; of sound logs its distance from the median is standard Gaussian."""
    rng, log = np.random.default_rng(7), log_with(fixes())
    each = [statistics(drawn(rng, 60, 2, gate=0.9999), log)["largest_position:gps"] for _ in range(300)]
    z = np.array([(m.value - m.expected) / m.se for m in each])
    assert scipy.stats.kstest(z, "norm").pvalue > 0.001
    found = drawn(rng, 60, 2, gate=0.9999)
    nis, used = found.nis.copy(), found.used.copy()
    nis[5], used[5] = 30.0, False
    m = statistics(found._replace(nis=nis, used=used), log)["largest_position:gps"]
    p = 1.0 - scipy.stats.chi2.cdf(30.0, 2) ** 60
    assert scipy.stats.norm.sf((m.value - m.expected) / m.se) == pytest.approx(p, rel=1e-6)


def test_copies_of_dead_reckoning_beside_closures_are_not_trusted():
    log, run = nothing_seen(of_closures=closures())
    log = replace(log, truth=replace(log.truth, pose=None))
    smoother = replace(run, estimator="batch", online=None, final=run.online)
    bare = judge(Trial(log, "slam", (run, smoother)), score([Trial(log, "slam", (run, smoother))]), ())
    assert (bare.verdict, bare.log_faults.empty) == (Verdict.NEITHER, False)
    assert [o.objection for o in bare.objections] == [Objection.IDLE, Objection.IDLE]
    found = drawn(np.random.default_rng(0), 20, 3)
    used = replace(run, closures=found), replace(smoother, closures_final=found)
    assert not judge(Trial(log, "slam", used), score([Trial(log, "slam", used)]), ()).objections


def test_what_gnc_accepts_is_expected_below_its_threshold_by_source():
    log = shortened(open_log("mixed:7:jumps=true+closure_gap=2+closure_period=1"), 60)
    (run,) = compare(log.inputs(labels=True), "localization", ("gnc",), "known")
    dof = {"gps": 2, "compass": 1, "loops": 3}
    scored = {s.source: s for s in scores_of(run, log.recorded, log.truth) if s.phase == "final"}
    for name, d in dof.items():
        c = scipy.stats.chi2.ppf(0.99, d)
        assert scored[name].expected == pytest.approx(scipy.stats.chi2.cdf(c, d + 2) / scipy.stats.chi2.cdf(c, d))
        assert scored[name].gate == 0.99
    assert scored["gps"].outcomes[2] == 0
