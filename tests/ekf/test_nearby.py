"""A parked landmark that a reading could be paired with is always found; the filter that never parks knows which."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import event, given, settings
from hypothesis import strategies as st

from data import se2
from data.inputs import FrameObservations, Increment, Prior
from data.result import NEW
from data.sensors import Line, RangeBearing, RelativePoint
from ekf.slam import EkfSlam
from tests.quick import examples

SENSORS = [
    RangeBearing(),
    RangeBearing(rotation=0.3, translation=(0.4, -0.2)),
    RelativePoint(translation=(0.5, 0.0)),
    Line(translation=(0.3, 0.1)),
]


@settings(max_examples=examples(20), deadline=None)
@given(
    seed=st.integers(0, 10**6),
    sensor=st.sampled_from(SENSORS),
    within=st.sampled_from([1.0, 9.2, 23.0]),
    drift=st.sampled_from([0.02, 0.2]),
)
def test_no_parked_landmark_inside_the_gate_is_missed(seed, sensor, within, drift):
    rng = np.random.default_rng(seed)
    prior = Prior(np.array([1.0, -2.0, 3.0]), np.diag([0.04, 0.01, 0.002]))
    places = rng.uniform(-25, 25, (150, 2))
    truth = prior.mean.copy()
    f, full = EkfSlam(prior, sensor), EkfSlam(prior, sensor)
    number = {}
    inside = found_in_all = asked = 0
    for k in range(45):
        u = np.array([1.0, 0.0, 0.15])
        L = rng.normal(size=(3, 3)) * drift * np.array([[1.0], [1.0], [0.1]])
        P = L @ L.T + 1e-8 * np.eye(3)
        truth = se2.compose(truth, u + np.linalg.cholesky(P) @ rng.normal(size=3))
        for g in (f, full):
            g.predict(Increment(u, P))
        seen = np.argsort(np.hypot(*(places - truth[:2]).T))[: 4 if k else 8]
        z = sensor.predict(truth, places[seen]) + rng.normal(size=(len(seen), 2)) * [0.05, 0.02]
        observations = FrameObservations(z, np.tile(np.diag([0.0025, 0.0004]), (len(seen), 1, 1)))
        parked = f.parked
        near = f.parked_within(observations, within)
        if len(parked):
            e = full.expect(observations)
            d2 = e.individual_distances()[:, np.isin(e.number, parked)].min(axis=0)
            must = parked[d2 <= within]
            assert np.isin(must, near).all(), f"missed {np.setdiff1d(must, near)}"
            inside, asked, found_in_all = inside + len(must), asked + len(parked), found_in_all + len(near)
        decisions = np.array([number.get(p, NEW) for p in seen.tolist()])
        f.restore(np.intersect1d(decisions, f.parked))
        done = f.update(observations, decisions)
        full.update(observations, decisions)
        number.update((int(p), int(n)) for p, n in zip(seen, done.created) if n >= 0)
        if rng.random() < 0.3:
            f.park(f.active[rng.random(len(f.active)) < 0.8])
    event(f"{'some' if inside else 'no'} parked landmark was inside the gate")
    event(f"{'less' if found_in_all < 0.5 * asked else 'more'} than half were taken for near")


@pytest.mark.parametrize(("within", "near"), [(4.0, [1]), (9.5, [1, 2]), (25.5, [1, 2, 3]), (np.inf, [1, 2, 3, 4])])
def test_of_what_was_parked_just_now_those_inside_the_gate_are_near(within, near):
    """Landmarks at 0, 3, 5 and 40 standard deviations of the difference from a reading."""
    f = EkfSlam(Prior(np.zeros(3), 1e-12 * np.eye(3)), RelativePoint())
    R = 0.02 * np.eye(2)  # of the landmark and of the reading: a variance of 0.04
    places = np.array(
        [[9.0, 9.0], [5.0, 0.0], [5.0, 0.6], [4.0, 0.0], [5.0, -8.0], *[[-9.0, 1.0 + k] for k in range(9)]]
    )
    f.update(FrameObservations(places, np.tile(R, (len(places), 1, 1))), np.full(len(places), NEW))
    f.park(np.arange(1, 5))
    far = np.array([[-20.0, 0.0], [5.0, 0.0]])
    assert sorted(f.parked_within(FrameObservations(far, np.tile(R, (2, 1, 1))), within).tolist()) == near
    nothing = FrameObservations(np.empty((0, 2)), np.empty((0, 2, 2)))
    assert f.parked_within(nothing, within).tolist() == []
