"""Players that the tests open, and the browser; without the extra `browser` and a Chromium all are skipped."""

import pytest

from eval import play, run_all
from tests.browser.opened import CAMERA, CHROMIUM, NAME, Opened


@pytest.fixture(scope="session")
def results(tmp_path_factory):
    """The result folder of a corridor with people, nearest neighbour and joint compatibility."""
    out = tmp_path_factory.mktemp("results") / "corridor"
    wanted = ["--log", NAME, "--task", "slam", "--estimator", "ekf", "--association", "nn,jcbb", "--quick"]
    assert run_all.main([*wanted, "--out", str(out), "-q", "--jobs", "1"]) == 0
    return out


@pytest.fixture(scope="session")
def park(tmp_path_factory):
    """The player of the longest log, three estimators."""
    out = tmp_path_factory.mktemp("park") / "park.html"
    assert play.main(["victoria-park", "--estimator", "dead-reckoning,ekf,isam2,batch", "--out", str(out)]) == 0
    return out


@pytest.fixture(scope="session")
def pictures(tmp_path_factory):
    """The player of a short recording of a camera."""
    out = tmp_path_factory.mktemp("pictures") / "pictures.html"
    assert play.main([CAMERA, "--estimator", "ekf", "--out", str(out)]) == 0
    return out


@pytest.fixture(scope="session")
def chromium():
    api = pytest.importorskip("playwright.sync_api", reason="the extra `browser` is not installed (make test-browser)")
    if CHROMIUM is None:
        pytest.skip("no Chromium on PATH")
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture
def corridor(chromium, results):
    opened = Opened(chromium, results / "players" / "corridor_0_people.html")
    yield opened
    opened.close()
