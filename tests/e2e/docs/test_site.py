"""The documentation site is built without a warning: no broken link, no missing anchor."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]


@pytest.mark.slow
def test_the_site_is_built_and_is_strict(tmp_path):
    pytest.importorskip("mkdocs", reason="of the dev extra")
    site = tmp_path / "site"
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(site)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    assert (site / "index.html").is_file()
    assert "compare" in (site / "api.html").read_text()
