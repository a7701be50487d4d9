"""The link on a simulated line without a clock: a command a period, every fault counted by name, nothing raised."""

from collections import Counter
from itertools import pairwise

import numpy as np
import pytest

from data.errors import UsageError
from tests.quick import slow
from tests.wings.robot.line import KeepingWire, StandingClock, WirePort, linked, wander
from wings.robot import simulated
from wings.robot.link import Link
from wings.robot.packets import (
    BYTE_TIME,
    FASTEST,
    LONGEST_RANGE,
    PERIOD,
    Command,
    command_of,
    decode_answer,
    encode_command,
)
from wings.robot.simulated import Faults, Robot, room
from wings.robot.traffic import GONE, OPENED, RECEIVED, SENT, Exchange, Record

AHEAD = command_of(0.3, 0.0)


def driven(faults, seconds, seed=0, *, framed=False):
    link, wire, clock = linked(faults, seed, framed=framed)
    rng, packets = np.random.default_rng(seed), []
    while clock.now() < seconds:
        packets += link.step(command_of(*wander(packets[-1] if packets else None, rng)))
    return link, wire, packets


def of_intact(wire, packets, *, framed):
    """Share of the answers that came through whole which were used, and how many that did not were."""
    content = slice(2, -2) if framed else slice(None)
    whole = Counter(decode_answer(data[content]) for data, unharmed in wire.sent if unharmed)
    used = Counter(p.answer for p in packets)
    said = {decode_answer(data[content]) for data, _ in wire.sent}
    return 1.0 - (whole - used).total() / whole.total(), sum(p.answer not in said for p in packets)


def nothing_impossible(packets):
    for p in packets:
        assert (p.ranges >= 0.0).all()
        assert not ((p.ranges > LONGEST_RANGE) & np.isfinite(p.ranges)).any()
    for before, after in pairwise(packets):
        assert after.t > before.t
        step = np.linalg.norm(after.odometry[:2] - before.odometry[:2])
        assert step <= FASTEST * (max(after.t - before.t, PERIOD) + 0.1 + 1.0) + 0.003


def sending(link, clock):
    times, keep = [], link._keep
    link._keep = lambda kind, data=b"": (times.append(clock.now()) if kind == SENT else None) or keep(kind, data)
    return times


def test_commands_go_out_a_period_apart_whatever_comes_back():
    link, wire, clock = linked(Faults(drop=0.3))
    times = sending(link, clock)
    for _ in range(40):
        link.step(AHEAD)
        if wire.sent:  # the last answer once more, in the middle of the period
            wire._from_robot.extend((clock.now() + 0.1, byte) for byte in wire.sent[-1][0])
    assert np.diff(times) == pytest.approx(PERIOD, abs=1e-6)
    assert link.exchange.faults["late"] > 0


@pytest.mark.parametrize("framed", [False, True])
@pytest.mark.parametrize(("seconds", "seed"), [(40.0, 0), *(slow(600.0, seed) for seed in range(5))])
def test_of_a_bad_line_99_percent_of_whole_answers_are_used_and_nothing_impossible(seconds, seed, framed):
    """What is used of the others has a bit turned over that is not to be seen: 2.2 % of answers have one."""
    link, wire, packets = driven(Faults(drop=0.01, flip=0.001), seconds, seed, framed=framed)
    share, false = of_intact(wire, packets, framed=framed)
    assert share >= 0.99
    assert false <= (0 if framed else max(6, 0.022 * len(packets)))
    assert sum(not p.joined for p in packets) == 1
    nothing_impossible(packets)
    assert link.exchange.faults["short"] > 10


def records(*events):
    return [Record(SENT if data is None else RECEIVED, t, b"" if data is None else data) for t, data in events]


def test_an_answer_that_does_not_come_is_lost_and_one_that_comes_after_its_time_is_used_and_late():
    _, wire, _ = driven(Faults(), 3.0)
    said = [data for data, _ in wire.sent]
    exchange = Exchange(framed=False)
    begun = records((0.0, None), (0.03, said[0]), (0.25, None), (0.28, said[1]), (0.5, None), (0.75, None), (1.0, None))
    for record in begun:
        exchange.consume(record)
    assert exchange.faults["lost"] == 2
    late = exchange.consume(Record(RECEIVED, 1.03, said[2] + said[3] + said[4]))
    assert [p.answer for p in late] == [decode_answer(said[4])]  # the newest of those that came at once
    assert {k: n for k, n in exchange.faults.items() if n} == {"late": 2}
    exchange = Exchange(framed=False)
    for record in records((0.0, None), (0.03, said[0]), (0.25, None), (0.28, said[1]), (0.5, None)):
        exchange.consume(record)
    assert len(exchange.consume(Record(RECEIVED, 0.78, said[2]))) == 1
    assert exchange.faults["late"] == 1


