"""The constants of the study of sensitivity: what half and twice of each is, and that a change reaches the code."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

import pytest

import association.candidates
import eval.replay.hindsight.hypotheses
import eval.replay.hindsight.two_models
from eval.replay.hindsight import constants, mapper
from eval.replay.hindsight.gates import as_stated
from eval.replay.hindsight.localizing_frontend import Health
from eval.replay.hindsight.noise import stated
from tests.research.sensitivity.cases import (
    BESIDE,
    DOUBLED,
    HALVED,
    all_constants,
    changed,
    varied,
)

ROOT = Path(__file__).parents[4]
EVIDENCE = "eval.replay.hindsight.constants"
BY_NAME = {c.name: c for c in all_constants()}
DECIDER = [path for package in ("association", "ekf", "eval/replay") for path in (ROOT / package).rglob("*.py")]


def both(monkeypatch, value, name="AGREE"):
    monkeypatch.setattr(constants, name, value)
    return varied(BY_NAME[name], HALVED), varied(BY_NAME[name], DOUBLED)


def test_the_complement_of_a_probability_near_one_is_halved_and_doubled(monkeypatch):
    assert both(monkeypatch, 0.99) == pytest.approx((0.995, 0.98))
    assert both(monkeypatch, 0.9) == pytest.approx((0.95, 0.8))


def test_other_shares_stay_below_one_and_what_is_no_share_is_doubled_past_it(monkeypatch):
    assert both(monkeypatch, 0.01) == (0.005, 0.02)
    assert both(monkeypatch, 0.7) == (0.35, 0.99)
    assert both(monkeypatch, 0.5, "DENSE") == (0.25, 1.0)
    assert both(monkeypatch, 3.0) == (1.5, 6.0)


def test_integers_are_rounded_down_and_at_least_one(monkeypatch):
    assert both(monkeypatch, 3) == (1, 6)
    assert both(monkeypatch, 1) == (None, 2)


def test_of_a_tuple_each_element_is_changed(monkeypatch):
    assert both(monkeypatch, (0.9, 1.0, 4)) == (pytest.approx((0.95, 0.5, 2)), pytest.approx((0.8, 2.0, 8)))


@pytest.mark.parametrize(
    ("name", "read"),
    [
        ("HEALTH_START", lambda: (Health().share, Health().scale)),
        ("HEALTH_WEIGHT", lambda: Health().learned),
        ("NOISE_PRIOR", lambda: stated().weight),
        ("SCALES_PRIOR", lambda: as_stated().motion.weight),
    ],
)
def test_what_begins_with_a_constant_begins_with_the_changed_one(name, read):
    value = varied(BY_NAME[name], HALVED)
    assert read() == BY_NAME[name].value
    with changed(BY_NAME[name], value):
        assert read() == value


@cache
def tree(path):
    return ast.parse(path.read_text(encoding="utf-8"))


def naming(word):
    return [path for path in DECIDER if word in path.read_text(encoding="utf-8")]


def outside_functions(node, inside=False):
    """Nodes that are evaluated when a module is imported."""
    if not inside:
        yield node
    if isinstance(node, (ast.FunctionDef, ast.Lambda)):
        body = node.body if isinstance(node.body, list) else [node.body]
        early = [*getattr(node, "decorator_list", []), *node.args.defaults, *filter(None, node.args.kw_defaults)]
        parts = [(n, inside) for n in early] + [(n, True) for n in body]
    else:
        parts = [(n, inside) for n in ast.iter_child_nodes(node)]
    for child, within in parts:
        yield from outside_functions(child, within)


def test_no_constant_is_bound_when_a_module_is_imported():
    bound = []
    for path in naming("constants"):
        bound += [
            f"{path}:{n.lineno} {n.attr}"
            for n in outside_functions(tree(path))
            if isinstance(n, ast.Attribute) and isinstance(n.value, ast.Name) and n.value.id == "constants"
        ]
        bound += [
            f"{path}:{n.lineno} {n.module}"
            for n in ast.walk(tree(path))
            if isinstance(n, ast.ImportFrom) and n.module == EVIDENCE
        ]
    assert bound == []


def test_no_constant_that_stands_beside_is_bound_either():
    for module, names in [(m, names) for m, _, names in BESIDE] + [(mapper, ("TIGHT",))]:
        early_nodes = outside_functions(tree(Path(module.__file__)))
        early = {n.id for n in early_nodes if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Load)}
        assert not early & set(names)
        for path in naming(module.__name__):
            taken = {
                alias.name
                for n in ast.walk(tree(path))
                if isinstance(n, ast.ImportFrom) and n.module == module.__name__
                for alias in n.names
            }
            assert not taken & set(names), path


def test_no_number_of_the_decider_is_forgotten():
    def own(module):
        body = tree(Path(module.__file__)).body
        return {t.id for n in body if isinstance(n, ast.Assign) for t in n.targets if t.id.isupper()}

    listed = {module: set(names) for module, _, names in BESIDE}
    assert own(eval.replay.hindsight.hypotheses) == listed[eval.replay.hindsight.hypotheses]
    assert own(eval.replay.hindsight.two_models) == listed[eval.replay.hindsight.two_models]
    # below so many landmarks they are not searched for: it is about time only
    assert own(association.candidates) == listed[association.candidates] | {"FEW"}
    assert len(BY_NAME) == len(all_constants())
