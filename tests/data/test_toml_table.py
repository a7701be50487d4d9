"""Tables of TOML files: a checked value for every question, or one line that names table, key and value."""

import math

import numpy as np
import pytest

from data.errors import UsageError
from data.toml_table import TomlTable, finite, load_toml, positive

KNOWN = {"": ("a", "deep", "many"), "deep": ("b",), "deep.er": ("c",), "many": ("d",)}


def fault(what: str) -> UsageError:
    return UsageError(f"here: {what}")


def table(**values) -> TomlTable:
    return TomlTable(fault, values, {"": tuple(values)})


def test_values_come_checked():
    t = table(n=3, x=2.5, big=math.inf, on=True, text="so", two=[1, 2.0], names=["p", "q"])
    assert (t.whole("n", 1, least=3), t.number("x", None, "a number", finite)) == (3, 2.5)
    assert t.number("n", None, "a number") == 3.0
    assert t.number("big", None, "a number") == math.inf
    assert (t.flag("on"), t.text("text"), t.one_of("text", ("so", "no"))) == (True, "so", "so")
    assert np.array_equal(t.numbers("two", 2, "two numbers are"), [1.0, 2.0])
    assert np.array_equal(t.numbers("two", None, "numbers are"), [1.0, 2.0])
    assert t.names("names", ("q", "p", "r"), ("r",)) == ("p", "q")
    assert "n" in t
    assert "m" not in t


def test_what_is_left_out_has_its_default():
    t = table()
    assert (t.whole("n", 7), t.number("x", 0.5, ""), t.flag("on"), t.flag("on", default=True)) == (7, 0.5, False, True)
    assert (t.text("text", "so"), t.one_of("text", ("so",), "so"), t.names("names", (), ("r",))) == ("so", "so", ("r",))
    assert t.optional_table("deep") is None
    assert t.tables_of("many") == []


@pytest.mark.parametrize(("ask", "what"), [
    (lambda t: t.whole("x", 1), "x = 2.5: a whole number is needed"),
    (lambda t: t.whole("n", 1, least=4), "n = 3: at least 4 is needed"),
    (lambda t: t.whole("minus", 1, least=0), "minus = -1: must not be negative"),
    (lambda t: t.number("huge", None, "a number"), "huge = 1e+16: a number is needed"),
    (lambda t: t.number("minus", None, "a length", positive), "minus = -1: a length is needed"),
    (lambda t: t.numbers("two", 3, "three numbers are"), "two = [1, 2.0]: three numbers are needed"),
    (lambda t: t.flag("n"), "n = 3: true or false is needed"), (lambda t: t.text("n"), "n = 3: text is needed"),
    (lambda t: t.one_of("text", ("yes", "no")), "text = 'so': unknown; known: yes, no"),
    (lambda t: t.names("two", ("p",), ()), "two = [1, 2.0]: 1 is unknown; known: p"),
    (lambda t: t.names("twice", ("p",), ()), "twice = ['p', 'p']: at least one name, none of them twice, is needed"),
    (lambda t: t.table_of("n"), "n = 3: this must be a table"),
    (lambda t: t.table_of("y"), "no [y] table; one is needed"),
    (lambda t: t.tables_of("n"), "n = 3: tables [[n]] are needed"),
])  # fmt: skip
def test_what_is_wrong_is_one_line_with_key_and_value(ask, what):
    t = table(
        n=3, x=2.5, minus=-1, nan=math.nan, huge=1e16, on=True, text="so", two=[1, 2.0], twice=["p", "p"], none=[]
    )
    with pytest.raises(UsageError) as wrong:
        ask(t)
    assert str(wrong.value) == f"here: {what}"


def test_tables_in_tables_are_named_as_in_the_file():
    t = TomlTable(fault, {"deep": {"b": {"c": 1}}, "many": [{"d": 1}, {"d": 2}]}, {**KNOWN, "deep.b": ("c",)})
    assert t.table_of("deep").table_of("b").whole("c", 0) == 1
    assert [each.whole("d", 0) for each in t.tables_of("many")] == [1, 2]
    with pytest.raises(UsageError, match=r"here: \[deep.b\] c = 1: text is needed"):
        t.table_of("deep").table_of("b").text("c")


@pytest.mark.parametrize(("content", "what"), [
    ({"x": 1}, "unknown key 'x' at the top; known: a, deep, many"),
    ({"b": 1}, r"unknown key 'b' at the top; it belongs to \[deep\]"),
    ({"deep": {"x": 1}}, r"unknown key 'x' in \[deep\]; known: b"),
    ({"deep": {"a": 1}}, r"unknown key 'a' in \[deep\]; it belongs to the top, before the first \[table\]"),
])  # fmt: skip
def test_an_unknown_key_is_named_with_where_it_belongs(content, what):
    with pytest.raises(UsageError, match=what):
        TomlTable(fault, content, KNOWN).optional_table("deep")


def test_the_keys_of_a_table_may_depend_on_what_another_one_says():
    t = TomlTable(fault, {"a": {"free": 1}}, KNOWN)
    assert t.table_of("a").whole("free", 0) == 1, "a table that nothing is known of"
    with pytest.raises(UsageError, match=r"unknown key 'free' in \[a\]; known: e, f"):
        t.table_of("a", ("e", "f"))


@pytest.mark.parametrize(("content", "what"), [
    (b"a = ", "not valid TOML"), (b"a = '\xff'", "not valid TOML"), (b"x = " + b"[" * 100_000, "not valid TOML"),
    (b"a = " + b"9" * 10_000, "not valid TOML"),
])  # fmt: skip
def test_a_file_that_is_no_toml_is_one_line(content, what, tmp_path):
    path = tmp_path / "x.toml"
    path.write_bytes(content)
    with pytest.raises(UsageError, match=f"here: {what}") as wrong:
        load_toml(path, fault)
    assert "\n" not in str(wrong.value)


def test_a_file_that_cannot_be_read_is_one_line(tmp_path):
    with pytest.raises(UsageError, match="here: no such file; one is needed"):
        load_toml(tmp_path / "x.toml", fault, "no such file; one is needed")
    with pytest.raises(UsageError, match="here: cannot be read: "):
        load_toml(tmp_path, fault)
