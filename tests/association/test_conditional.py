"""What all other pairings of a frame say about one, and what the observations of a landmark say about it."""

import numpy as np
import pytest

from association.conditional import (
    blocked_by_pairings,
    conditional_expectation,
    conditional_innovations,
    jcbb_conditional,
    prune,
)
from association.expectation import Expectation, SingularInnovationError, gate_threshold
from association.jcbb import jcbb
from data.result import DISCARD, NEW
from data.sensors import RangeBearing, RelativePoint
from eval.replay.hindsight import constants
from eval.replay.hindsight.ledger import (
    INITIALIZED,
    Judgement,
    Visibility,
    add_miss,
    add_observation,
    confirmed,
    detection_rate,
    verdict,
)
from eval.replay.hindsight.opportunities import missing
from tests.association.problems import problem

GATE, NEW_GATE = 0.99, 0.99999
EYE = np.eye(2)


def turned(sigma=0.035, turn=0.0, noise=0.01, shift=None):
    """Eight points around a robot whose heading has this sigma [rad] and is off by `turn`; noise [m] of a point."""
    angle = np.linspace(-1.5, 1.5, 8)
    z_hat = np.stack([np.cos(angle), np.sin(angle)], 1) * np.array([2.0, 3.0, 4.0, 5.0] * 2)[:, None]
    across = np.stack([-z_hat[:, 1], z_hat[:, 0]], 1).reshape(-1, 1)
    joint = sigma**2 * across @ across.T + noise**2 * np.eye(16)
    z = z_hat + turn * across.reshape(-1, 2)
    if shift is not None:
        z[shift[0]] += shift[1]
    return Expectation.from_arrays(z, z_hat, joint, np.tile(noise**2 * EYE, (8, 1, 1)))


@pytest.mark.parametrize("seed", range(4))
def test_an_innovation_given_the_others_is_that_of_conditioning_on_them(seed):
    e = problem(seed, 5, 5, clutter=0.0)
    every = np.arange(5)
    S = e.joint(every)
    for i in range(5):
        S[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] += e.R[i]
    nu = e.residual(e.z, e.z_hat).ravel()
    found = conditional_innovations(e, every, every)
    for j in range(5):
        own, rest = np.arange(2 * j, 2 * j + 2), np.delete(np.arange(10), [2 * j, 2 * j + 1])
        gain = S[np.ix_(own, rest)] @ np.linalg.inv(S[np.ix_(rest, rest)])
        innovation, covariance = nu[own] - gain @ nu[rest], S[np.ix_(own, own)] - gain @ S[np.ix_(rest, own)]
        np.testing.assert_allclose(found.innovation[j], innovation, atol=1e-9)
        np.testing.assert_allclose(found.information[j], np.linalg.inv(covariance), rtol=1e-7, atol=1e-6)
        assert found.distance[j] == pytest.approx(innovation @ np.linalg.inv(covariance) @ innovation)


def test_a_single_pairing_has_nothing_to_be_conditioned_on():
    e = problem(1, 1, 1, clutter=0.0)
    found = conditional_innovations(e, np.array([0]), np.array([0])).distance
    assert found[0] == pytest.approx(e.individual_distances()[0, 0])


def test_a_singular_joint_covariance_is_named():
    e = Expectation.from_arrays([[0.0, 0.0]], [[0.0, 0.0]], np.zeros((2, 2)), np.zeros((1, 2, 2)), number=np.array([7]))
    with pytest.raises(SingularInnovationError, match=r"\[7\] is singular"):
        conditional_innovations(e, np.array([0]), np.array([0]))


