"""The net holds: no column of a small run has moved; and it is a net: what moves is told, by run, file and column."""

from functools import cache

import pytest

from tests.net.cases import CASES
from tests.net.digest import compare, digest_of, moved
from tests.net.headlines import contradictions
from tests.net.record import RECORDED, Record, done

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
