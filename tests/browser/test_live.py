"""The live page in a real headless browser: it grows with the drive, follows it, and leaves alone who looks back."""

import numpy as np
import pytest

from eval.player.document import live_document
from eval.replay.settings import Setup
from wings.robot.driving import WallFollower
from wings.robot.live.feed import Feed, Server, header
from wings.robot.live.session import Session
from wings.robot.simulated import drive, room

pytestmark = pytest.mark.browser


class Drive:
    def __init__(self, rng):
        self.session, self.feed = Session(("ekf", "ekf-iterated"), "jcbb", Setup()), Feed(2)
        self._packets = iter(drive(room(0), WallFollower(), 300.0, rng).packets)

    def on(self, frames):
        for k in range(frames):
            self.feed.add(self.session.take(next(self._packets)))
            if k % 4 == 3 or k == frames - 1:
                maps = [each.map() for each in self.session.estimating]
                self.feed.publish(maps, header("drive", self.session.estimating, f"{self.session.frames} taken"))


@pytest.fixture
def driving(chromium):
    driven = Drive(np.random.default_rng(0))
    with Server(0, live_document("drive").encode(), lambda: driven.feed.published) as server:
        page = chromium.new_page(viewport={"width": 1400, "height": 900})
        complaints, asked = [], []
        page.on("console", lambda message: complaints.append(message.text))
        page.on("pageerror", lambda fault: complaints.append(str(fault)))
        page.on("request", lambda request: asked.append(request.url))
        page.goto(server.address)
        yield driven, page
        page.close()
    assert complaints == []
    assert all(url.startswith(server.address) for url in asked)


def until(page, frames):
    for _ in range(200):
        if page.evaluate("window.player ? player.recording.frames : 0") == frames:
            return
        page.wait_for_timeout(50)
    raise AssertionError(page.text_content("#facts"))


def test_it_waits_grows_and_follows(driving):
    driven, page = driving
    for _ in range(100):
        if page.text_content("#facts").startswith("Waiting"):
            break
        page.wait_for_timeout(50)
    assert page.text_content("#facts") == "Waiting for the robot's first answer."
    driven.on(100)
    until(page, 100)
    driven.on(600)
    until(page, 700)
    page.wait_for_timeout(200)
    assert page.evaluate("player.S.frame") == 699
    assert page.text_content("#facts") == "700 taken"
    assert "frame 699 of 699" in page.text_content("#now")
    pose, step = page.evaluate("player.pose()"), driven.session.estimating[0].front.estimator.estimate()
    assert abs(pose["x"] - step.mean[0]) < 1e-3
    walls = page.evaluate("landmarksNow().map((l) => [l.number, l.x, l.y])")
    state = driven.session.estimating[0].map()
    assert [w[0] for w in walls] == state.number.tolist()
    assert abs(walls[0][1] - state.xy[0, 0]) < 2e-3


def test_who_looks_back_is_left_there_until_live_is_pressed(driving):
    driven, page = driving
    driven.on(50)
    until(page, 50)
    page.focus("#map")
    page.keyboard.press("Home")
    driven.on(50)
    until(page, 100)
    page.wait_for_timeout(200)
    assert page.evaluate("player.S.frame") == 0
    assert page.get_attribute("#live", "aria-pressed") == "false"
    page.click("#live")
    driven.on(10)
    until(page, 110)
    page.wait_for_timeout(200)
    assert page.evaluate("player.S.frame") == 109
    assert page.get_attribute("#live", "aria-pressed") == "true"
