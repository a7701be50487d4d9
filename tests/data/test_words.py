"""Facts become sentences in one place, from templates that know every code."""

from __future__ import annotations

import pytest
from jinja2 import UndefinedError

from data.notice import Code, notice
from data.words import NOTICES, environment, sentence


def test_every_code_has_its_words_and_nothing_else_has():
    macros = {name for name in vars(environment("data").get_template(NOTICES).module) if not name.startswith("_")}
    assert macros == {code.replace("-", "_") for code in Code}


def test_a_notice_is_said_with_its_values():
    assert sentence(notice(Code.REMOVED, landmarks=1)) == "1 landmark was removed from the map"


def test_a_value_that_a_template_does_not_know_is_an_error():
    with pytest.raises((TypeError, UndefinedError)):
        sentence(notice(Code.OUT_OF_MEMORY, size=3))


def test_a_notice_is_told_whom_it_is_about():
    found = notice(Code.OUT_OF_MEMORY).about(log="arena-0", estimator="ekf", frame=3)
    assert (found.log, found.estimator, found.frame) == ("arena-0", "ekf", 3)
