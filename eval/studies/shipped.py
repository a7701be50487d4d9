"""The scenarios that come with the package. Imports nothing heavy, so that `--help` names them at once."""

from __future__ import annotations

from pathlib import Path

SCENARIOS = Path(__file__).parents[1] / "scenarios"


def scenarios() -> list[str]:
    """Their names."""
    return sorted(f.stem for f in SCENARIOS.glob("*.toml"))
