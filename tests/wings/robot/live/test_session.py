"""On line an estimator gets the frames, and makes the estimates, of a replay, to the bit."""

from __future__ import annotations

import numpy as np
import pytest

from data.errors import UsageError
from ekf.filter import FilterDivergedError
from eval.replay.settings import Setup
from tests.quick import slow
from tests.wings.robot.live.driven import estimate_bits, online, packets, replayed, replayed_bits
from wings.robot.live.session import Session


@pytest.mark.parametrize(("name", "association", "setup"), [
    slow("ekf", "jcbb", Setup()),
    ("ekf-iterated", "nn", Setup(gate=0.95, maintain=True)),
    slow("ekf", "jcbb", Setup(deactivate_after=5.0)),
])  # fmt: skip
@pytest.mark.slow
def test_estimates_decisions_and_new_walls_are_those_of_the_replay(tmp_path, name, association, setup):
    taken, session = online(tmp_path / "log", 40.0, (name,), association, setup)
    run = replayed(tmp_path / "log", name, association, setup)
    steps = [t.steps[0] for t in taken]
    assert [estimate_bits(s.mean, s.covariance) for s in steps] == replayed_bits(run)
    assert np.array_equal(np.concatenate([s.decisions for s in steps]), run.decisions)
    assert np.array_equal(np.concatenate([s.created for s in steps]), run.created)
    assert session.frames == len(run.trajectory("online").pose) > 130
    assert run.created.max() > 1


def test_all_estimators_get_the_same_frames_and_one_that_fails_ends_alone(monkeypatch):
    names = ("ekf", "ekf-iterated")
    session, alone = Session(names, "jcbb", Setup()), Session(names[1:], "jcbb", Setup())
    broken = session.estimating[0].front
    whole = broken.move

    def move(frame):
        if frame.number == 30:
            raise FilterDivergedError("astray")
        whole(frame)

    monkeypatch.setattr(broken, "move", move)
    for packet in packets(15.0):
        first, second = session.take(packet).steps
        other = alone.take(packet).steps[0]
        assert estimate_bits(second.mean, second.covariance) == estimate_bits(other.mean, other.covariance)
        assert (first is None) == (session.frames > 30)
    assert session.estimating[0].failure == "at frame 30: astray"
    assert session.estimating[0].map() is None
    assert not session.estimating[1].failure


def test_somebody_elses_estimator_that_cannot_do_it_is_one_line(tmp_path):
    (tmp_path / "mine.py").write_text("class Filter:\n    pass\n")
    with pytest.raises(UsageError, match="Filter: no method 'predict'"):
        Session((f"Filter={tmp_path}/mine.py:Filter",), "jcbb", Setup())