@pytest.mark.parametrize("seed", range(4))
def test_what_is_given_the_pairings_is_what_a_linear_update_expects(seed):
    e = problem(seed, 4, 6, clutter=0.0)
    decisions = np.array([2, NEW, 0, DISCARD])
    rows, chosen = np.array([0, 2]), np.array([2, 0])
    H = np.zeros((4, 12))
    for k, c in enumerate(chosen):
        H[2 * k : 2 * k + 2, 2 * c : 2 * c + 2] = EYE
    P, R = e.joint(np.arange(6)), np.zeros((4, 4))
    R[:2, :2], R[2:, 2:] = e.R[0], e.R[2]
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    mean = e.z_hat.ravel() + K @ (e.z[rows] - e.z_hat[chosen]).ravel()
    after = P - K @ H @ P
    some = np.array([5, 2, 1])
    g = conditional_expectation(e, decisions, some)
    index = (2 * some[:, None] + np.arange(2)).ravel()
    assert g.number.tolist() == some.tolist()
    np.testing.assert_allclose(g.z_hat.ravel(), mean[index], atol=1e-12)
    np.testing.assert_allclose(g.joint(np.arange(3)), after[np.ix_(index, index)], atol=1e-12)
    np.testing.assert_allclose(g.HPHt[1], after[4:6, 4:6], atol=1e-12)


def test_a_common_error_outside_every_single_gate_hides_nothing():
    e = turned(turn=4.0 * 0.035)
    assert (jcbb(e, GATE) >= 0).sum() <= 1
    assert jcbb_conditional(e, GATE, NEW_GATE)[0].tolist() == list(range(8))


def test_a_step_aside_that_passes_the_joint_test_is_undone_and_founds_a_landmark():
    e = turned(shift=(3, np.array([0.05, 0.03])))
    assert jcbb(e, GATE)[3] == 3
    decisions, complete = jcbb_conditional(e, GATE, 0.999)
    assert complete
    assert decisions.tolist() == [0, 1, 2, NEW, 4, 5, 6, 7]
    assert jcbb_conditional(e, GATE, NEW_GATE)[0][3] == DISCARD


def test_the_worst_is_undone_first_so_that_it_takes_no_other_with_it():
    e = turned()
    across = np.array([-e.z_hat[3, 1], e.z_hat[3, 0]]) / 5.0
    e = turned(shift=(3, 0.4 * across))
    everything = np.arange(8)
    contradicted = conditional_innovations(e, everything, everything).distance > gate_threshold(GATE)
    assert contradicted.sum() > 1
    assert prune(e, everything, GATE).tolist() == [0, 1, 2, NEW, 4, 5, 6, 7]


def test_without_a_gate_nothing_is_undone():
    e = turned(shift=(0, np.array([0.0, 5.0])))
    assert prune(e, np.arange(8), None).tolist() == list(range(8))


def test_without_candidates_everything_is_new():
    e = Expectation.from_arrays(np.ones((2, 2)), np.empty((0, 2)), np.empty((0, 0)), np.tile(EYE, (2, 1, 1)))
    assert jcbb_conditional(e, GATE, NEW_GATE)[0].tolist() == [NEW, NEW]


def test_what_is_left_beside_a_landmark_that_was_seen_is_another_one():
    """Of landmarks at 0 and 3 m, both readings are at the first; a third landmark near both leaves it open."""
    z = np.array([[5.0, 0.0], [5.03, 0.0]])
    for third, left in (([5.0, 3.0], True), ([5.04, 0.03], False)):
        z_hat = np.array([[5.0, 0.0], third])
        e = Expectation.from_arrays(z, z_hat, 0.01**2 * np.eye(4), np.tile(0.01**2 * EYE, (2, 1, 1)))
        assert blocked_by_pairings(e, np.array([0, DISCARD]), NEW_GATE).tolist() == [False, left]
    assert not blocked_by_pairings(e, np.array([0, 1]), NEW_GATE).any()
    assert not blocked_by_pairings(e, np.array([DISCARD, DISCARD]), NEW_GATE).any()  # neither landmark was seen


def usual(rate, opportunities=10_000):
    """Landmarks in view seen with a rate, each time independently."""
    seen, missed = round(opportunities * rate), round(opportunities * (1.0 - rate))
    return Visibility(round(seen * rate), round(missed * rate), round(seen * (1 - rate)), round(missed * (1 - rate)))


