"""What a drive costs: time from packet to estimate with a hundred walls, and memory that does not grow."""

import math
import time

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from data.inputs import Frame, FrameObservations
from eval.replay.settings import Setup
from tests.wings.robot.live.driven import FORK, packets
from tests.wings.robot.live.soak import soak
from wings.robot.live.session import Session
from wings.robot.packets import encode_answer
from wings.robot.traffic import RECEIVED, SENT, Exchange, Record, Recording

WALLS = 100
INVERSES = 4.0
"""Of a matrix of the length of the state (203): what a packet takes at most. One, measured, 1.2 ms both."""


def with_walls(name, association):
    """A session with as many walls in the map: 25 directions, 4 distances each, beyond the room's own."""
    session = Session((name,), association, Setup())
    alpha = np.repeat(np.linspace(-math.pi, math.pi, WALLS // 4, endpoint=False), 4)
    z = np.column_stack([np.tile([12.0, 14.0, 16.0, 18.0], WALLS // 4), alpha])
    first = Frame(0, -1.0, None, FrameObservations(z, np.tile(np.diag([1e-4, 1e-4]), (WALLS, 1, 1))), None, 0)
    session.estimating[0].take(first)
    return session


def times(session, folder, seconds):
    """CPU time [s] from each packet's bytes to the estimates, and of an inverse after it; all but the first two."""
    exchange, taken, answered = Exchange(framed=False), [], 0
    matrix = np.eye(3 + 2 * WALLS) + 1.0
    with Recording(folder) as recording, threadpool_limits(1):
        for packet in packets(seconds):
            sent = Record(SENT, packet.t + 0.001)
            recording.append(sent)
            exchange.consume(sent)
            received = Record(RECEIVED, packet.t + 0.03, encode_answer(packet.answer))
            begin = time.thread_time()
            recording.append(received)
            came = exchange.consume(received)
            for each in came:
                session.take(each)
            between = time.thread_time()
            np.linalg.inv(matrix)
            taken.append((between - begin, time.thread_time() - between))
            answered += len(came)
    assert answered == len(taken)
    return np.array(taken[2:])


@pytest.mark.parametrize("association", ["jcbb", pytest.param("nn", marks=pytest.mark.slow)])
def test_a_packet_costs_no_more_than_a_few_inverses_of_the_covariance(tmp_path, association):
    session = with_walls("ekf", association)
    spent = times(session, tmp_path / "log", 40.0)
    assert len(session.estimating[0].map().number) > WALLS
    assert session.observations > 15
    packet, inverse = spent.sum(axis=0)
    assert packet < INVERSES * inverse, f"median {np.median(spent, axis=0)} s, longest {spent.max(axis=0)} s"


FLAT = 5.0
"""MB that memory may differ from that after the first minute."""


def measured(name, seconds):
    """Rows of time [s] and memory [MB] of a process that does nothing else."""
    receiver, sender = FORK.Pipe(duplex=False)
    process = FORK.Process(target=lambda: sender.send(soak(name, seconds, 30.0)))
    process.start()
    sender.close()
    rows = receiver.recv()
    process.join()
    return rows


def check(name, seconds):
    rows = measured(name, seconds)
    after = [memory for t, memory in rows if t >= 60.0]
    assert rows[-1][0] >= seconds - 31.0
    assert max(after) - after[0] <= FLAT, rows
    assert after[0] - min(after) <= FLAT, rows


@pytest.mark.slow
def test_memory_is_flat_over_minutes():
    check("ekf", 120.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ekf", "fixed-lag"])
def test_memory_is_flat_over_two_hours(name):
    check(name, 7200.0)
