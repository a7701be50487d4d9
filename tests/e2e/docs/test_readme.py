"""What the README shows runs as it stands."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

README = Path(__file__).parents[3] / "README.md"


def test_the_lines_of_python_run_and_say_what_they_should(capsys):
    (code,) = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), flags=re.DOTALL)
    names: dict[str, object] = {}
    exec(compile(code, "README.md", "exec"), names)
    assert "rmse_position_m" in capsys.readouterr().out
    assert np.isfinite(names["pose"]).all()
    assert np.linalg.eigvalsh(names["covariance"]).min() > 0.0


def test_pages_and_pictures_it_points_to_are_there():
    for page in [README, *(README.parent / "docs").glob("*.md")]:
        for link in re.findall(r"\]\(([^)#]+)[^)]*\)", page.read_text(encoding="utf-8")):
            assert (page.parent / link).exists(), f"{page.name}: {link}"


def test_it_fits_on_two_screens():
    assert len(README.read_text(encoding="utf-8").splitlines()) <= 150
