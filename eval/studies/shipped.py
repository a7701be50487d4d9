"""The shipped scenarios. Imports nothing heavy, so that `--help` names them at once."""

from __future__ import annotations

from pathlib import Path

SCENARIOS = Path(__file__).parents[1] / "scenarios"
VALIDATIONS = ("trust",)  # studies of the test battery; `all` leaves them out, they take long


def scenarios() -> list[str]:
    """Names of the studies of estimators."""
    return sorted(f.stem for f in SCENARIOS.glob("*.toml") if f.stem not in VALIDATIONS)


def path_of(name: str) -> Path:
    """The file of a scenario: a shipped one by name, or any file."""
    return SCENARIOS / f"{name}.toml" if name in (*scenarios(), *VALIDATIONS) else Path(name)


def offered() -> str:
    """All shipped scenarios, in words."""
    return f"{', '.join([*scenarios(), *VALIDATIONS])}, or all (but {', '.join(VALIDATIONS)})"
