"""What a text names is loaded once and checked; whatever is wrong with it is a sentence, before any work."""

from __future__ import annotations

import sys

import pytest

from data.errors import UsageError
from eval.replay.external.adapter import digests, lack, load, tasks_of
from eval.replay.external.spec import settled
from eval.replay.settings import Setup


@pytest.fixture
def write(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))

    def written(code, attribute="F", name="mine.py"):
        (tmp_path / name).write_text(code, encoding="utf-8")
        return settled("--estimator", f"n=./{name}:{attribute}", "estimator")

    return written


@pytest.mark.parametrize(
    ("code", "attribute", "words"),
    [
        ("", "F", "n=./mine.py:F: no 'F' in mine.py; there is nothing"),
        ("def g(): ...\nclass H: ...", "F", "there is g, H"),
        ("F = 3", "F", "F is an int; a class or a function is needed"),
        ("\nx = 1 / 0", "F", r"importing it raised ZeroDivisionError: division by zero \(mine.py, line 2\)"),
        ("def f(:", "F", "mine.py, line 1: invalid syntax"),
        ("import nowhere_at_all", "F", "ModuleNotFoundError: No module named 'nowhere_at_all'"),
        ("raise SystemExit(3)", "F", "importing it raised SystemExit: 3"),
    ],
)
def test_what_cannot_be_loaded_is_said_in_one_line(write, code, attribute, words):
    with pytest.raises(UsageError, match=words) as fault:
        load(write(code, attribute))
    assert "\n" not in str(fault.value)


def test_a_module_that_is_not_there_is_said_with_where_it_was_looked_for(write, tmp_path):
    with pytest.raises(UsageError, match=f"there is no module 'nopkg', neither installed nor in {tmp_path}"):
        load(settled("--estimator", "n=nopkg.mod:F", "estimator"))


def test_a_file_imports_its_neighbours_and_shadows_nobody(write):
    write("WORD = 'beside'", name="a_neighbour_of_mine.py")
    write("WORD = 'wrong'", name="numbers.py")
    text = write("import numbers\nfrom a_neighbour_of_mine import WORD\ndef F(): return WORD, hasattr(numbers, 'WORD')")
    assert load(text).thing() == ("beside", False)


def test_the_digest_is_of_the_file_and_of_its_neighbours_that_it_uses(write):
    write("WORD = 1", name="used_by_mine.py")
    text = write("import used_by_mine\ndef F(): ...")
    before = digests((text, "ekf"))
    assert len(before) == 1
    assert len(load(text).sources) == 2
    write("WORD = 22", name="used_by_mine.py")
    assert digests((text,)) != before


def test_a_changed_file_is_loaded_again_in_the_same_process(write):
    assert load(write("def F(): return 1")).thing() == 1
    assert load(write("def F(): return 2")).thing() == 2


METHODS = "\n    def predict(self, i): ...\n    def update(self, s, d): ...\n    def estimate(self): ...\n"


@pytest.mark.parametrize(
    ("head", "tasks"),
    [
        ("def __init__(self, prior, sensor, options): ...", ("slam",)),
        ("def __init__(self, prior, sensor, options=None, *, more=3): ...", ("slam",)),
        ("def __init__(self, prior, sensor, known, options): ...", ("localization",)),
        ("def __init__(self, prior, sensor, *rest): ...", ("localization", "slam")),
        ("tasks = ('slam', 'localization')\n    def __init__(self, a, b): ...", ("slam", "localization")),
        ("tasks = 'slam'", ("slam",)),
    ],
)
def test_the_constructor_says_which_tasks_it_does_or_an_attribute(write, head, tasks):
    assert tasks_of(load(write(f"class F:\n    {head}{METHODS}"))) == tasks


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (
            f"class F:\n    def __init__(self, prior): ...{METHODS}",
            r"takes \(prior\); one of \(prior, sensor, options\)",
        ),
        (f"class F:\n    tasks = ('fly',){METHODS}", r"n.tasks is \('fly',\); some of localization, slam are needed"),
        ("class F:\n    def predict(self): ...", "no method 'update'; an estimator has predict, update, estimate"),
    ],
)
def test_what_is_no_estimator_is_said_with_what_one_is(write, code, words):
    with pytest.raises(UsageError, match=words):
        tasks_of(load(write(code)))


def test_what_a_run_would_lack_is_a_sentence(write):
    text = write(f"class F:\n    def __init__(self, prior, sensor, options): ...{METHODS}")
    assert lack(text, "slam", "known", Setup()) is None
    for task, association, setup, words in (
        ("localization", "known", Setup(), "n does slam only, by its constructor"),
        ("slam", "nn", Setup(), "n has no `expect`, which any --association but known needs"),
        ("slam", "jcbb-hindsight", Setup(), "n has no `remove`, which --association jcbb-hindsight needs"),
        ("slam", "known", Setup(maintain=True), "n has no `remove`, which --maintain needs"),
        ("slam", "known", Setup(deactivate_after=3.0), "n has no `park`, which --deactivate-after needs"),
    ):
        assert words in str(lack(text, task, association, setup))
