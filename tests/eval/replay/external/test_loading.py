"""What a text names is settled early and loaded once; whatever is wrong with it is a sentence before any work."""

import sys
from importlib.metadata import EntryPoint, EntryPoints

import pytest

from data.errors import UsageError
from eval.replay.external import spec
from eval.replay.external.adapter import ForeignError, Method, digests, lack, load, tasks_of
from eval.replay.external.spec import name_of, own_or_foreign, place_of, settled, shown
from eval.replay.settings import Setup


@pytest.fixture
def write(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))

    def written(code, attribute="F", name="mine.py"):
        (tmp_path / name).write_text(code, encoding="utf-8")
        return settled("--estimator", f"n=./{name}:{attribute}", "estimator")

    return written


@pytest.mark.parametrize(("code", "attribute", "words"), [
    ("", "F", "n=./mine.py:F: no 'F' in mine.py; there is nothing"),
    ("def g(): ...\nclass H: ...", "F", "there is g, H"),
    ("F = 3", "F", "F is an int; a class or a function is needed"),
    ("\nx = 1 / 0", "F", r"importing it raised ZeroDivisionError: division by zero \(mine.py, line 2\)"),
    ("def f(:", "F", "mine.py, line 1: invalid syntax"),
    ("raise SystemExit(3)", "F", "importing it raised SystemExit: 3"),
])  # fmt: skip
def test_what_cannot_be_loaded_is_said_in_one_line(write, code, attribute, words):
    with pytest.raises(UsageError, match=words) as fault:
        load(write(code, attribute))
    assert "\n" not in str(fault.value)


@pytest.mark.parametrize(("code", "takes"), [("def F(x, P, z): ...", r"\(x, P, z\)"), ("class F: ...", "no call")])
def test_a_function_of_other_arguments_or_an_object_is_no_association_method(write, code, takes):
    with pytest.raises(ForeignError, match=rf"n takes {takes}; an association method takes \(expectation, gate\)"):
        Method(load(write(code)))


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


@pytest.mark.parametrize(("head", "tasks"), [
    ("def __init__(self, prior, sensor, options): ...", ("slam",)),
    ("def __init__(self, prior, sensor, options=None, *, more=3): ...", ("slam",)),
    ("def __init__(self, prior, sensor, known, options): ...", ("localization",)),
    ("def __init__(self, prior, sensor, *rest): ...", ("localization", "slam")),
    ("tasks = ('slam', 'localization')\n    def __init__(self, a, b): ...", ("slam", "localization")),
    ("tasks = 'slam'", ("slam",)),
])  # fmt: skip
def test_the_constructor_says_which_tasks_it_does_or_an_attribute(write, head, tasks):
    assert tasks_of(load(write(f"class F:\n    {head}{METHODS}"))) == tasks


@pytest.mark.parametrize(("code", "words"), [
    (f"class F:\n    def __init__(self, prior): ...{METHODS}", r"takes \(prior\); one of \(prior, sensor, options\)"),
    (f"class F:\n    tasks = ('fly',){METHODS}", r"n.tasks is \('fly',\); some of localization, slam are needed"),
    ("class F:\n    def predict(self): ...", "no method 'update'; an estimator is a class with predict"),
])  # fmt: skip
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


READ = own_or_foreign("estimator")


