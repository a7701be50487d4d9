"""The loop of a drive: every packet is taken, estimates are those of a replay, and in the end the robot rests."""

import math
import signal
from types import SimpleNamespace

import numpy as np
import pytest

from data.errors import UsageError
from data.result import PoseEstimate
from ekf.filter import FilterDivergedError
from eval.replay.settings import Setup
from tests.quick import slow
from tests.wings.robot.line import StandingClock
from tests.wings.robot.live.driven import estimate_bits, online, packets, replayed, replayed_bits
from wings.robot.live.drive import REST, Looking, Presses, drive, estimator_words, status_line
from wings.robot.live.feed import MINUTE, Feed
from wings.robot.live.session import COLUMNS, Latencies, Session, Step, estimates
from wings.robot.packets import PERIOD, Command


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


BOTH = (signal.SIGINT, signal.SIGTERM)


@pytest.fixture
def outside():
    """What arrives outside of any block; the signals' own ways to end a process are put back afterwards."""
    came: list[int] = []
    before = {s: signal.signal(s, lambda number, frame: came.append(number)) for s in BOTH}
    yield came
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", BOTH)
def test_once_presses_are_heeded_each_ends_the_work_and_is_counted(outside, number):
    with Presses() as presses:
        signal.raise_signal(number)
        presses.heed()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(number)
        assert presses.count == 2
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(number)
        assert presses.count == 3
    assert outside == []


NOBODY = np.empty(0, np.int64)
STEP = Step(np.array([1.0, -2.0, 7.0]), np.diag([0.01, 0.04, math.radians(1.0)]) ** 2, NOBODY, NOBODY, 1.0)


def test_a_pose_stands_with_its_three_sigma_and_a_wrapped_heading():
    pose = "x 1.000 ± 0.030, y -2.000 ± 0.120 m, heading 41.1 ± 3.0°"
    assert estimator_words("ekf", STEP, "walls 9", "") == f"ekf {pose}, walls 9"
    assert estimator_words("ekf", STEP, "", "").endswith("°")
    assert estimator_words("ekf", None, "walls 0", "") == "ekf waits"
    assert estimator_words("ekf", STEP, "walls 9", "astray") == "ekf ended"


def test_faults_latency_and_being_late_are_said():
    latencies = Latencies()
    assert status_line(3.0, ["ekf"], {"lost": 0}, latencies, 0.25) == "    3.0 s | ekf | link: no faults"
    latencies.add(0.004)
    line = status_line(3.0, ["ekf"], {"lost": 2, "late": 0, "device gone": 1}, latencies, 0.25)
    assert line.endswith("| link: lost 2, device gone 1 | latency 4.0 ms, 99 % < 4.0 ms")
    latencies.add(0.6)
    assert status_line(4.0, [], {}, latencies, 0.25).endswith("| late: 0.60 s, longer than a period of 0.25 s")
    latencies.begin()
    latencies.add(0.1)
    assert "late:" not in status_line(5.0, [], {}, latencies, 0.25), "of this second, not of ever"
    assert math.isnan(Latencies().within(0.99))


COVARIANCE = np.array([[0.1, 1 / 3, 0.3], [1 / 3, 0.2, -0.6], [0.3, -0.6, 0.7]])


def taken(number, *steps):
    return SimpleNamespace(frame=SimpleNamespace(number=number, time=0.1 * number), steps=steps)


def test_a_line_holds_the_bits_of_pose_and_covariance_and_who_has_ended_has_none(tmp_path):
    step = PoseEstimate(np.array([1 / 3, -2.0, np.pi / 7]), COVARIANCE)
    with estimates(tmp_path / "now.csv", ["ekf", "isam2"]) as add:
        add(taken(3, step, step))
        add(taken(4, None, step))
        head, *rows = (tmp_path / "now.csv").read_text().splitlines()  # written at once
    assert head == COLUMNS
    cells = [row.split(",") for row in rows]
    assert [c[:3] for c in cells] == [["3", repr(0.1 * 3), "ekf"], ["3", repr(0.1 * 3), "isam2"], ["4", "0.4", "isam2"]]
    for c in cells:
        values = dict(zip(COLUMNS.split(",")[3:], map(float, c[3:]), strict=True))
        assert [values[name] for name in ("x", "y", "theta")] == step.mean.tolist()
        named = [["xx", "xy", "xt"], ["xy", "yy", "yt"], ["xt", "yt", "tt"]]
        assert [[values[name] for name in row] for row in named] == COVARIANCE.tolist()


def test_a_file_that_is_there_stays(tmp_path):
    (tmp_path / "now.csv").write_text("mine")
    with pytest.raises(UsageError, match=r"--estimates .*now.csv: "), estimates(tmp_path / "now.csv", ["ekf"]):
        pass
    assert (tmp_path / "now.csv").read_text() == "mine"


@pytest.mark.parametrize(("name", "association", "setup"), [
    slow("ekf", "jcbb", Setup()), ("ekf-iterated", "nn", Setup(gate=0.95, maintain=True)),
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
