"""Recordings and simulations as open logs."""

import tomllib
from pathlib import Path
from typing import Any

TEXTS: dict[str, Any] = tomllib.loads(Path(__file__).with_name("texts.toml").read_text(encoding="utf-8"))
"""What the help of a kind says: `help`, `about`, `examples`, and tables of flags, each with its metavar and text."""


def said_of(kind: str) -> dict[str, str]:
    """The texts of a kind's parser."""
    of = TEXTS[kind]
    return {"help": of["help"], "description": of["about"], "epilog": of["examples"]}
