"""A filter of Stone Soup as docs/notes/stone-soup.md wraps it: it passes the checks, and is as good as ours.

Stone Soup is no dependency of ours. A slow test makes an environment for it, which sees our packages through a .pth
file.
"""

from __future__ import annotations

import ast
import json
import os
import re
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs" / "notes" / "stone-soup.md").read_text(encoding="utf-8")
(CODE,) = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
VERSION = "1.9.1"
COMPARED = """
import json
import slamref
from data.worlds.arena import Arena, simulate

log = simulate(Arena(frames=60), 3)
names = ["ekf", "ss=./stone_soup.py:StoneSoup"]
runs = slamref.compare(log.inputs(labels=True), "localization", names)
runs += slamref.compare(log.inputs(), "localization", names, "jcbb")
rows = slamref.score([slamref.Trial(log, "localization", tuple(runs))]).metrics
print(json.dumps([[r.estimator, r.association, float(r.rmse_position_m), float(r.nees_pose), float(r.nis)]
                  for r in rows.itertuples()]))
"""


def test_the_wrapper_takes_at_most_60_lines():
    assert CODE.count("\n") <= 60
    named = {node.name for node in ast.walk(ast.parse(CODE)) if isinstance(node, ast.FunctionDef)}
    assert {"predict", "expect", "update", "estimate"} <= named


@pytest.fixture
def python(request, tmp_path):
    """`python(*words)`: what its interpreter says in a folder with the example."""
    place = request.config.cache.mkdir("stone-soup") / VERSION
    interpreter = place / "bin" / "python"
    if not (place / "installed").exists():
        subprocess.run([sys.executable, "-m", "venv", "--clear", place], check=True, capture_output=True)
        where = [interpreter, "-c", "import sysconfig; print(sysconfig.get_paths()['purelib'])"]
        own = subprocess.run(where, check=True, capture_output=True, text=True).stdout.strip()
        Path(own, "ours.pth").write_text(sysconfig.get_paths()["purelib"] + "\n")
        install = [interpreter, "-m", "pip", "install", "-q", f"stonesoup=={VERSION}"]
        made = subprocess.run(install, capture_output=True, text=True, check=False)
        if made.returncode:
            pytest.skip(f"stonesoup cannot be installed here: {(made.stderr.strip().splitlines() or ['?'])[-1]}")
        (place / "installed").touch()
    (tmp_path / "stone_soup.py").write_text(CODE, encoding="utf-8")

    def run(*words):
        path = {**os.environ, "PYTHONPATH": str(ROOT)}
        done = subprocess.run(
            [interpreter, *words], cwd=tmp_path, env=path, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    return run


@pytest.mark.slow
def test_it_passes_all_checks(python):
    said = python("-m", "slamref", "check", "./stone_soup.py:StoneSoup")
    assert "checks passed" in said
    assert "FAIL" not in said
    off = [float(v) for v in re.findall(r"are within (\S+) sigma of the exact filter", said)]
    assert len(off) == 2
    assert off[0] < 1e-7
    assert off[1] < 0.01


@pytest.mark.slow
def test_it_is_as_good_as_our_filter_with_and_without_labels(python):
    rows = {(name, association): numbers for name, association, *numbers in json.loads(python("-c", COMPARED))}
    assert set(rows) == {(name, association) for name in ("ekf", "ss") for association in ("known", "jcbb")}
    for association in ("known", "jcbb"):
        (rmse, nees, nis), ours = rows["ss", association], rows["ekf", association]
        assert rmse == pytest.approx(ours[0], rel=0.01)
        assert nees == pytest.approx(ours[1], rel=0.03)
        assert nis == pytest.approx(ours[2], rel=0.01)
