"""`docs/notes/hindsight-steps.md` and the code have the same nine steps, and every constant is in use."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[4]
HINDSIGHT = ROOT / "eval" / "replay" / "hindsight"
PAGE = (ROOT / "docs" / "notes" / "hindsight-steps.md").read_text(encoding="utf-8")
STEPS = dict(re.findall(r"^(\d)\. (\*\*.*?)(?=^\d\. |^$)", PAGE, flags=re.M | re.S))


def first_line(path):
    return path.read_text(encoding="utf-8").splitlines()[0]


@pytest.mark.parametrize("step", sorted(STEPS))
def test_every_file_that_a_step_names_is_there(step):
    named = re.findall(r"`([a-z_/]+\.py)`", STEPS[step])
    assert named
    assert all((ROOT / name).is_file() for name in named)


@pytest.mark.parametrize(
    "path", sorted(p for p in HINDSIGHT.glob("*.py") if "Step " in first_line(p)), ids=lambda p: p.name
)
def test_a_file_that_is_a_step_is_named_by_that_step(path):
    (number,) = re.findall(r"Step (\d)", first_line(path))
    assert str(path.relative_to(ROOT)) in STEPS[number]


def test_every_constant_is_used():
    constants = ast.parse((HINDSIGHT / "constants.py").read_text(encoding="utf-8"))
    targets = [t for n in constants.body if isinstance(n, ast.Assign) for t in n.targets]
    names = {n.id for t in targets for n in ast.walk(t) if isinstance(n, ast.Name)}
    code = "".join(
        p.read_text(encoding="utf-8") for folder in ("association", "eval") for p in (ROOT / folder).rglob("*.py")
    )
    assert len(names) > 80
    assert names == set(re.findall(r"\bconstants\.([A-Z_]+)\b", code)) & names