def life(rng, steps, velocity=(0.0, 0.0), sigma=0.03, turning=0.0):
    """Evidence for a point that is seen `steps` times by a robot that turns, and filtered as one that stands still."""
    R = sigma**2 * EYE
    place, P = rng.normal(0.0, sigma, 2), R
    known = INITIALIZED
    for k in range(1, steps):
        c, s = np.cos(k * turning), np.sin(k * turning)
        G = np.array([[c, -s], [s, c]])
        seen = np.asarray(velocity) * k + rng.normal(0.0, sigma, 2)
        S = P + R
        known = add_observation(known, Judgement(G.T @ (seen - place), np.linalg.inv(G.T @ S @ G), G), True)
        gain = P @ np.linalg.inv(S)
        place, P = place + gain @ (seen - place), P - gain @ P
    return known


@pytest.mark.slow
def test_a_landmark_that_stands_still_is_hardly_ever_said_to_move():
    rng = np.random.default_rng(0)
    assert sum(verdict(life(rng, 12, turning=0.4), usual(0.9)) == "moved" for _ in range(1000)) <= 2


def test_the_mean_innovation_of_a_landmark_that_stands_still_is_chi_square():
    rng = np.random.default_rng(1)
    lives = [life(rng, 6, turning=1.0) for _ in range(1000)]
    drift = [e.pull @ np.linalg.solve(e.information, e.pull) for e in lives]
    assert np.mean(drift) == pytest.approx(2.0, abs=0.2)
    assert np.mean([e.squares for e in lives]) == pytest.approx(10.0, abs=0.5)


@pytest.mark.parametrize("turning", [0.0, 0.7])
def test_a_walk_of_less_than_a_sigma_a_step_is_found_however_the_robot_turns(turning):
    rng = np.random.default_rng(2)
    lives = [life(rng, 9, velocity=(0.02, 0.015), turning=turning) for _ in range(200)]
    assert np.mean([verdict(e, usual(0.9)) == "moved" for e in lives]) > 0.9
    assert np.mean([e.squares > gate_threshold(constants.RESTLESS, 16) for e in lives]) < 0.75


def test_what_jumps_to_and_fro_is_restless_though_its_mean_stays():
    known = INITIALIZED
    for k in range(20):
        known = add_observation(known, Judgement(np.array([0.1 * (-1) ** k, 0.0]), EYE / 0.03**2, EYE), True)
    assert abs(known.pull @ np.linalg.solve(known.information, known.pull)) < 1e-9
    assert verdict(known, usual(0.9)) == "moved"


@pytest.mark.parametrize(("rate", "misses"), [(0.99, 2), (0.85, 4), (0.5, 10), (0.1, 66)])
def test_the_rarer_landmarks_are_seen_the_more_misses_are_needed(rate, misses):
    known = INITIALIZED
    for _ in range(misses - 1):
        known = add_miss(known)
    assert verdict(known, usual(rate)) == ""
    assert verdict(add_miss(known), usual(rate)) == "missed"


def test_a_sighting_ends_a_row_of_misses():
    known = add_observation(add_miss(add_miss(INITIALIZED)), None, True)
    assert (known.seen, known.missed, known.row) == (2, 2, 0)
    assert verdict(add_miss(known), usual(0.9)) == ""


def test_a_certain_landmark_that_is_often_overlooked_is_given_more_time():
    known = INITIALIZED
    for _ in range(constants.CONFIRMED):
        for _ in range(3):
            known = add_miss(known)
        known = add_observation(known, None, True)
    for _ in range(4):
        known = add_miss(known)
    assert verdict(known, usual(0.95)) == ""
    assert verdict(known._replace(seen=2), usual(0.95)) == "missed"


def test_nothing_is_known_of_a_rate_before_anything_was_seen():
    assert detection_rate(0, 0) == 0.5
    assert detection_rate(98, 0) == pytest.approx(0.99)


