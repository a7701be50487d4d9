"""The simulated line: how long bytes take, and what is lost, spoiled and held up."""

from __future__ import annotations

import numpy as np
import pytest

from wings.robot.packets import BYTE_TIME, Command, encode_command
from wings.robot.simulated import wire as wires
from wings.robot.simulated.physics import Robot
from wings.robot.simulated.room import room
from wings.robot.simulated.wire import Faults, Wire

AHEAD, REST = encode_command(Command(300, 0)), encode_command(Command(0, 0))


def lined(faults, seed=0):
    body, line = np.random.default_rng(seed).spawn(2)
    return Wire(Robot(room(0), body), faults, line, keep=True)


def test_a_byte_takes_ten_bits_so_an_answer_ends_26_bytes_after_its_command_began():
    wire = lined(Faults())
    wire.write(1.0, AHEAD)
    end = 1.0 + 26 * BYTE_TIME
    assert wire.read(end - 0.5 * BYTE_TIME) == wire.sent[0][0][:-1]
    assert wire.due() == pytest.approx(end)
    assert wire.read(end + 1e-9) == wire.sent[0][0][-1:]


def test_bytes_are_dropped_and_single_bits_turn_over_as_often_as_is_said():
    wire = lined(Faults(drop=0.1))
    for k in range(400):
        wire.write(0.1 * k, REST)
    came = len(wire.read(50.0))
    assert came == pytest.approx(0.9 * 22 * len(wire.sent), rel=0.02)
    assert len(wire.sent) == pytest.approx(0.9**4 * 400, rel=0.1)
    wire = lined(Faults(flip=0.1))
    for k in range(400):
        wire.write(0.1 * k, REST)
    came = wire.read(50.0)
    said = b"".join(data for data, _ in wire.sent)
    changed = [(a ^ b).bit_count() for a, b in zip(said, came)]
    assert set(changed) == {0, 1}
    assert np.mean(changed) == pytest.approx(0.1, abs=0.01)
    spoiled = [any(changed[22 * i : 22 * (i + 1)]) for i in range(400)]
    assert [not unharmed for _, unharmed in wire.sent] == spoiled


def test_a_stall_makes_answers_late_loses_commands_and_lets_the_robot_stop(monkeypatch):
    monkeypatch.setattr(wires, "BETWEEN_STALLS", 500)
    late, lost = 0, 0
    for seed in range(20):
        wire = lined(Faults(stall=3.0), seed)
        for k in range(12):
            wire.write(0.25 * k, AHEAD)
        last = 0.25 * 11
        on_time = wire.read(last + 26 * BYTE_TIME + 1e-9)
        wire.advance(last + 1.05)
        at = wire.robot.pose.copy()
        after = wire.read(last + 30.0)
        np.testing.assert_array_equal(wire.robot.pose, at)
        assert on_time + after == b"".join(data for data, _ in wire.sent)
        late += bool(after)
        lost += len(wire.sent) < 12
    assert late > 3
    assert lost > 1
