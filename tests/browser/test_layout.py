"""How player and report look in a real headless browser: nothing cut at any width, axes, the camera's images."""

import numpy as np
import pytest

from data.logs import open_log
from eval.report.page.blocks import Overview, OverviewRow, Report, Section
from eval.report.render import write_report
from tests.browser.opened import CAMERA, WIDTHS, Opened

pytestmark = pytest.mark.browser


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("dark", [False, True])
def test_nothing_is_cut_off_at_any_width(chromium, results, width, dark):
    opened = Opened(chromium, results / "players" / "corridor_0_people.html", width, dark)
    opened.page.click("#wrong-next")
    opened.settle()
    assert opened.js("document.documentElement.scrollWidth") <= width
    assert opened.js("document.querySelector('#map').clientWidth") > 0.5 * min(width, 700)
    assert opened.js("document.querySelectorAll('.uplot').length") == 2
    paper = opened.js("getComputedStyle(document.body).backgroundColor")
    assert (paper == "rgb(22, 24, 27)") == dark
    opened.close()


def test_the_camera_shows_each_frame_with_the_corners_found(chromium, pictures, corridor):
    found = open_log(CAMERA).evidence.found
    opened = Opened(chromium, pictures)
    for frame in (0, 7):
        opened.js(f"player.go({frame})")
        opened.page.locator("#image-note", has_text=f"frame {frame}:").wait_for()
        of = np.flatnonzero(found.frame == frame)
        note = opened.page.locator("#image-note").text_content()
        assert note.endswith(f" {', '.join(str(p) for p in found.picture[of])} found.")
        for u, v in found.pixels[of[0], 1:]:  # a frame that is off in any direction leaves one of these corners
            colour = opened.js(
                "(() => { const c = document.querySelector('#image'), s = c.width / player.recording.head.camera.width;"
                " const pixel = new OffscreenCanvas(1, 1).getContext('2d', { willReadFrequently: true });"
                f" pixel.drawImage(c, -Math.floor(({u} + 0.5) * s), -Math.floor(({v} + 0.5) * s));"
                " return Array.from(pixel.getImageData(0, 0, 1, 1).data); })()"
            )
            assert colour == pytest.approx([0xF0, 0xE4, 0x42, 0xFF], abs=2)
    assert opened.page.locator("#camera").is_visible()
    assert not corridor.page.locator("#camera").is_visible()
    opened.close()


ROW = OverviewRow("people+no-odometry, slam", "A", ("smoother", "0.0227", "0.00826", "2.75", "jcbb-hindsight\n9 FP"))
BREAKS = "Array.from(document.querySelectorAll('section'), (s) => getComputedStyle(s).breakBefore)"


def breaks_on_paper(chromium, folder, first):
    overview = Overview(("log", "trust", "filter", "smoother", "ratio", "best"), (ROW,), "What it means.")
    below = tuple(Section(name, ("Text.",)) for name in "AB")
    write_report(folder, Report("Title", "command", (overview,), below, tuple(Section(n, ("Text.",)) for n in first)))
    page = chromium.new_page()
    page.goto((folder / "report.html").as_uri())
    page.emulate_media(media="print")
    found = page.evaluate(BREAKS)
    page.close()
    return found


def test_each_section_begins_a_page_but_a_single_one_under_the_overview(chromium, tmp_path):
    assert breaks_on_paper(chromium, tmp_path, ["Cause"]) == ["auto", "page", "page"]
    assert breaks_on_paper(chromium, tmp_path, ["Question 1", "Question 2"]) == ["page"] * 4


@pytest.mark.parametrize("width", WIDTHS)
def test_the_page_is_no_wider_than_the_window_and_the_overview_is_whole_from_1100(chromium, results, width):
    page = chromium.new_page(viewport={"width": width, "height": 900})
    page.goto((results / "report.html").as_uri())
    page.evaluate("document.querySelectorAll('details').forEach((d) => { d.open = true; })")
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    inner, outer = page.evaluate(
        "(({ scrollWidth: a, clientWidth: b }) => [a, b])(document.querySelector('.overview .scroll'))"
    )
    assert inner <= outer or width < 1100
    page.close()
