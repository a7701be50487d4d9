"""After `slamref warm`, no run compiles anything."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from data import compiled

ROOT = Path(compiled.__file__).parents[1]
RUNS = [["arena:0"], ["arena:0:frames=100", "--task", "slam", "--calibrate", "auto"]]


@pytest.mark.slow
def test_every_kernel_that_a_run_uses_is_compiled_by_warm(tmp_path):
    env = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA")} | {"NUMBA_CACHE_DIR": str(tmp_path)}

    def kernels(*words):
        done = subprocess.run([sys.executable, "-m", *words], cwd=ROOT, env=env, capture_output=True, text=True)
        assert done.returncode in (0, 1), done.stderr
        return {f.name for f in tmp_path.rglob("*.nbc")}

    warmed = kernels("eval.warm")
    assert len(warmed) > 80
    for words in RUNS:
        assert kernels("eval.run_all", *words, "--out", str(tmp_path / "out")) == warmed, words
