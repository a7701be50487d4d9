"""Runs kept on disk: what is read is what was written, damage counts as nothing, other content has another place."""

import platform
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from eval.studies import store
from eval.studies.montecarlo import Sample, one_run
from eval.studies.scenario import Member, load_scenario


@pytest.fixture(scope="module")
def small():
    arena = load_scenario("arena")
    return replace(arena, values=(("frames", 20), ("landmarks", 8)), members=(Member("ekf"), Member("batch")))


def same(a: Sample, b: Sample) -> bool:
    rows = [(dict(s.means), dict(s.ends), dict(s.squares), dict(s.published), s.failure) for s in (a, b)]
    return repr(rows[0]) == repr(rows[1]) and np.array_equal(a.nees_pose, b.nees_pose, equal_nan=True)


def test_a_kept_run_comes_back_to_the_last_bit(small, tmp_path):
    folder = store.folder_of(tmp_path, small)
    result = one_run(small, 3)
    result["slam", "ekf", "known", "online"] = Sample(failure="frame 7: the state is no longer finite")
    store.save(folder, 3, result)
    kept = store.load(folder, 3)
    assert list(kept) == list(result)
    assert all(same(result[key], kept[key]) for key in result)
    assert store.load(folder, 4) is None
    assert [f.name for f in folder.glob("[!.]*")] == ["3.npz"]


@pytest.mark.parametrize("damage", [lambda b: b[: len(b) // 2], lambda b: b"", lambda b: b"PK" + b[2:40]])
def test_a_damaged_file_counts_as_none(small, tmp_path, damage):
    folder = store.folder_of(tmp_path, small)
    store.save(folder, 0, one_run(small, 0))
    path = folder / "0.npz"
    path.write_bytes(damage(path.read_bytes()))
    assert store.load(folder, 0) is None


def test_what_numbers_depend_on_has_a_place_of_its_own_and_the_rest_has_not(small):
    digest = store.content_digest
    assert digest(small) == digest(replace(small, about="other words", cite="", runs=7, name="other"))
    assert digest(small) == digest(replace(small, members=(Member("ekf", ("slam",)), Member("batch"))))
    for other in (
        replace(small, values=(("frames", 21), ("landmarks", 8))), replace(small, members=(Member("ekf"),)),
        replace(small, setup=replace(small.setup, gate_known=0.9)), replace(small, wrong=0.1),
        replace(small, from_frame=2), replace(small, task=("slam",)),
    ):  # fmt: skip
        assert digest(other) != digest(small)


def test_runs_of_another_program_that_is_still_at_work_are_left_alone(tmp_path, monkeypatch, small):
    """Two checkouts whose results share a parent; what a dead process left goes, what another machine uses stays."""
    old = store.folder_of(tmp_path, small)
    (mark,) = old.glob(".used-*")
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as other:
        mark.unlink()
        (old / f".used-{platform.node()}-{other.pid}").touch()  # the mark of a process of this machine
        monkeypatch.setattr(store, "code_digest", lambda: "0" * store.DIGITS)
        store.folder_of(tmp_path, small)
        assert old.is_dir()
        other.communicate(b"\n")
    (old / ".used-elsewhere-1").touch()
    store.folder_of(tmp_path, small)
    assert old.is_dir()
    (old / ".used-elsewhere-1").unlink()
    store.folder_of(tmp_path, small)
    assert not old.exists()


def test_partial_files_of_dead_processes_go_and_those_of_living_ones_stay(tmp_path, small):
    folder = store.folder_of(tmp_path, small)
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as other:
        left = folder / f".3.partial-{platform.node()}-{other.pid}.npz"
        elsewhere = folder / ".3.partial-elsewhere-1.npz"
        left.touch()
        elsewhere.touch()
        store.folder_of(tmp_path, small)
        assert left.exists()
        other.communicate(b"\n")
    store.folder_of(tmp_path, small)
    assert not left.exists()
    assert elsewhere.exists()
