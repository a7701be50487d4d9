"""What two scans of the corridor say of a move: the likelihood by hand, its two peaks, and the prior that decides."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, multivariate_normal

from data.inputs import Increment
from data.worlds.corridor import Corridor, simulate
from eval.referee.score import Trial, score
from eval.report.page.blocks import Table
from tests.eval.handmade_lab import lab_log, lab_run
from wings.labs.corridor import find_lab, has_prior
from wings.labs.plan import switched_on
from wings.labs.questions import STEPS, ambiguity, fit, prior_likelihood, straight_pairs
from wings.labs.sections import lab_sections

BARE = simulate(Corridor(odometry=False), 0)
PRIMED = simulate(Corridor(odometry=False, forward=True), 0)
AMBIGUOUS, CHANGES = "Do two scans determine the motion?", "What does a motion prior change?"


def test_the_likelihood_of_a_move_is_that_of_its_definition():
    frame, step = 3, 0.97
    r = BARE.recorded
    before, now = (slice(r.start[k], r.start[k + 1]) for k in (frame - 1, frame))
    total, fitting = 0.0, 0
    for z, R in zip(r.observations.z[now], r.observations.R[now]):
        pairs = list(zip(r.observations.z[before], r.observations.R[before]))
        densities = [multivariate_normal.pdf(z + [step, 0.0], mean, P + R) for mean, P in pairs]
        reach = max(np.hypot(*r.observations.z[rows].T).max() for rows in (before, now))
        total += np.log(0.5 * np.mean(densities) + 0.5 / (0.5 * np.pi * reach**2))
        nearest = min((z + [step, 0.0] - m) @ np.linalg.solve(P + R, z + [step, 0.0] - m) for m, P in pairs)
        fitting += nearest < chi2.ppf(0.99, 2)
    likelihood, count = fit(BARE, frame, np.array([step]))
    assert likelihood[0] == pytest.approx(total, rel=1e-9)
    assert count[0] == fitting


def test_in_the_middle_of_a_corridor_a_step_back_explains_the_scan_as_well_as_one_ahead():
    pairs = {p.frame: p for p in straight_pairs(BARE)}
    assert len(pairs) == 40, "43 motions, of them 3 turns"
    assert not {11, 22, 33} & set(pairs)
    for frame in (2, 3, 4):
        pair = pairs[frame]
        assert pair.at(1).fitting == pair.at(-1).fitting == 8
        for peak in (pair.at(1), pair.at(-1)):
            around = fit(BARE, frame, peak.step + np.array([-0.005, 0.0, 0.005]))[0]
            assert around[1] == peak.likelihood == around.max()
        assert abs(pair.at(1).likelihood - pair.at(-1).likelihood) < 5.0
        assert max(pair.at(m).likelihood for m in STEPS if m not in (1, -1)) < pair.at(-1).likelihood - 20.0
        assert (pair.at(1).step, pair.at(-1).step) == (pytest.approx(1.0, abs=0.05), pytest.approx(-1.0, abs=0.05))
    # the corridor's end is in view, and it settles the matter
    assert pairs[9].at(1).likelihood > pairs[9].at(-1).likelihood + 50.0


def test_the_prior_is_the_density_of_what_is_stated():
    stated = Increment(np.array([0.5, 0.1, 0.0]), np.diag([0.16, 0.01, 1.0]))
    wanted = multivariate_normal.logpdf([-1.0, 0.0, 0.0], stated.mean, stated.covariance)
    assert prior_likelihood(stated, -1.0) == pytest.approx(wanted)
    forward = PRIMED.recorded.increment(5)
    # 1.25 and 3.75 sigma
    assert prior_likelihood(forward, 1.0) - prior_likelihood(forward, -1.0) == pytest.approx((3.75**2 - 1.25**2) / 2)


def test_a_log_with_a_prior_is_one_without_odometry_and_joins_the_lab_of_its_seed():
    steady = simulate(Corridor(odometry=False, constant_velocity=True), 0)
    for log in (PRIMED, steady, replace(PRIMED, source={}), replace(steady, source={})):
        assert switched_on(log) == (False, False)
        assert has_prior(log)
    for log in (BARE, simulate(Corridor(), 0), replace(BARE, source={}), replace(simulate(Corridor(), 0), source={})):
        assert not has_prior(log)
    lab = find_lab([Trial(log, "slam", ()) for log in (simulate(Corridor(), 0), PRIMED, BARE)])
    assert lab.trials[False, False].log.name == BARE.name
    assert lab.primed == {False: lab.primed[False]}
    assert lab.primed[False].log.name == PRIMED.name


def answers(*trials):
    return {s.heading: s.blocks for s in lab_sections(trials, score(trials))}


@pytest.mark.slow
def test_the_report_shows_both_peaks_and_what_the_prior_makes_of_them():
    said = answers(Trial(BARE, "slam", ()), Trial(PRIMED, "slam", ()))
    q = ambiguity(find_lab([Trial(BARE, "slam", ()), Trial(PRIMED, "slam", ())]))
    assert (q.moves, q.both, q.decides, q.primed) == (40, 19, False, PRIMED.name)
    assert q.prior == pytest.approx(518.0, abs=0.5)
    text, table = said[AMBIGUOUS]
    assert "does not determine it either" in text
    assert "518 times as likely" in text
    assert isinstance(table, Table)
    assert table.frame["readings that fit, of 10"].tolist() == [4, 0, 8, 0, 8, 0, 4]
    assert [float(v) for v in table.frame["step [m]"]] == pytest.approx(list(STEPS), abs=0.05)
    ahead, back = STEPS.index(1), STEPS.index(-1)
    bare, primed = (table.frame[c].astype(float).tolist() for c in table.frame.columns[2:])
    assert max(bare[ahead], bare[back]) == 0.0
    assert min(bare[ahead], bare[back]) > -1.0
    assert primed[ahead] == 0.0
    assert primed[back] < -5.0
    order = list(said)
    assert order.index(AMBIGUOUS) + 1 == order.index("What happens without odometry?")
    assert CHANGES not in said, "nothing was run"


def test_errors_with_a_prior_stand_beside_those_without():
    bare, primed = lab_log(odometry=False), replace(lab_log(odometry=False), name="corridor:0:no-odometry+forward")
    r = primed.recorded
    mean = np.vstack([np.zeros(3), np.tile([0.5, 0.0, 0.0], (len(r) - 1, 1))])
    primed = replace(primed, recorded=replace(r, increments=replace(r.increments, mean=mean)))
    runs = [(0.4, "ekf"), (0.1, "ekf-iterated")]
    without = Trial(bare, "slam", (lab_run(bare, "known", error=0.2),))
    given = Trial(primed, "slam", tuple(lab_run(primed, "known", error=e, estimator=n) for e, n in runs))
    (text,) = answers(without, given)[CHANGES]
    assert "ekf with known association 0.358 m (0.179 m without)" in text
    assert "ekf-iterated with known association 0.0894 m." in text
    assert "error by a factor of 4.0" in text
    swapped = Trial(primed, "slam", tuple(replace(r, estimator=n) for r, n in zip(given.runs, ("ekf-iterated", "ekf"))))
    assert "costs a factor" not in answers(without, swapped)[CHANGES][0]
