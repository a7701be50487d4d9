"""A foreign text is settled early: with a name that can stand in files, and a place that any process finds."""

from __future__ import annotations

from importlib.metadata import EntryPoint, EntryPoints

import pytest

from data.errors import UsageError
from eval.replay.external import spec
from eval.replay.external.spec import name_of, own_or_foreign, place_of, settled, shown

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


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("./nope.py:X", "--estimator ./nope.py:X: there is no file ./nope.py"),
        ("mine.py", "mine.py: unknown; known: dead-reckoning, ekf"),
        ("./mine.py:", r"\[NAME=\]package.module:Attribute or \[NAME=\]./file.py:Attribute is needed"),
        ("pack:", "is needed"),
        ("./pack:Filter", "there is no file ./pack"),
        ("ekf=./mine.py:Filter", "'ekf' would be taken for our estimator 'ekf'"),
        ("EKF=./mine.py:Filter", "'EKF' would be taken for our estimator 'ekf'"),
        ("a+b=./mine.py:Filter", r"'a\+b' cannot be part of file names; letters, digits"),
        ("../x=./mine.py:Filter", "cannot be part of file names"),
        (f"{41 * 'x'}=./mine.py:Filter", "at most 40"),
        ("m=./mine.py:Filter,m=./mine.py:EKF", "the name m is that of m=./mine.py:Filter, too"),
        ("m=./mine.py:Filter,M=./mine.py:EKF", "the name M is that of"),
        ("m=./mine.py:Filter,m=./mine.py:Filter", "named twice"),
        ("ekf,ekf", "named twice"),
    ],
)
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


@pytest.mark.parametrize(
    ("points", "words"),
    [
        ([("isam2", "a.b:C")], "adds the estimator 'isam2' .slamref.estimators., which is the name of one of ours"),
        ([("x", "a.b:C"), ("x", "d.e:F")], "adds the estimator 'x' .*, and so does a.b:C; uninstall one"),
    ],
)
def test_an_installed_name_that_clashes_is_an_error_even_where_only_ours_are_asked_for(monkeypatch, points, words):
    installed(monkeypatch, *((spec.GROUPS["estimator"], *p) for p in points))
    with pytest.raises(UsageError, match=words):
        READ("--estimator", "ekf")
