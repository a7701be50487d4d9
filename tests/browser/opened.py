"""A page of the player in a headless browser: what it complained of and what it asked for."""

import shutil

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
NAME = "corridor:0:people"
CAMERA = "visual:0:frames=12"
WIDTHS = (1400, 1100, 400)


class Opened:
    def __init__(self, browser, path, width=1400, dark=False):
        self.page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme="dark" if dark else "light")
        self.complaints, self.asked = [], []
        self.page.on("console", lambda message: self.complaints.append(message.text))
        self.page.on("pageerror", lambda fault: self.complaints.append(str(fault)))
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.goto(path.as_uri())
        self.page.wait_for_selector("html[data-ready]", timeout=60_000)
        self.address = path.as_uri()

    def js(self, text):
        return self.page.evaluate(text)

    def settle(self):
        """Two frames later everything asked for is drawn."""
        self.js("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def close(self):
        """Nothing was complained of, and nothing but the file was asked for."""
        self.page.close()
        assert self.complaints == []
        assert self.asked == [self.address]
