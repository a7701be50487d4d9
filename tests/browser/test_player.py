"""The player in a real headless browser: opens from a file, plays, steps, shows the numbers of the result folder.

`make test-browser`; needs the extra `browser` (Playwright) and a Chromium on PATH, and is skipped without.
"""

import numpy as np
import pytest

from association.decide import METHODS
from data.logs import open_log
from eval import play
from eval.referee.confusion import OUTCOMES
from eval.replay.recorder import Observer
from eval.replay.run import step_by_step
from tests.browser.opened import NAME, Opened
from tests.builders.tables import rows

pytestmark = pytest.mark.browser
INKED = """() => {
  const { width, height } = player.view.canvas, { data } = player.view.canvas.getContext("2d").getImageData(0, 0, width, height);
  const is = (i, hex) => [1, 3, 5].every((at, c) => data[i + c] === parseInt(hex.slice(at, at + 2), 16));
  return player.recording.head.team.robots.map((r) => [...data.keys()].filter((i) => i % 4 === 0 && is(i, r.colour)).length);
}"""  # noqa: E501
"""Pixels of the map in the colour of each robot."""
FASTEST = 1000 / 30
"""ms in which a frame must be drawn to play 30 of them in a second."""


def decisions_of(results, association):
    return rows(results / "runs" / "corridor_0_people" / f"slam-ekf-{association}" / "decisions.csv")


def choose(opened, association):
    opened.page.select_option("#focus", label=f"EKF {association}")
    opened.settle()


def test_it_opens_with_the_run_that_decides_and_plays_to_the_end(corridor):
    assert "jcbb" in corridor.page.locator("#focus option:checked").text_content()
    corridor.page.select_option("#speed", "50")
    corridor.page.click("#play")
    assert corridor.page.locator("#play").text_content() == "Pause"
    for _ in range(100):  # 43 s of the log at 50 times their speed, and what a busy machine takes
        corridor.page.wait_for_timeout(200)
        if corridor.page.locator("#play").text_content() == "Play":
            break
    assert corridor.js("[player.S.frame, player.S.playing]") == [43, False]


def test_keys_and_buttons_step_a_frame(corridor):
    page = corridor.page
    page.focus("#map")
    for key, frame in (("ArrowRight", 1), ("ArrowRight", 2), ("ArrowLeft", 1), ("End", 43), ("Home", 0)):
        page.keyboard.press(key)
        assert corridor.js("player.S.frame") == frame, key
    page.click("#forward")
    page.click("#forward")
    page.click("#back")
    corridor.settle()
    assert page.locator("#now").text_content().startswith("frame 1 of 43")
    page.focus("#slider")
    page.keyboard.press("ArrowRight")
    assert corridor.js("player.S.frame") == 2


def test_it_stops_at_each_wrong_decision_and_nowhere_else(corridor, results):
    for association in ("nn", "jcbb"):
        choose(corridor, association)
        rows = decisions_of(results, association)
        wrong = sorted({int(r["frame"]) for r in rows if r["outcome"] in ("fp", "fn")})
        assert wrong
        corridor.js("player.go(-1)")
        first = [wrong[0]] if wrong[0] == 0 else []
        found = []
        for _ in wrong[len(first) :]:
            corridor.page.click("#wrong-next")
            found.append(corridor.js("player.S.frame"))
        assert first + found == wrong
        corridor.settle()
        if found:
            facts = corridor.page.locator("#facts-table").text_content()
            assert "FP" in facts or "FN" in facts


def test_every_decision_is_the_one_of_the_result_folder(corridor, results):
    for association in ("nn", "jcbb"):
        choose(corridor, association)
        rows = decisions_of(results, association)
        shown = corridor.js(
            "(() => { const key = player.recording.head.runs[player.S.run].key;"
            " const of = (n) => [...player.recording.column(key + n)];"
            " return [of('decision'), of('outcome'), of('right')]; })()"
        )
        assert shown[0] == [int(r["decision"]) for r in rows]
        assert [OUTCOMES[o] for o in shown[1]] == [r["outcome"] for r in rows]
        assert shown[2] == [int(r["truth"]) for r in rows]


class Expectations(Observer):
    """What the filter expected in one frame: squared distances and every method's decisions, by plain formulas."""

    def __init__(self, frame):
        self.frame, self.d2, self.said = frame, {}, {}

    def decided(self, front, frame, pairing):
        e = pairing.expectation
        if frame.number == self.frame:
            for i in range(len(e.z)):
                for j, number in enumerate(e.number.tolist()):
                    nu = e.z[i] - e.z_hat[j]
                    self.d2[i, number] = float(nu @ np.linalg.solve(e.HPHt[j] + e.R[i], nu))
            self.said = {name: front.decide(e, name).decisions.tolist() for name in METHODS}


