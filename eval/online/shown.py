"""What the page is told beside the numbers: the estimators with their colours and states, and how things stand."""

from __future__ import annotations

from collections.abc import Sequence

from eval.figures.style import style_of
from eval.online.rows import QUANTUM, key_of
from eval.online.session import Estimating
from eval.player.laser import dashes


def header(name: str, estimating: Sequence[Estimating], status: str) -> dict[str, object]:
    """Of a chunk (see `eval.player.scene`, whose keys these are): a log without truth or labels, walls as landmarks."""
    return {
        "name": name, "indexed": False, "quantum": QUANTUM, "left_out": [], "methods": [], "gate": None,
        "new_gate": None, "gates": ["none", "none"], "band": [0.0, 0.0], "labels": False, "laser": False,
        "truth": False, "camera": None, "walls": True, "now": status,
        "runs": [_run(number, each) for number, each in enumerate(estimating)],
    }  # fmt: skip


def _run(number: int, each: Estimating) -> dict[str, object]:
    association, style = each.front.association, style_of(each.name)
    return {
        "estimator": each.name, "association": association, "phases": ["online"],
        "status": "ended" if each.failure else "ok", "why": each.failure, "decides": True, "scored": False,
        "history": True, "every": 1, "certain": not each.front.estimator.smooths, "candidates": False, "nis": True,
        "nis_expected": 1.0, "key": key_of(number), "name": f"{style.label} {association}", "colour": style.colour,
        "task": "slam", "dash": dashes(style.line), "beside": "",
    }  # fmt: skip