@pytest.mark.parametrize("sensor_type", [RangeBearing, RelativePoint])
def test_only_what_stands_well_inside_the_view_and_unhidden_is_missed(sensor_type):
    sensor = sensor_type(max_range=10.0, min_angle=-1.0, max_angle=1.0)
    #        seen        missed      too near the edges          out of view  hidden by what is seen, or before it
    polar = [(5.0, 0.0), (5.0, 0.5), (9.95, 0.2), (5.0, 0.98), (5.0, 2.0), (8.0, 0.001), (3.0, 0.001)]
    polar = np.array(polar)
    z_hat = (
        polar if sensor_type is RangeBearing else polar[:, :1] * np.stack([np.cos(polar[:, 1]), np.sin(polar[:, 1])], 1)
    )
    scale = np.array([0.1, 0.02] if sensor_type is RangeBearing else [0.1, 0.1]) ** 2
    joint = np.diag(np.tile(scale, len(polar)))
    e = Expectation.from_arrays(z_hat[:1], z_hat, joint, np.tile(1e-4 * EYE, (1, 1, 1)))
    assert missing(e, np.array([0]), sensor).tolist() == [False, True, False, False, False, False, True]


def test_misses_come_in_rows_where_landmarks_are_hidden_for_a_while():
    """Seen every other time in both worlds; in one a landmark that is hidden stays so for ten looks."""
    independent, hidden = usual(0.5), Visibility(4500, 500, 500, 4500)
    assert independent.rate == pytest.approx(0.5, abs=0.01)
    assert hidden.rate == pytest.approx(0.5, abs=0.01)
    assert independent.row(6, 0.5) == pytest.approx(0.5**6, rel=0.02)
    assert hidden.row(6, 0.5) == pytest.approx(0.5 * 0.9**5, rel=0.02)
    known = INITIALIZED
    for _ in range(10):
        known = add_miss(known)
    assert verdict(known, independent) == "missed"
    assert verdict(known, hidden) == ""


def test_before_anything_is_known_of_rows_misses_are_independent():
    assert Visibility().row(3, 0.8) == pytest.approx(0.2**3)
    assert Visibility().row(0, 0.8) == 1.0


def test_looks_are_counted_by_what_came_before():
    v = Visibility()
    for before_missed, seen in [(False, True), (False, False), (True, False), (True, True), (False, True)]:
        v = v.counting(before_missed, seen)
    assert v == Visibility(2, 1, 1, 1)
    assert v.rate == pytest.approx(4 / 7)


def test_where_landmarks_are_rarely_seen_two_sightings_make_one_certain():
    twice = add_observation(INITIALIZED, None, True)
    assert confirmed(twice, usual(0.3))
    assert not confirmed(twice, usual(0.95))
    assert not confirmed(INITIALIZED, usual(0.05))
    assert confirmed(twice._replace(seen=constants.CONFIRMED), usual(0.95))


def test_against_a_certain_landmark_there_must_be_more():
    v, few = usual(0.8), INITIALIZED
    sure = INITIALIZED._replace(seen=20, opportunities=20)
    for _ in range(5):
        few, sure = add_miss(few), add_miss(sure)
    assert verdict(few, v) == "missed"
    assert verdict(sure, v) == ""
    for _ in range(4):
        sure = add_miss(sure)
    assert verdict(sure, v) == "missed"


def test_a_sighting_that_no_other_pairing_judges_says_nothing_about_moving():
    known = INITIALIZED
    for _ in range(30):
        known = add_observation(known, None, True)
    assert (known.seen, known.judged, known.squares) == (31, 0, 0.0)
    assert verdict(known, usual(0.9)) == ""


def test_sightings_from_one_place_are_one_look():
    assert add_observation(INITIALIZED, None, False).opportunities == 1
    assert add_observation(INITIALIZED, None, True).opportunities == 2