def test_a_device_that_goes_is_opened_again_and_what_is_missing_is_no_exception():
    link, wire, clock = linked()
    for _ in range(8):
        link.step(AHEAD)
    link._port.gone = True
    absent = [True] * 6

    def reopened(_):
        if absent and absent.pop():
            raise OSError(2, "No such file or directory")
        return WirePort(wire, clock)

    link._open_port = reopened
    began = clock.now()
    packets = [link.step(AHEAD) for _ in range(16)]
    assert clock.now() - began == pytest.approx(16 * PERIOD, abs=PERIOD)
    assert [bool(p) for p in packets] == [False] * 6 + [True] * 10
    assert link.exchange.faults["device gone"] == 1
    assert all(p.joined for step in packets for p in step)


def test_while_the_device_is_gone_each_step_still_takes_its_period_and_tries_once_to_open_it():
    kept = []
    link, wire, clock = linked(recording=kept)
    for _ in range(4):
        link.step(AHEAD)
    lost = link._port
    lost.gone, lost.close = True, lambda: let_go.append(lost)
    tried, let_go = [], []

    def reopened(device):
        tried.append(clock.now())
        if len(tried) <= 5:
            raise OSError(2, "No such file or directory")
        assert device == "robot"
        return WirePort(wire, clock)

    link._open_port = reopened
    began, ends = clock.now(), []
    for _ in range(8):
        link.step(AHEAD)
        ends.append(clock.now())
    # an answer is awaited only where a device is open: without one a step lasts to the end of its period
    assert PERIOD <= (ends[0] - began) < 2.0 * PERIOD
    assert np.diff(ends[:5]) == pytest.approx(PERIOD, abs=1e-9)
    assert len(tried) == 6
    assert np.diff(tried) == pytest.approx(PERIOD, abs=1e-9)
    assert let_go == [lost]
    of_the_device = [r for r in kept if r.kind in (OPENED, GONE)]
    assert [r.kind for r in of_the_device] == [OPENED, GONE, OPENED]
    assert [r.t for r in of_the_device[1:]] == pytest.approx([began, tried[-1]], abs=1e-4)


def test_a_device_that_is_not_there_at_the_start_is_said_in_one_line(tmp_path):
    (tmp_path / "file").touch()
    for name in ("nowhere", "file"):
        with pytest.raises(UsageError, match=f"{name}: cannot be opened as a serial line: .+"):
            Link(str(tmp_path / name), StandingClock())


@pytest.mark.parametrize("framed", [False, True])
@pytest.mark.parametrize("faults", [Faults(stall=5.0), Faults(0.1, 0.1, 3.0)])
def test_in_every_fault_the_robot_stands_a_second_after_the_last_command(faults, framed):
    for seed in range(3):
        link, wire, clock = linked(faults, seed, framed=framed)
        for _ in range(6):
            link.step(command_of(0.3, 0.8))
        wire.write(clock.now(), b"\x2c\x01")  # the beginning of a command
        last = clock.now()
        wire.advance(last + 1.05)
        at = wire.robot.pose.copy()
        wire.advance(last + 20.0)
        np.testing.assert_array_equal(wire.robot.pose, at)


COMMAND, REST = encode_command(Command(300, 0)), encode_command(Command(0, 0))


def lined(faults, seed=0):
    body, line = np.random.default_rng(seed).spawn(2)
    return KeepingWire(Robot(room(0), body), faults, line)


def test_a_byte_takes_ten_bits_so_an_answer_ends_26_bytes_after_its_command_began():
    wire = lined(Faults())
    wire.write(1.0, COMMAND)
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
    monkeypatch.setattr(simulated, "BETWEEN_STALLS", 500)
    late, lost = 0, 0
    for seed in range(20):
        wire = lined(Faults(stall=3.0), seed)
        for k in range(12):
            wire.write(0.25 * k, COMMAND)
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
