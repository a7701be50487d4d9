"""What a frame that is placed by geometry is told of the run so far, and what is kept of it."""

from types import SimpleNamespace

import numpy as np
import pytest

from data.inputs import Increment
from data.notice import Code, notice
from eval.replay.hindsight import mapper as module
from eval.replay.hindsight.mapper import UncertainMotion
from eval.replay.settings import Setup

STEP = Increment(np.zeros(3), np.diag([0.04, 0.01, 0.001]))
E = SimpleNamespace(elsewhere=object(), number=np.array([3, 5]))


class Placing:
    """`place` and what it was asked; it finds what it is told to."""

    def __init__(self, monkeypatch):
        self.asked, self.found, self.uncertain = [], None, True
        monkeypatch.setattr(module, "place", self.place)
        monkeypatch.setattr(module, "too_uncertain", lambda e, sensor, motion: self.uncertain)
        ledger = SimpleNamespace(sensor="sensor", frames=4, rates=lambda numbers: numbers / 10.0)
        self.motion = UncertainMotion(ledger, Setup(gate=0.9, new_gate=0.95))

    def place(self, e, sensor, predicted, motion, memory, gate, new_gate):
        self.asked.append((motion.copy(), [p.tolist() for p in memory[0]], memory[1].tolist(), memory[2]))
        assert (e, sensor, gate, new_gate) == (E, "sensor", 0.9, 0.95)
        return self.found

    def frame(self, *decisions, sudden=0):
        self.found = SimpleNamespace(decisions=np.array(decisions), sudden=sudden) if decisions else None
        return self.motion.place(E, np.zeros(3))


@pytest.fixture
def placing(monkeypatch):
    return Placing(monkeypatch)


def test_where_the_prediction_is_good_enough_or_nothing_can_be_linearized_elsewhere_no_frame_is_placed(placing):
    assert placing.motion.place(SimpleNamespace(elsewhere=None), np.zeros(3)) is None
    placing.uncertain = False
    assert placing.frame(1) is None
    assert (placing.asked, placing.motion.placed) == ([], 0)


def test_motion_adds_up_until_a_frame_is_paired(placing):
    for k, paired in enumerate((False, False, True, False)):
        placing.motion.move(STEP)
        placing.motion.see(np.full(3, float(k)), paired)
        placing.frame()
    motions = [motion for motion, *_ in placing.asked]
    # the first frame is where the map begins, paired or not
    for motion, steps in zip(motions, (0, 1, 0, 1), strict=True):
        assert motion == pytest.approx(steps * STEP.covariance)


def test_it_knows_from_where_was_seen_how_often_each_landmark_is_and_how_much_is_stray(placing):
    placing.motion.see(np.array([1.0, 2.0, 3.0]), True)
    placing.frame(4, -1, 0, sudden=2)
    placing.frame(7)
    placing.frame()
    assert [seen for _, seen, _, _ in placing.asked] == [[[1.0, 2.0, 3.0]]] * 3
    assert [rates for _, _, rates, _ in placing.asked] == [[0.3, 0.5]] * 3
    # of a uniform prior; then 2 were paired, 2 not; then one more
    assert [strays for *_, strays in placing.asked] == pytest.approx([1 / 2, 3 / 6, 3 / 7])
    assert placing.motion.placed == 2


@pytest.mark.parametrize(("placed", "hangs"), [(1, False), (2, False), (3, True)])
def test_it_is_said_how_many_frames_were_placed_and_whether_the_path_hangs_on_it(placing, placed, hangs):
    assert placing.motion.notes() == []
    for _ in range(placed):
        placing.frame(1)
    assert placing.motion.notes() == [notice(Code.PLACED, frames=placed, mostly=hangs)]
