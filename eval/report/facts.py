"""`report.json`: the facts that the report's sections were written from, without words."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from collections.abc import Set as AnySet
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from eval.report.page.blocks import Section


def as_json(facts: object) -> Any:
    """Facts as JSON holds them; not finite numbers are null. Raises TypeError for anything that is no fact."""
    if facts is None or facts is pd.NA:
        return None
    if isinstance(facts, Enum):
        return as_json(facts.value)
    if isinstance(facts, str | bool | int):
        return facts
    if isinstance(facts, float):
        return facts if math.isfinite(facts) else None
    if isinstance(facts, Path):
        return facts.as_posix()
    if isinstance(facts, np.generic | np.ndarray):
        return as_json(facts.tolist())
    if is_dataclass(facts) and not isinstance(facts, type):
        return {f.name: as_json(getattr(facts, f.name)) for f in fields(facts)}
    if isinstance(facts, pd.DataFrame):
        return as_json(facts.to_dict("records"))
    if isinstance(facts, Mapping):
        return {_name(key): as_json(value) for key, value in facts.items()}
    if isinstance(facts, AnySet):
        return sorted((as_json(f) for f in facts), key=repr)
    if isinstance(facts, Sequence):
        return [as_json(f) for f in facts]
    raise TypeError(f"{type(facts).__name__} is no fact: report.json cannot hold it")


def _name(key: object) -> str:
    return " ".join(map(str, key)) if isinstance(key, tuple) else str(as_json(key))


def write_facts(folder: Path, first: Mapping[str, object], sections: Iterable[Section]) -> None:
    """Write `report.json`: what stands before the sections, by name, and the facts of each section that has some."""
    named = [{"heading": s.heading, "facts": as_json(s.facts)} for s in sections if s.facts is not None]
    text = json.dumps(as_json(first) | {"sections": named}, indent=1, sort_keys=True, ensure_ascii=False)
    (folder / "report.json").write_text(text + "\n", encoding="utf-8", newline="\n")
