"""How the player looks in a real headless browser: nothing cut at any width, axes, the camera's images.

`make test-browser`; needs the extra `browser` (Playwright) and a Chromium on PATH, and is skipped without.
"""

from __future__ import annotations

import numpy as np
import pytest

from data.logs import open_log
from tests.browser.opened import CAMERA, WIDTHS, Opened

pytestmark = pytest.mark.browser
ROOM = 24
"""px round the map for the numbers at its edge."""


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


@pytest.mark.parametrize("width", WIDTHS)
def test_the_whole_map_has_room_for_its_numbers(chromium, results, width):
    opened = Opened(chromium, results / "players" / "corridor_0_people.html", width)
    across, high = opened.js("[player.view.width, player.view.height]")
    x, y = np.array(
        opened.js(
            "player.recording.of('true_xy')"
            ".map((c, i) => Array.from(c, (v) => (i ? player.view.py(v) : player.view.px(v))))"
        )
    )
    assert min(x.min(), across - x.max(), y.min(), high - y.max()) >= ROOM - 1e-6
    opened.close()


def test_axes_count_whole_frames_and_name_every_decade(corridor, chromium, park):
    assert corridor.js("plots[0].plot.axes[0]._splits.every(Number.isInteger)")
    opened = Opened(chromium, park)
    shown = opened.js("plots[1].plot.axes[1]._values.filter((v) => v)")
    assert "0" not in shown
    assert {"0.001", "0.01", "0.1", "1"} <= set(shown)
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
