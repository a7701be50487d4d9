"""The notebooks run from start to end, and show what they show in the repository."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.e2e.docs.notebook import executed, load

DOCS = Path(__file__).parents[3] / "docs"
TOURS = sorted(DOCS.glob("*.ipynb"))
by_name = pytest.mark.parametrize("tour", TOURS, ids=[path.stem for path in TOURS])


@pytest.mark.slow
@by_name
def test_the_tour_runs_and_shows_what_is_stored(tour):
    stored = load(tour)
    fresh = executed(stored)
    for before, now in zip(stored["cells"], fresh["cells"], strict=True):
        assert shown(before) == shown(now), before["id"]


def shown(cell):
    """What the outputs of a cell say: texts and tables with their numbers, kinds of pictures."""
    outputs = cell.get("outputs", [])
    said = [(o.get("text"), o.get("data", {}).get("text/html")) for o in outputs]
    return [(o["output_type"], sorted(o.get("data", {}))) for o in outputs], said
