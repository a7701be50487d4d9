"""What is packed for the page comes back within half a step, in few bytes."""

from __future__ import annotations

import json

import numpy as np
import pytest

from eval.player.pack import Pack, ranges, text_of, unpacked


def carried(add, values, *how):
    pack = Pack(0, len(values))
    getattr(pack, add)("a", values, *how)
    chunk = pack.done({})
    return unpacked(json.loads(text_of(chunk)))["a"], chunk["arrays"][0]


@pytest.mark.parametrize("step", [1e-4, 1e-3, 0.5])
def test_numbers_come_back_to_half_a_step(step):
    values = np.cumsum(np.random.default_rng(0).normal(size=(500, 3)), axis=0)
    back, _ = carried("add", values, step)
    assert np.abs(back - values).max() <= 0.5 * step * (1 + 1e-9)


def test_integers_of_any_size_come_back_as_they_are():
    for most, size in ((100, 1), (30_000, 2), (1_000_000_000, 4)):
        values = np.array([0, most, most, most - 5])
        back, entry = carried("add", values)
        assert back[:, 0].tolist() == values.tolist()
        assert entry["size"] == size


def test_what_is_positive_comes_back_to_a_part_of_itself():
    values = np.exp(np.random.default_rng(1).uniform(-20, 10, size=300))
    back, _ = carried("add_log", values)
    assert np.abs(back[:, 0] / values - 1).max() < 0.00051


def test_a_row_without_a_number_is_missing_and_costs_its_neighbours_nothing():
    values = np.array([[np.nan, 1.0], [2.0, 3.0], [np.inf, 0.0], [4.0, 5.0]])
    back, entry = carried("add", values, 1.0)
    assert np.isnan(back).all(axis=1).tolist() == [True, False, True, False]
    assert back[[1, 3]].tolist() == [[2.0, 3.0], [4.0, 5.0]]
    assert entry["missing"] == [[0, 1], [2, 3]] == ranges(np.array([True, False, True, False]))


def test_steps_are_left_alone_and_nothing_is_an_array_too():
    pack = Pack(3, 2)
    pack.add_steps("steps", np.array([[3, -1], [-300, 0]]))
    pack.add("nothing", np.empty((0, 2)))
    chunk = pack.done({"name": "x"})
    back = unpacked(chunk)
    assert back["steps"].tolist() == [[3, -1], [-300, 0]]
    assert back["nothing"].shape == (0, 2)
    assert (chunk["first"], chunk["frames"], chunk["name"]) == (3, 2, "x")


def test_a_path_that_goes_astray_is_kept_to_a_part_of_its_extent():
    values = np.array([0.0, 1.0, 1e12, -1e12])
    back, entry = carried("add", values, 1e-4)
    assert np.abs(back[:, 0] - values).max() <= 1e-9 * 1e12
    assert entry["scale"] < 1e-8 * 1e12
    with pytest.raises(OverflowError, match="a step of"):
        Pack(0, 1).add_steps("steps", np.array([2**31]))


def test_a_page_cannot_be_ended_by_what_stands_in_a_name():
    assert "</script>" not in text_of(Pack(0, 0).done({"name": "</script>"}))
