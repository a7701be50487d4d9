"""Facts of the report as JSON: every kind of value, the same bytes each time."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import pytest

from eval.report.page.blocks import Section
from eval.report.writing import as_json, write_facts


class Word(StrEnum):
    GOOD = "good"


@dataclass(frozen=True)
class Facts:
    size: float
    word: Word
    many: np.ndarray
    names: frozenset[str]


def test_every_kind_of_fact_becomes_plain_values():
    made = as_json(Facts(math.nan, Word.GOOD, np.array([[1.0, math.inf]]), frozenset({"b", "a"})))
    assert made == {"size": None, "word": "good", "many": [[1.0, None]], "names": ["a", "b"]}
    assert as_json({("ekf", "known"): np.int64(3)}) == {"ekf known": 3}
    with pytest.raises(TypeError, match="object is no fact"):
        as_json([object()])


def test_the_file_holds_what_stands_first_and_the_facts_of_sections_that_have_some(tmp_path):
    sections = [Section("A", ()), Section("B", (), facts={"n": 2})]
    write_facts(tmp_path, {"logs": ["a"]}, sections)
    first = (tmp_path / "report.json").read_bytes()
    assert json.loads(first) == {"logs": ["a"], "sections": [{"heading": "B", "facts": {"n": 2}}]}
    write_facts(tmp_path, {"logs": ["a"]}, sections)
    assert (tmp_path / "report.json").read_bytes() == first
