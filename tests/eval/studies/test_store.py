"""Runs kept on disk: what is read is what was written, damage counts as nothing, other content has another place."""

from __future__ import annotations

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
    assert [f.name for f in folder.iterdir()] == ["3.npz"]


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
        replace(small, values=(("frames", 21), ("landmarks", 8))),
        replace(small, members=(Member("ekf"),)),
        replace(small, setup=replace(small.setup, gate_known=0.9)),
        replace(small, wrong=0.1),
        replace(small, from_frame=2),
        replace(small, task=("slam",)),
    ):
        assert digest(other) != digest(small)


def test_runs_of_an_older_program_are_removed(small, tmp_path, monkeypatch):
    old = store.folder_of(tmp_path, small)
    monkeypatch.setattr(store, "code_digest", lambda: "0123456789")
    new = store.folder_of(tmp_path, small)
    assert new.is_dir()
    assert new != old
    assert not old.exists()
