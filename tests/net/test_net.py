"""The net holds: no column of a small run has moved; and it is a net: what moves is told, by run, file and column."""

from __future__ import annotations

import json
import shutil
from functools import cache

import pytest

from tests.net import __main__ as command
from tests.net.cases import CASES
from tests.net.digest import columns_of, compare, digest_of, digests, moved
from tests.net.headlines import contradictions
from tests.net.record import RECORDED, Record, done
from tests.net.values import differences

VALUES = [0.1 * k - 0.7 + 1e-3 * k * k for k in range(40)]


def cells(values):
    return [repr(v) for v in values]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """`made(name)`: what is kept of a case, and its result folder; each case is run once."""

    @cache
    def make(name):
        folder = tmp_path_factory.mktemp("net")
        return done(name, folder), folder / name

    return make


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[] if case.short else [pytest.mark.slow]) for n, case in CASES.items()]
)
def test_no_column_of_a_run_has_moved_and_no_headline_contradicts_its_numbers(name, made):
    (case, folder), kept = made(name), Record.read(name)
    assert not isinstance(case, str), case
    assert kept is not None, f"{name} is not recorded: python -m tests.net --record --only {name}"
    assert case.record.status == kept.status
    found = list(compare(case.record.files, kept.files, exact=False, close=CASES[name].close))
    assert not found, "\n".join([f"{len(found)} moved", *("  ".join(move) for move in found[:40])])
    if (folder / "report.md").is_file():
        assert not list(contradictions(folder))


def test_changes_of_rounding_rows_blanks_and_words_are_told_apart():
    kept, now = digest_of(cells(VALUES)), digest_of(cells(v * (1 + 3e-11) for v in VALUES))
    assert now.exact != kept.exact
    assert moved(now, kept, exact=False) == ""
    assert moved(now, kept, exact=True) == "other text, the same but for rounding"
    kept = digest_of(cells(VALUES))
    assert moved(digest_of(["", *cells(VALUES[1:])]), kept, exact=False) == "1 blanks were 0"
    assert moved(digest_of(cells(VALUES[1:])), kept, exact=False) == "39 rows were 40"
    assert moved(digest_of(["tp", "fp"]), digest_of(["tp", "tp"]), exact=False) == "other words"
    for column in (cells(VALUES), ["tp", "fn", ""], ["", ""], [], ["0.0"]):
        d = digest_of(column)
        assert moved(type(d).parse(str(d)), d, exact=False) == moved(type(d).parse(str(d)), d, exact=True) == ""
    assert digest_of([]).exact != digest_of([""]).exact
    assert {p.stem for p in RECORDED.glob("*.json")} == set(CASES)


@pytest.fixture(scope="module")
def saved(made):
    """A small result folder, as `--save` keeps it."""
    case, folder = made("result-alone")
    assert not isinstance(case, str)
    return folder


def changed(folder, file, old, new):
    text = (folder / file).read_text("utf-8")
    assert old in text
    (folder / file).write_text(text.replace(old, new, 1), encoding="utf-8")


@pytest.fixture
def again(saved, tmp_path):
    return shutil.copytree(saved, tmp_path / "again")


def test_a_moved_number_is_told_with_its_file_and_column(saved, again):
    rmse = columns_of(saved)["metrics.csv"]["rmse_position_m"][0]
    changed(again, "metrics.csv", f",{rmse},", f",{float(rmse) * 1.001!r},")
    kept, now = columns_of(saved), columns_of(again)
    for exact in (False, True):
        ((file, column, _),) = compare(digests(now), digests(kept), exact=exact)
        assert (file, column) == ("metrics.csv", "rmse_position_m")
    ((file, column, what),) = differences(now, kept, 1e-9)
    assert (file, column) == ("metrics.csv", "rmse_position_m")
    assert "0.001 of the column's scale" in what
    assert not list(differences(now, kept, 0.01))


def test_the_command_says_what_moved_and_fails(saved, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(command, "ProcessPoolExecutor", Here)
    monkeypatch.setattr("tests.net.record.RECORDED", tmp_path)
    words = ["--only", "result-alone"]
    assert command.main(words) == 1
    assert "result-alone  not recorded yet" in capsys.readouterr().out
    assert command.main([*words, "--record"]) == 0
    assert command.main([*words, "--exact"]) == 0
    assert "1 cases, 0 columns moved" in capsys.readouterr().out
    kept = tmp_path / "result-alone.json"
    held = json.loads(kept.read_text())
    held["files"]["metrics.csv"]["nis_lower"] = "ffffffff 2 0 3 1 1"
    kept.write_text(json.dumps(held))
    assert command.main(words) == 1
    assert "result-alone  metrics.csv  nis_lower  1 rows were 2" in capsys.readouterr().out
    assert command.main([*words, "--against", str(saved.parent)]) == 0


class Here:
    """Processes that are this one."""

    def __init__(self, *args, **options):
        pass

    def __enter__(self):
        return self

    def __exit__(self, *args):
        pass

    map = staticmethod(map)
