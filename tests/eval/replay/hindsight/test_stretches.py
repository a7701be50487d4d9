"""A smoother begun anew: what was seen before that stays as it was."""

from __future__ import annotations

import numpy as np

from association.known import known_decisions
from data.inputs import Sightings
from data.result import DISCARD
from eval.replay.hindsight.stretches import Stretches
from graph.incremental import Isam2Smoother
from tests.graph.worlds import SENSORS, circle

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
            s.update(inputs.sightings(k), decisions[rows])
        if k == AT:
            s.reset(s.estimate().mean + 0.01, 0.01 * np.eye(3))
    if amended is not None:
        rows = np.flatnonzero(np.isin(o.frame, amended))
        s.amend(o.frame[rows], Sightings(o.z[rows], o.R[rows]), late[rows])
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
        without = np.where(seen == frame, DISCARD, decisions)
        expected = run(inputs, without)
        assert np.abs(run(inputs, decisions, [3, AT, frame], none) - expected).max() < 1e-6
        assert np.abs(plain - expected).max() > 1e-3


def test_the_smoother_begun_anew_knows_what_time_it_is():
    class Clock:
        def __init__(self, prior):
            self.times = []
            clocks.append(self)

        def stamp(self, time):
            self.times.append(time)

    clocks: list[Clock] = []
    s = Stretches(Clock, circle(SENSORS["range-bearing"], frames=4, landmarks=4, see=1.0)[0].prior)
    s.stamp(2.5)
    s.reset(np.zeros(3), np.eye(3))
    s.stamp(3.0)
    assert [clock.times for clock in clocks] == [[2.5], [2.5, 3.0]]
