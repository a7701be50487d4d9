"""Kernels are compiled again where their source, or that of a module they use, has changed; all others are kept."""

from __future__ import annotations

import os

import pytest

from eval.plan import stale_kernels


@pytest.fixture
def project(tmp_path, monkeypatch):
    """`inner` is used by `outer`; `other` by nobody. All three are compiled."""
    folder = tmp_path / "ekf"
    (folder / "__pycache__").mkdir(parents=True)
    (folder / "constants.py").write_text("GATE = 9.0\n")
    (folder / "inner.py").write_text("from ekf.constants import GATE\n@njit\ndef inner(): ...\n")
    (folder / "outer.py").write_text("from ekf.inner import inner\n@njit\ndef outer(): ...\n")
    (folder / "other.py").write_text("@njit\ndef other(): ...\n")
    for name in ("inner", "outer", "other"):
        (folder / "__pycache__" / f"{name}.{name}-3.py311.nbi").write_text("")
        (folder / "__pycache__" / f"{name}.{name}-3.py311.1.nbc").write_text("")
    monkeypatch.setattr(stale_kernels, "ROOT", tmp_path)
    stale_kernels._imported.cache_clear()
    kept = folder / "__pycache__" / "sources.json"
    stale_kernels.note_sources(kept)
    return folder, kept


def changed(folder, kept, name):
    path = folder / f"{name}.py"
    path.write_text(path.read_text() + "# changed\n")
    stale_kernels._imported.cache_clear()
    stale = {m.stem for m in stale_kernels.forget_stale(kept)}
    assert {f.name.partition(".")[0] for f in (folder / "__pycache__").glob("*.nb[ic]")} == {
        "inner", "outer", "other",
    } - stale  # fmt: skip
    return stale


def test_nothing_is_stale_where_nothing_changed(project):
    assert stale_kernels.forget_stale(project[1]) == []


@pytest.mark.parametrize(("name", "stale"), [
    ("constants", {"inner", "outer"}), ("inner", {"inner", "outer"}), ("outer", {"outer"}), ("other", {"other"}),
])  # fmt: skip
def test_a_change_makes_its_module_stale_and_those_that_use_it(project, name, stale):
    assert changed(*project, name) == stale


def test_without_a_note_everything_is_stale(project):
    _, kept = project
    kept.unlink()
    assert {m.stem for m in stale_kernels.forget_stale(kept)} == {"inner", "outer", "other"}


def test_where_nothing_can_be_written_the_note_is_left_out(project, tmp_path):
    stale_kernels.note_sources(tmp_path / "ekf" / "inner.py" / "sources.json")


def test_every_module_with_kernels_of_the_project_is_known():
    names = {m.stem for m in stale_kernels.digests()}
    assert {"kernels", "updates", "whole_run", "jcbb", "elimination"} <= names
    assert stale_kernels.ROOT / "data" / "se2.py" in stale_kernels.closure(stale_kernels.ROOT / "ekf" / "whole_run.py")


def test_a_command_in_a_checkout_forgets_what_an_older_file_was_compiled_to(project):
    """After a pull the numbers are not those of the former code; elsewhere nothing is looked at."""
    folder, kept = project
    path = folder / "constants.py"
    path.write_text("GATE = 4.0\n")
    os.utime(path, (kept.stat().st_mtime + 10.0,) * 2)
    stale_kernels._imported.cache_clear()
    stale_kernels.forget_in_checkout(kept)
    assert len(list((folder / "__pycache__").glob("*.nbi"))) == 3
    (folder.parent / ".git").mkdir()
    stale_kernels.forget_in_checkout(kept)
    assert [f.name.partition(".")[0] for f in (folder / "__pycache__").glob("*.nbi")] == ["other"]
    assert stale_kernels.forget_stale(kept) == []
