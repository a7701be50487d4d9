"""The Python of README and docs/api.md runs as it stands, and all pages are linked."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

import slamref

README = Path(__file__).parents[3] / "README.md"
API = README.parent / "docs" / "api.md"


def python(page: Path) -> str:
    (code,) = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    return code


def test_the_lines_of_python_in_the_readme_print_scores(capsys):
    assert len(python(README).splitlines()) <= 10
    exec(compile(python(README), "README.md", "exec"), {})
    assert "rmse_position_m" in capsys.readouterr().out


def test_the_loop_over_frames_in_the_api_page_runs():
    names: dict[str, object] = {}
    exec(compile(python(API), "api.md", "exec"), names)
    assert np.isfinite(names["pose"]).all()
    assert np.linalg.eigvalsh(names["covariance"]).min() > 0.0


def test_the_api_page_has_every_public_name():
    described = set(re.findall(r"^::: (\S+)$", API.read_text(encoding="utf-8"), flags=re.MULTILINE))
    assert described == {f"{home}.{name}" for name, home in (slamref.HOMES | slamref._of_wings()).items()}


def test_pages_and_pictures_it_points_to_are_there():
    for page in [README, *(README.parent / "docs").glob("*.md")]:
        for link in re.findall(r"\]\(([^)#]+)[^)]*\)", page.read_text(encoding="utf-8")):
            assert (page.parent / link).exists(), f"{page.name}: {link}"
