"""`slamref check` prints a line for each check; exit status 0 if all pass, 1 if one fails, 2 for wrong usage."""

import pytest

from eval.check import main

STUDENT = """
import numpy as np
from association.methods import singles

def good(expectation, gate):
    return singles(expectation, gate)

def bad(expectation, gate):
    return np.zeros(len(expectation.z))

class Filter:
    def __init__(self, prior, sensor): ...
    def update(self, s, d): ...
    def predict(self, i): ...
    def estimate(self): ...

def make(prior, sensor, options):
    raise RuntimeError("not yet")
"""


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    (tmp_path / "student.py").write_text(STUDENT, encoding="utf-8")
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(("asked", "status", "words"), [
    (["./student.py:good"], 0, "good=./student.py:good (association method)\n  ok    exact observations: 360"),
    (["./student.py:good", "student:good"], 0, "all 9 checks passed\ngood=student:good"),
    (["./student.py:good", "./student.py:bad"], 1, "0 of 9 checks passed"),
    (["./student.py:bad"], 1, "  FAIL  gate: bad: what it returned is array("),
    (["./student.py:make", "--as", "estimator"], 1, "make() raised RuntimeError: not yet (student.py, line 18)"),
    (["./student.py:Filter"], 1, "FAIL  interface: Filter: its constructor takes (prior, sensor); one of (prior"),
])  # fmt: skip
def test_it_prints_a_line_for_each_check_and_says_by_its_status_whether_all_passed(asked, status, words, capsys):
    assert main(asked) == status
    assert words in capsys.readouterr().out


@pytest.mark.parametrize(("asked", "words"), [
    (["./student.py:none"], "no 'none' in student.py; there is good, bad, Filter, make"),
    (["nothing"], "nothing: unknown; known: dead-reckoning"), (["./nowhere.py:x"], "there is no file ./nowhere.py"),
    (["gnc"], "gnc: does not work step by step"),
])  # fmt: skip
def test_wrong_usage_is_one_line_and_exit_status_2(asked, words, refused):
    assert words in refused(main, asked)
