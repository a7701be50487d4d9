"""A robot with a lidar, online: as the front end of laser logs, within the period, with a grid on the page."""

import base64
import io
import json
import time

import numpy as np
import pytest
from PIL import Image

from data.logs import open_log
from data.se2 import between
from eval.replay.settings import Setup
from tests.wings.robot.line import linked
from wings.laser.slam.front_end import run_front_end
from wings.laser.slam.parameters import LaserParameters
from wings.robot.driving import WallFollower
from wings.robot.live.drive import Looking, drive as drive_on_line, latency_table
from wings.robot.live.feed import Feed
from wings.robot.live.session import EVERY, GridPainter, ScanEstimating, Session, rehearse
from wings.robot.simulated import Faults, Lidar, drive, room
from wings.robot.traffic import Recording

SECONDS = 20.0


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    """A recording on a line that tears some scans, what was taken, the session, the display and its feed."""
    folder, said, taken = tmp_path_factory.mktemp("robot") / "log", [], []
    rehearse((), "jcbb", Setup(), ScanEstimating(Setup(), 0.01))
    scanning = ScanEstimating(Setup(), 0.01)
    session = Session(("ekf",), "jcbb", Setup(), scanning=scanning)
    feed = Feed(2)
    display = Looking("drive", session, dict, said.append, feed=feed, painter=GridPainter(scanning.scans, feed.show))
    session._processed = lambda each: (taken.append(each), display.take(each))
    with Recording(folder, framed=True, lidar_sigma=0.01) as recording, pytest.MonkeyPatch.context() as patch:
        patch.setattr("time.perf_counter", time.thread_time)  # how busy the machine is does not matter
        link, wire, clock = linked(Faults(1e-4, 0.0, 0.0), 2, recording=recording, lidar=Lidar())
        drive_on_line(link, clock, session, WallFollower(), lambda: clock.now() >= SECONDS, display.look)
    display.end(clock.now())
    return folder, taken, session, feed, said, wire


def test_a_replay_of_the_recording_has_the_same_poses_to_the_bit(driven):
    folder, taken, session, *_ = driven
    inputs = open_log(str(folder)).inputs()
    assert len(inputs) == len(taken) > 70
    assert 0.7 * len(inputs) < len(inputs.scans.frame) < len(inputs), "some scans were torn"
    front = run_front_end(inputs, LaserParameters())
    steps = [t.steps[1] for t in taken]
    first = next(k for k, step in enumerate(steps) if step is not None)
    assert first == inputs.scans.frame[0]
    assert np.array([s.mean for s in steps[first:]]).tobytes() == front.online[first:].tobytes()
    assert len(session.estimating[1].slam.frames) == len(front.keys) > 5


def test_it_is_far_more_accurate_than_walls_and_odometry(driven):
    _, taken, _, _, _, wire = driven
    pose = between(room(0).start, wire.robot.pose)
    walls, scans = (np.hypot(*(taken[-1].steps[i].mean - pose)[:2]) for i in (0, 1))
    assert scans < 0.03
    assert scans < walls


def test_a_frame_costs_a_few_times_that_of_the_filter_beside_it(driven):
    walls, scans = driven[2].spent  # in processor time; 5 times where the machine is idle
    assert scans.within(0.5) < 25.0 * walls.within(0.5)


def test_status_and_table_name_it_beside_the_others(driven):
    said = driven[4]
    assert "| isam2 scan x " in said[-4]
    assert ", key poses " in said[-4]
    assert said[-3].split() == ["estimator", "median", "99", "%", "longest", "[ms", "a", "frame;", "period", "250]"]
    assert [line.split("  ")[0] for line in said[-2:]] == ["ekf", "isam2 scan"]
    assert len(latency_table(["none"], [type(driven[2].spent[0])()], 0.25)) == 1


def test_the_page_has_the_grid_of_the_room(driven):
    feed = driven[3]
    assert feed.published.grids == 1 + int(SECONDS / EVERY)
    assert json.loads(feed.published.small[-1].text)["grids"] == feed.published.grids
    shown = json.loads(feed.published.grid)
    picture = Image.open(io.BytesIO(base64.b64decode(shown["png"])))
    assert picture.mode == "LA"
    opaque = np.asarray(picture)[..., 1]
    assert opaque.shape == (round(shown["high"] / 0.05), round(shown["wide"] / 0.05))
    rows, columns = np.nonzero(opaque > 200)
    y = shown["south"] + shown["high"] - 0.05 * (rows + 0.5)
    # walls ahead of the robot's start: one a metre to the right, one 5 m to the left
    counted = np.bincount(np.round((y + 1.0) / 0.1).astype(int) + 5, minlength=70)
    assert counted[5] + counted[65] > 0.3 * len(y)
    assert len(columns) > 200


def test_it_is_drawn_every_few_seconds_and_in_the_end():
    rng, shown, scanner = np.random.default_rng(0), [], Lidar().directions.scanner(0.01)
    painter = GridPainter(lambda: (np.zeros((300, 3)), rng.uniform(1.0, 3.0, (300, 360)), scanner), shown.append)
    for t, count in ((0.0, 1), (EVERY - 0.1, 1), (EVERY, 2), (EVERY + 1.0, 2)):
        painter.work(t)
        assert len(shown) == count
    painter.work(EVERY + 1.0, last=True)
    assert len(shown) == 3


def test_before_the_first_scan_it_waits_and_frames_count():
    packets = drive(room(0), WallFollower(), 3.0, np.random.default_rng(0), lidar=Lidar()).packets
    blind = [*(p.__class__(p.t, p.ranges, p.odometry, p.joined, p.answer) for p in packets[:4]), *packets[4:]]
    session = Session((), "jcbb", Setup(), scanning=ScanEstimating(Setup(), 0.01))
    steps = [session.take(p).steps[0] for p in blind]
    assert [s is None for s in steps] == [True] * 4 + [False] * 8
    moved = between(packets[0].odometry, packets[4].odometry)
    np.testing.assert_allclose(steps[4].mean[:2], moved[:2], atol=0.01)
