"""Each fault of the list of traps is put in on purpose, and the check named beside it fails; without it, it passes.

Verdicts at 50 runs have power: the five broken twins of the consistency verdicts are called overconfident.
"""

from __future__ import annotations

import re
import sys
from collections import Counter

import pytest

from tests.mutation.faults import interpreted
from tests.mutation.table import FAULTS, label
from tests.quick import slow

PRODUCT = ("association", "data", "ekf", "eval", "graph", "wings")


def attributes():
    """Everything that modules and classes of the product hold by name."""
    found = {}
    for name, module in list(sys.modules.items()):
        if name.partition(".")[0] in PRODUCT:
            for key, value in list(vars(module).items()):
                found[name, key] = value
                if isinstance(value, type) and value.__module__ == name:
                    found |= {(name, key, inner): of for inner, of in vars(value).items()}
    return found


SOUND = attributes()
FIRST = {fault.trap: fault for fault in reversed(FAULTS)}
"""Of each trap the first fault is tried in the fast tests, and all that make a filter overconfident."""
passed = set()


def quick(fault):
    return FIRST[fault.trap] is fault or fault.match == "overconfident"


@pytest.mark.parametrize("fault", [f if quick(f) else slow(f) for f in FAULTS], ids=lambda fault: fault.what)
def test_the_fault_is_caught(fault, monkeypatch, record_property):
    record_property("fault", label(fault))
    if fault.check not in passed:  # nothing is patched here
        fault.check.run()
        passed.add(fault.check)
    fault.put_in(monkeypatch)
    with pytest.raises(fault.by, match=fault.match or None) as caught:
        fault.check.run()
    record_property("said", (str(caught.value).strip() or "assertion failed").splitlines()[0])


def test_every_trap_has_a_fault_that_was_put_in():
    assert {fault.trap for fault in FAULTS} == {None, *range(1, 28)}


def test_the_five_broken_twins_must_be_called_overconfident():
    twins = Counter(fault.what for fault in FAULTS if fault.match == "overconfident" and "NEES" in fault.check.name)
    for what in (
        "covariance times 0.8", "process noise halved", "bearing innovation not wrapped",
        "Jacobian of the first observation", "body-frame covariance for world-frame",
    ):  # fmt: skip
        assert twins[what] == 1, what


def test_a_fault_whose_place_is_gone_is_an_error():
    assert interpreted(label, {"fault.check.name": "fault.what"})(FAULTS[0]).count(FAULTS[0].what) == 2
    with pytest.raises(ValueError, match=re.escape("label: 'no such text' stands there 0 times")):
        interpreted(label, {"no such text": ""})


@pytest.mark.slow
def test_the_faults_are_gone_afterwards():
    """Ordinary runs stay unpatched: what was replaced is back, and every check passes again."""
    now = attributes()
    assert [name for name, value in SOUND.items() if now.get(name) is not value] == []
    for check in dict.fromkeys(fault.check for fault in FAULTS):
        check.run()