@pytest.fixture
def here(tmp_path, monkeypatch):
    (tmp_path / "mine.py").write_text("class Filter: ...\nclass EKF: ...\n", encoding="utf-8")
    (tmp_path / "pack").mkdir()
    (tmp_path / "pack" / "__init__.py").write_text("", encoding="utf-8")
    (tmp_path / "pack" / "inner.py").write_text("class Filter: ...\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_relative_file_becomes_absolute_and_settling_again_changes_nothing(here):
    text = settled("--estimator", "mine=./mine.py:Filter", "estimator")
    assert text == f"mine={here}/mine.py:Filter" == settled("--estimator", text, "estimator")
    assert place_of(text).text == text
    assert shown(text) == "mine=./mine.py:Filter"
    assert (name_of(text), name_of("ekf")) == ("mine", "ekf")


def test_a_module_of_the_working_directory_carries_the_folder_it_was_found_in(here, monkeypatch):
    text = settled("--estimator", "pack.inner:Filter", "estimator")
    assert text == f"Filter=pack.inner@{here}:Filter"
    assert shown(text) == "Filter=pack.inner:Filter"
    monkeypatch.chdir("/")
    assert settled("--estimator", text, "estimator") == text
    assert settled("--estimator", "s=association.methods:singles", "estimator") == "s=association.methods:singles"


def test_without_a_name_it_has_that_of_the_attribute_unless_that_reads_like_ours(here):
    assert READ("--estimator", "./mine.py:Filter,ekf,./mine.py:EKF") == (
        f"Filter={here}/mine.py:Filter", "ekf", f"mine.EKF={here}/mine.py:EKF",
    )  # fmt: skip


@pytest.mark.parametrize(("text", "words"), [
    ("./nope.py:X", "--estimator ./nope.py:X: there is no file ./nope.py"),
    ("mine.py", "mine.py: unknown; known: dead-reckoning, ekf"),
    ("./mine.py:", r"\[NAME=\]package.module:Attribute or \[NAME=\]./file.py:Attribute is needed"),
    ("pack:", "is needed"), ("./pack:Filter", "there is no file ./pack"),
    ("ekf=./mine.py:Filter", "'ekf' would be taken for our estimator 'ekf'"),
    ("EKF=./mine.py:Filter", "'EKF' would be taken for our estimator 'ekf'"),
    ("a+b=./mine.py:Filter", r"'a\+b' cannot be part of file names; letters, digits"),
    ("../x=./mine.py:Filter", "cannot be part of file names"), (f"{41 * 'x'}=./mine.py:Filter", "at most 40"),
    ("m=./mine.py:Filter,m=./mine.py:EKF", "the name m is that of m=./mine.py:Filter, too"),
    ("m=./mine.py:Filter,M=./mine.py:EKF", "the name M is that of"),
    ("m=./mine.py:Filter,m=./mine.py:Filter", "named twice"), ("ekf,ekf", "named twice"),
])  # fmt: skip
def test_what_cannot_be_is_said_in_one_line(here, text, words):
    with pytest.raises(UsageError, match=words) as fault:
        READ("--estimator", text)
    assert "\n" not in str(fault.value)


def installed(monkeypatch, *points):
    found = EntryPoints(EntryPoint(name, value, group) for group, name, value in points)
    monkeypatch.setattr("eval.replay.external.spec.installed", lambda group: tuple(found.select(group=group)))


def test_a_name_that_an_installed_package_adds_is_used_like_ours(monkeypatch):
    installed(
        monkeypatch,
        ("slamref.estimators", "theirs", "logging.handlers:QueueHandler"),
        ("slamref.associations", "near", "a.b:c"),
    )
    assert READ("--estimator", "ekf,theirs") == ("ekf", "theirs=logging.handlers:QueueHandler")
    assert own_or_foreign("association")("--association", "near") == ("near=a.b:c",)
    with pytest.raises(UsageError, match=r"x: unknown; known: .*gnc, theirs; or your own"):
        READ("--estimator", "x")


@pytest.mark.parametrize(("points", "words"), [
    ([("isam2", "a.b:C")], "adds the estimator 'isam2' .slamref.estimators., which is the name of one of ours"),
    ([("x", "a.b:C"), ("x", "d.e:F")], "adds the estimator 'x' .*, and so does a.b:C; uninstall one"),
])  # fmt: skip
def test_an_installed_name_that_clashes_is_an_error_even_where_only_ours_are_asked_for(monkeypatch, points, words):
    installed(monkeypatch, *((spec.GROUPS["estimator"], *p) for p in points))
    with pytest.raises(UsageError, match=words):
        READ("--estimator", "ekf")
