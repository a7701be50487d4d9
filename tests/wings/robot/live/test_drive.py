"""The loop of a drive: commands go on, every packet is taken, and whatever happens the robot is told to rest."""

from __future__ import annotations

import numpy as np
import pytest

from eval.replay.settings import Setup
from tests.wings.robot.line import StandingClock
from tests.wings.robot.live.driven import packets
from wings.robot.live.drive import REST, Looking, at_rest, drive
from wings.robot.live.feed import MINUTE, Feed
from wings.robot.live.session import Latencies, Session
from wings.robot.packets import AHEAD, PERIOD, SONARS, Answer, Command
from wings.robot.traffic.stream import Packet


class Scripted:
    """A link whose answers are known; after the last one nothing comes."""

    def __init__(self, answers):
        self.answers, self.commands, self.clock = list(answers), [], StandingClock()

    def step(self, command):
        self.commands.append(command)
        self.clock.sleep(PERIOD)
        return self.answers.pop(0) if self.answers else []


def ahead(packet):
    return 0.2, 0.0


def run(link, seconds, **more):
    session = Session(("ekf",), "jcbb", Setup())
    drive(link, link.clock, session, ahead, lambda: link.clock.now() >= seconds, **more)
    return session


def blocked(ahead):
    """What a robot hears that has a wall so many m before it, and nothing else."""
    ranges = np.full(len(SONARS), np.inf)
    ranges[AHEAD] = ahead
    return Packet(0.0, ranges, np.zeros(3), True, Answer((4000,) * 8, 0, 0, 0))


def test_at_rest_nothing_moves_whatever_is_heard():
    assert [at_rest(blocked(ahead)) for ahead in (0.1, np.inf)] == [(0.0, 0.0)] * 2


@pytest.mark.slow
def test_every_packet_is_taken_the_last_answer_included():
    came = packets(2.5)
    link = Scripted([[], came[:1], came[1:4], came[4:5], came[5:6]])
    assert run(link, 4 * PERIOD).frames == 6, "four periods, and the answer to the last command"
    assert link.commands == [REST, REST, Command(200, 0), Command(200, 0), REST]


def test_a_robot_that_is_not_heard_is_told_to_rest():
    link = Scripted([[p] for p in packets(1.0)])
    run(link, 4.0)
    assert link.commands[1:5] == [Command(200, 0)] * 4
    assert link.commands[9:] == [REST] * len(link.commands[9:])
    assert len(link.commands) == 17


def test_an_error_tells_the_robot_to_rest_all_the_same():
    link = Scripted([[p] for p in packets(10.0)])

    def look(t):
        if t > 1.0:
            raise RuntimeError("full")

    with pytest.raises(RuntimeError, match="full"):
        run(link, 10.0, look=look)
    assert link.commands[-2:] == [Command(200, 0), REST]


def test_of_packets_that_came_together_the_newest_says_how_long_it_took():
    latencies, came = Latencies(), packets(1.0)
    link = Scripted([[], came])
    link.clock.time = came[-1].t - 2 * PERIOD + 0.004
    run(link, came[-1].t + 0.001, latencies=latencies)
    assert latencies.longest == pytest.approx(0.004)


def test_a_line_a_second_and_chunks_even_if_seconds_are_short(monkeypatch):
    now = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    session, feed, said = Session(("ekf",), "jcbb", Setup()), Feed(1), []
    display = Looking("drive", session, lambda: {"lost": 3}, said.append, feed=feed)
    session._processed = display.take
    for k, packet in enumerate(packets(75.0)):
        session.take(packet)
        now[0] += 0.001 if k < 260 else 0.5
        display.look(packet.t)
    assert len(said) == 20
    assert all("ekf x" in line and "link: lost 3" in line for line in said)
    assert feed.published.small[0].end == MINUTE, "as many frames as that are a chunk at once"


def test_an_estimator_that_ends_is_said_once():
    session, said = Session(("ekf", "ekf-iterated"), "jcbb", Setup()), []
    display = Looking("drive", session, dict, said.append)
    session.estimating[1].failure = "at frame 0: astray"
    for _ in range(2):
        display.say(1.0)
    assert said[0] == "ekf-iterated ended at frame 0: astray; the others and the recording go on"
    assert [("ended at frame" in line) for line in said] == [True, False, False]
    assert "| ekf-iterated ended |" in said[1]
