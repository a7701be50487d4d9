"""The zoo of wrong estimators and ways of association: each is rejected; right ones and sound approximations pass."""

import re
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import block_diag

from data.se2 import compose
from ekf.filter import FilterDivergedError
from eval.checks import exactness, worlds
from eval.checks.estimators import without_noise
from eval.checks.exactness import Agreement, Bug, Deviation, Quantity, Stopped, sentence
from eval.replay.external.adapter import text_of
from eval.replay.settings import FILTERS, INCREMENTAL
from slamref import Expectation, Samples
from tests.eval.checks.plain import Plain, wrapped
from tests.oracle import reference_ekf


def mutant(**methods):
    return type("Mutant", (Plain,), methods)


def blocks(A):
    return A * np.kron(np.eye(len(A) // 2), np.ones((2, 2)))


def said(self, o, numbers, z_hat, joint, R=None, residual=None):
    R, residual = o.R if R is None else R, residual or self.sensor.residual
    return Expectation.from_arrays(o.z, z_hat, joint, R, residual, number=numbers)


def permuted(A):
    """The covariances between candidates belong to the neighbours; each candidate's own is right."""
    order = np.roll(np.arange(len(A)), 2)
    return A[np.ix_(order, order)] - blocks(A[np.ix_(order, order)]) + blocks(A)


def shifted(A):
    order = np.roll(np.arange(len(A)), 2)
    return A[np.ix_(order, order)]


def pinned(self, nu, S, R, rows):
    return float(nu @ np.linalg.pinv(S) @ nu)


def of_cross(share):
    return lambda self, *of: (share * (made := Plain.founded(self, *of))[0], made[1])


def gated(self, K, nu, H, R, S):
    each = [nu[i : i + 2] @ np.linalg.solve(S[i : i + 2, i : i + 2], nu[i : i + 2]) for i in range(0, len(nu), 2)]
    in_ = np.repeat(np.array(each) < 6.0, 2)
    H, R, S = H[in_], R[np.ix_(in_, in_)], S[np.ix_(in_, in_)]
    Plain.correct(self, self.gain(H, S), nu[in_], H, R, S)


def pose_alone(self, Gx, Gz, R):
    cross, own = Plain.founded(self, Gx, Gz, R)
    cross[:, 3:] = 0.0
    return cross, own


def fixed_and_corrected(self, z, R, start=1.0):
    self.x = np.append(self.x, self.sensor.inverse(self.x[:3], z[None])[0][0])
    self.P = block_diag(self.P, start * np.eye(2))
    Plain.update(self, type("Seen", (), {"z": z[None], "R": R[None]}), np.array([(len(self.x) - 5) // 2]))


def noise_alone(self, Gx, Gz, R):
    return Plain.founded(self, Gx, Gz, R)[0], Gz @ R @ Gz.T


def unturned(self, Gx, Gz, R):
    cross, own = Plain.founded(self, Gx, Gz, R)
    return cross, own - Gz @ R @ Gz.T + R


def single(self, K, H, R, S):
    """Single precision, and nothing keeps the matrix symmetric."""
    A = (np.eye(len(self.P)) - K @ H).astype(np.float32)
    return (A @ self.P.astype(np.float32)).astype(float)


def lower(self, K, H, R, S):
    """Only the lower triangle is updated."""
    return np.tril(Plain.shrunk(self, K, H, R, S)) + np.triu(self.P, 1)


def simplified_joseph(self, K, H, R, S):
    A = np.eye(len(self.P)) - K @ H
    return A @ self.P @ A.T


def one_by_one_from_the_same_prior(self, K, H, R, S):
    P = self.P.copy()
    for i in range(0, len(H), 2):
        h = H[i : i + 2]
        P -= self.P @ h.T @ np.linalg.solve(h @ self.P @ h.T + R[i : i + 2, i : i + 2], h @ self.P)
    return 0.5 * (P + P.T)


def body(self):
    c, s = np.cos(self.x[2]), np.sin(self.x[2])
    B = block_diag([[c, -s], [s, c]], 1.0)
    return self.x[:3].copy(), B.T @ self.P[:3, :3] @ B


def only_pose(self, K, nu):
    return np.append((K @ nu)[:3], np.zeros(len(K) - 3))


def stale_cross(self, K, H, R, S):
    P = Plain.shrunk(self, K, H, R, S)
    P[:3, 3:], P[3:, :3] = self.P[:3, 3:], self.P[3:, :3]
    return P


def before(self, o):
    """The expectation is formed at the pose of the frame before."""
    now, self.x = self.x, np.append(self.last, self.x[3:])
    e = Plain.expect(self, o)
    self.x = now
    return e


class OneDraw(Plain):
    samples = None

    def predict(self, increment):
        super().predict(increment)
        self.samples = compose(self.samples, 1.01 * increment.mean)

    def estimate(self):
        if self.samples is None:
            self.samples = np.random.default_rng(0).multivariate_normal(self.x[:3], self.P[:3, :3], 2000)
        return Samples(self.samples)


PAGE = (Path(__file__).parents[3] / "docs" / "extending.md").read_text(encoding="utf-8")
WEIGHED = 'log_weights -= 0.5 * np.einsum("ni,ij,nj->n", nu, np.linalg.inv(observations.R[i]), nu)'


def swarm(changes):
    """The particle filter of the page with changes."""
    code, found = PAGE.split("# particles.py\n")[1].split("```")[0], {}
    for old, new in changes.items():
        assert old in code
        code = code.replace(old, new)
    exec(code, found)
    return found["Particles"]


SWARMS = {
    "right": ({}, ()),
    "range-no-1/2": (
        {WEIGHED: "log_weights -= nu[:, 0] ** 2 / observations.R[i][0, 0]"},
        (Bug.FIRST_ALONE, Bug.R_HALVED),
    ),
    "variance": ({"(observations.R[i])": "(np.diag(np.diag(observations.R[i]) ** 2))"}, (Bug.R_SQUARED,)),
    "sum": (
        {
            "np.log(self.weights)": "-np.inf",
            WEIGHED: WEIGHED.replace("-= 0.5", "= np.logaddexp(log_weights, -0.5") + ")",
        },
        (Bug.LIKELIHOODS_ADDED, Bug.WEIGHTS_FORGOTTEN),
    ),
    "never-resampled": ({"< 0.5 *": "< 0.0 *"}, (Bug.NOT_RESAMPLED,)),
    "weights-kept": ({"np.full(len(rows), 1.0 / len(rows))": "self.weights[rows]"}, (Bug.WEIGHTS_KEPT,)),
    "variance-of-motion": ({"increment.covariance": "np.diag(np.diag(increment.covariance) ** 2)"}, (Bug.Q_SQUARED,)),
}
"""What makes the page's particle filter wrong, and the mistakes that are named."""


def few(s):
    drawn = np.random.default_rng(int(1e6 * abs(s.x[0]))).multivariate_normal(s.x[:3], s.P[:3, :3], 3)
    return Samples(np.repeat(drawn, 100, axis=0))


MUTANTS = {
    "no-R": (
        mutant(S=lambda s, HPH, R: HPH, gain=lambda s, H, S: s.P @ H.T @ np.linalg.pinv(S), nis=pinned),
        Bug.R_NONE,
    ),
    "R-doubled": (mutant(R=lambda s, R: 2 * R, R_new=lambda s, R: 2 * R), Bug.R_DOUBLED),
    "R-doubled-in-the-update": (mutant(R=lambda s, R: 2 * R), Bug.R_DOUBLED),
    "R-halved": (mutant(R=lambda s, R: R / 2, R_new=lambda s, R: R / 2), Bug.R_HALVED),
    "R-squared": (mutant(R=lambda s, R: R**2, R_new=lambda s, R: R**2), Bug.R_SQUARED),
    "R-is-sigma": (mutant(R=lambda s, R: np.sign(R) * np.abs(R) ** 0.5), Bug.R_ROOT),
    "R-of-the-first": (mutant(R=lambda s, R: np.repeat(R[:1], len(R), 0)), Bug.R_OF_THE_FIRST),
    "R-diagonal": (mutant(R=lambda s, R: R * np.eye(2), R_new=lambda s, R: R * np.eye(2)), Bug.R_DIAGONAL),
    "R-off-by-a-tenth": (mutant(R=lambda s, R: 1.1 * R), None),
    "no-Q": (mutant(Q=lambda s, M: 0 * M), Bug.Q_NONE),
    "Q-doubled": (mutant(Q=lambda s, M: 2 * M), Bug.Q_DOUBLED),
    "Q-halved": (mutant(Q=lambda s, M: M / 2), Bug.Q_HALVED),
    "Q-is-sigma": (mutant(Q=lambda s, M: np.sign(M) * np.abs(M) ** 0.5), Bug.Q_ROOT),
    "Q-squared": (mutant(Q=lambda s, M: M**2), Bug.Q_SQUARED),
    "Q-in-the-world-frame": (mutant(G=lambda s, c, n: np.eye(3)), Bug.Q_NOT_TURNED),
    "motion-in-the-world-frame": (
        mutant(moved=lambda s, c, n, u, v, w: (s.x[0] + u, s.x[1] + v, wrapped(s.x[2] + w))),
        Bug.MOTION_NOT_TURNED,
    ),
    "along-heading": (mutant(moved=lambda s, c, n, u, v, w: Plain.moved(s, c, n, u, 0, w)), Bug.MOTION_NOT_SIDEWAYS),
    "no-motion-Jacobian": (mutant(motion=lambda s, c, n, u, v: (np.eye(3), s.G(c, n))), Bug.MOTION_JACOBIAN_NONE),
    "motion-Jacobian-transposed": (
        mutant(motion=lambda s, c, n, u, v: (Plain.motion(s, c, n, u, v)[0].T, s.G(c, n))),
        None,
    ),
    "cross-covariance-not-predicted": (mutant(carried=lambda s, F, cross: cross), Bug.CROSS_NOT_PREDICTED),
    "stale-Jacobians": (mutant(at=lambda s: s.last), Bug.JACOBIAN_STALE),
    "Jacobian-without-heading": (mutant(Hx=lambda s, H: H * [1, 1, 0]), Bug.JACOBIAN_NO_HEADING),
    "Jacobian-sign-of-position": (mutant(Hx=lambda s, H: H * [[1, 1, 1], [-1, -1, 1]]), Bug.JACOBIAN_SIGN_OF_POSITION),
    "Jacobian-sign": (mutant(Hx=lambda s, H: H * [1, 1, -1]), Bug.JACOBIAN_SIGN_OF_HEADING),
    "Jacobian-without-landmark": (mutant(Hl=lambda s, H: 0 * H), Bug.JACOBIAN_NO_LANDMARK),
    "own-gate": (mutant(correct=gated, nis=lambda *_: np.nan), Bug.OWN_GATE),
    "no-wrap": (mutant(innovation=lambda s, z, z_hat: z - z_hat), Bug.INNOVATION_NOT_WRAPPED),
    "wrap-to-0-2pi": (
        mutant(innovation=lambda s, z, h: s.sensor.residual(z, h) % [1e9, 2 * np.pi] if s.sensor.kind == 0 else z - h),
        None,
    ),
    "stale-Jacobians-and-simplified-Joseph": (
        mutant(at=lambda s: s.last, shrunk=simplified_joseph),
        {Bug.JACOBIAN_STALE, Bug.JOSEPH_WITHOUT_NOISE},
    ),
    "S-in-blocks": (mutant(S=lambda s, HPH, R: blocks(HPH) + R), Bug.OBSERVATIONS_UNCORRELATED),
    "gain-with-a-stale-S": (mutant(gain=lambda s, H, S: 0.9 * Plain.gain(s, H, S)), None),
    "covariance-not-updated": (mutant(shrunk=lambda s, K, H, R, S: s.P), Bug.COVARIANCE_NOT_UPDATED),
    "Joseph-without-KRK": (mutant(shrunk=simplified_joseph), Bug.JOSEPH_WITHOUT_NOISE),
    "one-by-one-from-the-same-prior": (mutant(shrunk=one_by_one_from_the_same_prior), None),
    "single-precision": (mutant(shrunk=single), None),
    "not-symmetric": (mutant(shrunk=lower), None),
    "mean-not-updated": (mutant(step=lambda s, K, nu: 0 * K[:, 0]), Bug.MEAN_NOT_UPDATED),
    "map-not-corrected": (mutant(step=only_pose), Bug.MEAN_OF_MAP_NOT_UPDATED),
    "cross-covariance-not-updated": (mutant(shrunk=stale_cross), Bug.CROSS_NOT_UPDATED),
    "new-without-cross-covariance": (mutant(founded=of_cross(0.0)), Bug.NEW_WITHOUT_CROSS),
    "new-with-half-the-cross-covariance": (mutant(founded=of_cross(0.5)), Bug.NEW_HALF_CROSS),
    "new-without-cross-to-landmarks": (mutant(founded=pose_alone), Bug.NEW_CROSS_TO_POSE_ONLY),
    "new-without-R": (mutant(R_new=lambda s, R: 0 * R), Bug.NEW_WITHOUT_NOISE),
    "new-with-R-alone": (mutant(founded=noise_alone), Bug.NEW_WITHOUT_POSE),
    "new-with-R-unturned": (mutant(founded=unturned), Bug.NEW_NOISE_NOT_TURNED),
    "new-without-heading": (mutant(Gx=lambda s, G: G * [1, 1, 0]), Bug.NEW_NO_HEADING),
    "new-with-the-identity": (mutant(founded=lambda s, Gx, Gz, R: (0 * Gx @ s.P[:3], np.eye(2))), Bug.NEW_FIXED),
    "new-with-the-identity-then-corrected": (mutant(found=fixed_and_corrected), Bug.NEW_FIXED_CORRECTED),
    "new-too-sure-then-corrected": (mutant(found=lambda s, z, R: fixed_and_corrected(s, z, 0.3 * R)), None),
    "first-dropped": (mutant(chosen=lambda s, rows: rows[1:]), Bug.FIRST_DROPPED),
    "last-dropped": (mutant(chosen=lambda s, rows: rows[:-1]), Bug.LAST_DROPPED),
    "every-second-dropped": (mutant(chosen=lambda s, rows: rows[::2]), Bug.EVERY_SECOND_DROPPED),
    "at-most-three-used": (mutant(chosen=lambda s, rows: rows[:3]), None),
    "body-frame": (mutant(estimate=body), Bug.POSE_IN_BODY_FRAME),
    "covariance-too-small": (mutant(estimate=lambda s: (s.x[:3].copy(), 0.8 * s.P[:3, :3])), Bug.PRIOR_ELSEWHERE),
    "prior-of-its-own": (
        mutant(__init__=lambda s, p, *a: Plain.__init__(s, replace(p, mean=p.mean + 0.3), *a)),
        Bug.PRIOR_ELSEWHERE,
    ),
    "one-draw-for-all": (OneDraw, Bug.ONE_DRAW),
    "three-samples-a-hundred-times": (mutant(estimate=few), Bug.DEPLETED),
    "joint-uncorrelated": (mutant(said=lambda s, o, n, z, J: said(s, o, n, z, blocks(J))), Bug.JOINT_UNCORRELATED),
    "joint-permuted": (mutant(said=lambda s, o, n, z, J: said(s, o, n, z, permuted(J))), Bug.JOINT_PERMUTED),
    "candidates-permuted": (mutant(said=lambda s, o, n, z, J: said(s, o, n, z, shifted(J))), None),
    "R-added-twice": (
        mutant(said=lambda s, o, n, z, J: said(s, o, n, z, J + np.kron(np.eye(len(n)), o.R[0]))),
        Bug.EXPECTED_WITH_NOISE,
    ),
    "expectation-without-R": (mutant(said=lambda s, o, n, z, J: said(s, o, n, z, J, R=1e-6 * o.R)), None),
    "expectation-not-wrapped": (mutant(said=lambda s, o, n, z, J: said(s, o, n, z, J, residual=np.subtract)), None),
    "numbers-shifted": (mutant(said=lambda s, o, n, z, J: said(s, o, np.roll(n, 1), z, J)), None),
    "expected-before-the-motion": (mutant(expect=before), Bug.EXPECTED_BEFORE_MOTION),
    "NIS-is-dof": (mutant(nis=lambda s, nu, S, R, rows: 2.0 * len(rows)), Bug.NIS_IS_DOF),
    "NIS-without-R": (mutant(nis=lambda s, nu, S, R, rows: nu @ np.linalg.pinv(S - R) @ nu), Bug.NIS_WITHOUT_NOISE),
    "NIS-with-R-alone": (mutant(nis=lambda s, nu, S, R, rows: nu @ np.linalg.solve(R, nu)), Bug.NIS_WITHOUT_STATE),
    "NIS-per-dof": (mutant(nis=lambda s, nu, S, R, rows: Plain.nis(s, nu, S, R, rows) / len(nu)), None),
}
"""Name, class, and the mistake that is named; None: it has no name, and the first number that is off is said."""


class Jittered(Plain):
    """It adds what shall keep its covariance invertible: sound, not exact."""

    exact = False

    def shrunk(self, K, H, R, S):
        return super().shrunk(K, H, R, S) + 1e-9 * np.eye(len(self.P))


LOCALIZING = ("R-doubled", "stale-Jacobians", "no-wrap", "NIS-is-dof", "body-frame", "last-dropped")


def facts(estimator, task="slam"):
    text = estimator if isinstance(estimator, str) else text_of(estimator, "estimator")
    exact = getattr(estimator, "exact", text not in INCREMENTAL)
    linear = exactness.compared(text, task, worlds.LINEAR, exact=True) if exact else []
    shown = any(not isinstance(f, Agreement) for f in linear)
    return linear if shown else [*linear, *exactness.compared(text, task, worlds.MILD, exact=exact)]


@pytest.mark.parametrize(("name", "task"), [*product(MUTANTS, ["slam"]), *product(LOCALIZING, ["localization"])])
def test_a_wrong_estimator_is_rejected_and_its_mistake_named(name, task):
    mutant, bug = MUTANTS[name]
    wrong = [f for f in facts(mutant, task) if not isinstance(f, Agreement)]
    assert wrong
    assert all(set(f.bugs) == ({bug} if isinstance(bug, Bug) else bug or set()) for f in wrong)
    assert all(bug is None or "Likely: " in sentence(f) for f in wrong)


@pytest.mark.parametrize("name", SWARMS)
def test_draws_and_weights_of_samples_tell_their_mistakes(name):
    changes, bugs = SWARMS[name]
    for found in exactness.exactness(text_of(swarm(changes), "estimator"), "localization"):
        assert {getattr(f, "bugs", ()) for f in found.facts} == {bugs}


def test_bearings_not_wrapped_are_named_of_pairings_used_one_by_one_and_whatever_comes_later():
    class Later(Plain):
        exact = False

        def update(self, o, decisions):
            for i in np.flatnonzero(decisions >= 0):
                super().update(type("Seen", (), {"z": o.z[i : i + 1], "R": o.R[i : i + 1]}), decisions[i : i + 1])

        def innovation(self, z, z_hat):
            a = self.x[2]
            return z - z_hat if self.sensor.kind else z - [z_hat[0, 0], wrapped(z_hat[0, 1] + a) - a]

        Q = lambda self, M: 3.3 * M  # noqa: E731

    class Averaged(Plain):
        exact = False

        def innovation(self, z, z_hat):
            points = wrapped(z_hat[:, 1:] + [0.002, 0.0, -0.002]).mean(axis=1)  # of sigma points
            return super().innovation(z, np.column_stack([z_hat[:, 0], points]))

    for estimator, bug in ((Later, Bug.INNOVATION_NOT_WRAPPED), (Averaged, Bug.ACROSS_PI)):
        (found,) = exactness.exactness(text_of(estimator, "estimator"), "localization")
        assert {f.bugs for f in found.facts} == {(bug,)}


def test_a_motion_that_divides_by_its_turn_stops_in_a_step_without_one():
    arcs = mutant(moved=lambda s, c, n, u, v, w: Plain.moved(s, c, n, u, v, w) if w else np.full(3, np.nan))
    for thing, passes in ((arcs, False), (Plain, True)):
        assert [f.passed for f in without_noise(text_of(thing, "estimator"), "slam")] == [passes]


def test_a_mistake_is_one_sentence_that_names_what_follows_from_it():
    mutant, _ = MUTANTS["R-doubled"]
    for found in exactness.exactness(text_of(mutant, "estimator"), "slam"):
        assert not found.passed
        assert len(found.facts) > 3
        assert found.sentence.count("Likely: ") == found.sentence.count(" off by up to ") == 1
        assert "; so are " in found.sentence


def test_what_is_off_before_any_pairing_is_put_down_to_new_landmarks_and_not_to_a_sensor_of_its_own():
    found = next(exactness.exactness(text_of(MUTANTS["new-too-sure-then-corrected"][0], "estimator"), "slam"))
    assert re.search("pose covariance off.* new landmarks alone", found.sentence)
    assert "of your own" not in found.sentence


def test_a_mistake_explains_nothing_that_began_before():
    first = Deviation("mild", Quantity.POSE, 0, True, True, 9.0, 0.05, (), True)
    then = replace(first, quantity=Quantity.COVARIANCE, frame=1, first=False, bugs=(Bug.Q_NONE,))
    assert re.search("Off before anything else: .*pose covariance .*Likely: ", exactness.sentences([first, then]))


@pytest.mark.parametrize("task", ["localization", "slam"])
@pytest.mark.parametrize("estimator", [Plain, *FILTERS])
def test_what_claims_to_be_exact_is(estimator, task):
    linear, mild = facts(estimator, task)
    assert {type(linear), type(mild)} == {Agreement}
    assert (linear.world, linear.allowed, mild.world, linear.frames) == ("linear", exactness.EXACTLY, "mild", 14)
    assert set(linear.quantities) >= set(Quantity) - {
        Quantity.LANDMARKS,
        Quantity.LANDMARK_COVARIANCE,
        Quantity.SAMPLES,
    }


@pytest.mark.parametrize(
    ("estimator", "task"), [(Jittered, "localization"), (Jittered, "slam"), *((n, "slam") for n in INCREMENTAL)]
)
def test_a_sound_approximation_is_accepted(estimator, task):
    (mild,) = facts(estimator, task)
    assert isinstance(mild, Agreement)
    assert (mild.world, mild.allowed) == (worlds.MILD, exactness.NEARLY)


def test_an_approximation_that_claims_to_be_exact_is_told_how_to_declare_it():
    class Claiming(Jittered):
        exact = True

    linear = [f for f in facts(Claiming) if isinstance(f, Deviation)]
    assert {f.world for f in linear} == {worlds.LINEAR}
    assert any("declares `exact = False`" in sentence(f) for f in linear)


def test_what_cannot_begin_or_diverges_is_a_line_and_no_traceback():
    def raising(error):
        def method(*_):
            raise error

        return method

    never = mutant(landmarks=raising(OSError("no map")))
    diverging = mutant(update=raising(FilterDivergedError("infinite")))

    class NoResidual(Plain):
        def said(self, o, numbers, z_hat, joint):
            return replace(super().said(o, numbers, z_hat, joint), residual=None)

    for kind, why in ((never, "OSError: no map"), (diverging, "infinite"), (NoResidual, "TypeError")):
        (stopped,) = facts(kind)
        assert (stopped.frame, stopped.bugs) == (0, ())
        assert why in stopped.why


@pytest.mark.parametrize("exact", [True, False])
def test_a_landmark_that_waits_is_an_error_only_of_what_claims_to_be_exact(exact):
    class Waiting(Plain):
        def update(self, o, decisions):
            kept = np.where(decisions == -1, -2, decisions) if len(self.x) > 12 else decisions
            return super().update(o, kept) | {"created": np.where(kept == -1, self.numbers(kept), -1)}

        def numbers(self, decisions):
            return (len(self.x) - 3) // 2 - (decisions == -1).sum() + np.cumsum(decisions == -1) - 1

    Waiting.exact = exact
    (only,) = facts(Waiting)
    assert isinstance(only, Stopped if exact else Agreement)
    assert not exact or "NEW observations initialize no landmark" in only.why


def test_an_approximation_of_which_no_pairing_was_compared_has_not_passed():
    class Never(Jittered):
        def update(self, o, decisions):
            return super().update(o, np.full(len(decisions), -2)) | {"created": np.full(len(decisions), -1)}

    assert "in frame 0: 3 NEW observations initialize no landmark, so nothing could be" in sentence(*facts(Never))


def test_a_gate_of_its_own_is_named():
    class Gated(Jittered):
        def update(self, o, decisions):
            kept = np.where(np.cumsum(decisions >= 0) > 3, -2, decisions)
            return super().update(o, kept) | {"used": kept >= 0}

    assert "leaves out pairings that it is given (a gate of its own?)" in sentence(facts(Gated, "localization")[0])


@pytest.mark.parametrize("world", [worlds.LINEAR, worlds.MILD])
@pytest.mark.parametrize("task", ["localization", "slam"])
def test_the_exact_filter_is_that_of_the_textbook(world, task):
    """`tests.oracle.reference_ekf` shares no code with it."""
    inputs = exactness.inputs_of(world, task)
    frames, states = exactness.exact_states(world, task)
    o, kind = inputs.observations, inputs.sensor.kind
    known = None if inputs.map is None else {int(i): xy for i, xy in zip(inputs.map.id, inputs.map.xy)}
    path, P, nis, x, full = reference_ekf.run(
        kind, np.zeros(3), inputs.prior.mean, inputs.prior.covariance, inputs.increments.mean,
        inputs.increments.covariance, o.frame, o.z, o.R, np.concatenate([d for _, d in frames]), known,
    )  # fmt: skip
    np.testing.assert_allclose([s.pose for s in states], path, atol=1e-6)
    sigma = np.sqrt(np.einsum("nii->ni", P))
    off = (np.array([s.covariance for s in states]) - P) / (sigma[:, :, None] * sigma[:, None, :])
    assert np.abs(off).max() < 1e-5
    np.testing.assert_allclose([0.0 if np.isnan(s.nis) else s.nis for s in states], nis, rtol=1e-4, atol=1e-9)
    if known is None:
        np.testing.assert_allclose(states[-1].xy.ravel(), x[3:], atol=1e-5)
        np.testing.assert_allclose(states[-1].blocks[0], full[3:5, 3:5], rtol=1e-4)