def test_a_click_on_an_observation_shows_its_candidates_and_what_each_method_says(corridor, results):
    choose(corridor, "nn")
    corridor.js("player.go(0)")
    corridor.page.click("#wrong-next")
    corridor.settle()
    frame = corridor.js("player.S.frame")
    oracle = Expectations(frame)
    log = open_log(NAME)
    step_by_step("ekf", log.inputs().without_map(), "slam", "nn", finish=False, observer=oracle)
    first = log.recorded.start[frame]
    rows = [r for r in decisions_of(results, "nn") if int(r["frame"]) == frame]
    clicked = 0
    for mark in corridor.js("player.marks()"):
        others = [m for m in corridor.js("player.marks()") if m["row"] != mark["row"]]
        if min((np.hypot(m["x"] - mark["x"], m["y"] - mark["y"]) for m in others), default=99) < 4:
            continue  # on top of another one
        corridor.page.locator("#map").click(position={"x": mark["x"], "y": mark["y"]})
        corridor.settle()
        i = mark["row"] - first
        assert corridor.page.locator("#which").text_content() == f"Frame {frame}, observation {i}"
        facts = corridor.page.locator("#facts-table").text_content()
        decision = int(rows[i]["decision"])
        assert rows[i]["outcome"].upper() in facts
        assert ("new" if decision == -1 else "not used" if decision == -2 else f"landmark {decision}") in facts
        shown = corridor.js(
            "[...document.querySelectorAll('#candidates tbody tr')].map((r) => [+r.dataset.number, +r.dataset.d2,"
            " r.cells[1].textContent, r.cells[2].textContent])"
        )
        assert shown[0][0] == sorted((d2, n) for (k, n), d2 in oracle.d2.items() if k == i)[0][1]
        for number, d2, text, gate in shown:
            assert d2 == pytest.approx(oracle.d2[i, number], rel=2e-4)
            assert float(text) == pytest.approx(oracle.d2[i, number], rel=1e-3)
            if abs(oracle.d2[i, number] - 9.21034) > 0.01:
                assert gate == ("inside" if oracle.d2[i, number] < 9.21034 else "outside")
        said = corridor.js(
            "Object.fromEntries([...document.querySelectorAll('#methods tr')]"
            ".map((r) => [r.dataset.method, +r.dataset.decision]))"
        )
        assert said == {name: made[i] for name, made in oracle.said.items()}
        clicked += 1
    assert clicked >= 3


def test_final_and_online_are_both_there_and_runs_come_and_go(chromium, park):
    opened = Opened(chromium, park)
    opened.js("player.go(3000)")
    opened.page.select_option("#focus", label="iSAM2 known")
    opened.page.check("input[name=phase][value=final]")
    opened.settle()
    assert opened.js("player.S.phase") == "final"
    before = opened.js("document.querySelector('#map').toDataURL()")
    opened.page.locator("#runs label", has_text="batch").locator("input").uncheck()
    opened.settle()
    assert opened.js("document.querySelector('#map').toDataURL()") != before
    opened.close()


def test_the_longest_log_is_small_and_is_drawn_fast_enough(chromium, park, results):
    assert park.stat().st_size <= 8e6
    assert (results / "players" / "corridor_0_people.html").stat().st_size <= 1e6
    opened = Opened(chromium, park)
    opened.js("player.go(4000)")
    opened.settle()
    cost = opened.js(
        "(() => { const begin = performance.now(); for (let k = 4000; k < 4300; k++) { player.go(k); player.draw(); }"
        " return (performance.now() - begin) / 300; })()"
    )
    assert cost < FASTEST
    opened.close()


def test_a_team_has_five_paths_with_names_and_lines_between_robots(chromium, tmp_path):
    out = tmp_path / "team.html"
    assert play.main(["arena:0:robots=5+frames=40", "--cooperative", "--estimator", "ekf", "--out", str(out)]) == 0
    for width in (1400, 400):
        opened = Opened(chromium, out, width)
        names = opened.js("player.recording.head.team.robots.map((r) => r.name)")
        assert names == [f"robot {k}" for k in range(1, 6)]
        # a frame at which robots observe robots alone
        opened.js("player.go(player.recording.column('met_frame').find((k) => !player.recording.column('count')[k]))")
        maps = []
        for rays in (False, True):
            opened.page.set_checked("#rays", rays)
            opened.settle()
            maps.append(opened.page.locator("#map").screenshot())
        assert maps[0] != maps[1], "lines between robots"
        assert min(opened.js(INKED)) > 20, "each path in the colour of its robot"
        assert opened.js("document.documentElement.scrollWidth") == width
        opened.close()
