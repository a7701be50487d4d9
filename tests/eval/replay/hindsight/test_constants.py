"""The constants of the study of sensitivity: what half and twice of each is, and that a change reaches the code."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

import pytest

from eval.replay.hindsight.gates import as_stated
from eval.replay.hindsight.localizing_frontend import Health
from eval.replay.hindsight.noise import stated
from tests.research.sensitivity.cases import (
    HALVED,
    all_constants,
    changed,
    varied,
)

ROOT = Path(__file__).parents[4]
EVIDENCE = "eval.replay.hindsight.constants"
BY_NAME = {c.name: c for c in all_constants()}
DECIDER = [path for package in ("association", "ekf", "eval/replay") for path in (ROOT / package).rglob("*.py")]


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
