"""A kernel is compiled again where its source, or that of a module it uses, has changed, as well from a ZIP."""

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from data import compiled

ROOT = Path(__file__).parents[2]
SHOW = "from ekf.asked import asked; print(asked())"


@pytest.fixture
def product(tmp_path):
    """The product as from a ZIP, with a kernel of its own that uses a constant of another file."""
    folder = tmp_path / "product"
    shutil.copytree(ROOT / "data", folder / "data", ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "ekf").mkdir()
    (folder / "ekf" / "limits.py").write_text("LIMIT = 4.0\n")
    (folder / "ekf" / "__init__.py").touch()
    text = "from data.compiled import njit\nfrom ekf.limits import LIMIT\n@njit\ndef asked():\n    return LIMIT + 1.0\n"
    (folder / "ekf" / "asked.py").write_text(text)
    return folder


def run(folder, *words, **environment):
    command = [sys.executable, "-B", *words]
    env = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA")} | environment
    return subprocess.run(command, cwd=folder, env=env, check=True, capture_output=True, text=True).stdout


def edit(path, before, after):
    """A change that neither size nor time of the file shows."""
    stat = path.stat()
    path.write_text(path.read_text().replace(before, after))
    os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    assert path.stat().st_size == stat.st_size


def test_an_edited_kernel_and_one_that_uses_an_edited_file_give_the_new_result(product):
    assert run(product, "-c", SHOW) == "5.0\n"
    edit(product / "ekf" / "asked.py", "1.0", "2.0")
    assert run(product, "-c", SHOW) == "6.0\n"
    edit(product / "ekf" / "limits.py", "4.0", "7.0")
    assert run(product, "-c", SHOW) == "9.0\n"
    folders = list((product / "data" / "__pycache__" / "kernels").glob("ekf.asked-*"))
    assert [len(list(f.rglob("*.nbi"))) for f in folders] == [1, 1, 1]
    edit(product / "ekf" / "limits.py", "7.0", "4.0")
    assert run(product, "-c", SHOW) == "6.0\n"
    assert len(list((product / "data" / "__pycache__" / "kernels").glob("ekf.asked-*"))) == 3  # that of before


def test_a_folder_in_use_by_name_holds_the_kernels_of_those_who_ask_for_one(product, tmp_path):
    assert run(product, "-c", SHOW, NUMBA_CACHE_DIR=str(tmp_path / "mine")) == "5.0\n"
    assert len(list((tmp_path / "mine" / "slamref").rglob("asked*.nbi"))) == 1
    assert not (product / "data" / "__pycache__").exists()


def test_where_the_product_is_read_only_kernels_are_in_the_user_s_folder(monkeypatch, tmp_path):
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert compiled.base.__wrapped__() == Path(compiled.__file__).parent / "__pycache__" / "kernels"
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    assert compiled.base.__wrapped__() == tmp_path / "slamref"


def test_of_old_folders_the_newest_stay_and_those_of_a_day_ago_go(monkeypatch, tmp_path):
    monkeypatch.setattr(compiled, "base", lambda: tmp_path)
    now = time.time()
    for name, days in (("sensors", 9), ("sensors", 8), ("sensors", 7), ("se2", 9), ("sensors", 0.5)):
        folder = tmp_path / f"data.{name}-{days}"
        folder.mkdir()
        os.utime(folder, (now - 86_400 * days,) * 2)
    compiled.folder_of.__wrapped__(ROOT / "data" / "sensors.py")
    assert sorted(f.name for f in tmp_path.iterdir()) == ["data.se2-9", "data.sensors-0.5", "data.sensors-7"]


def test_a_module_s_digest_is_of_all_modules_that_it_imports():
    found, waiting = set(), [ROOT / "ekf" / "whole_run.py"]
    while waiting:
        if (module := waiting.pop()) not in found:
            found.add(module)
            waiting += compiled._source(module)[1]
    names = {f.relative_to(ROOT).as_posix() for f in found}
    assert {"ekf/kernels.py", "data/se2.py", "data/motion/systematic.py", "data/compiled.py"} < names
    assert "eval/run_all.py" not in names
