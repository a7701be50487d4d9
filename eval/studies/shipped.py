"""The shipped scenarios. Imports nothing heavy, so that `--help` names them at once."""

from pathlib import Path

SCENARIOS = Path(__file__).parents[1] / "scenarios"


def scenarios() -> list[str]:
    """Names of the studies of estimators."""
    return sorted(f.stem for f in SCENARIOS.glob("*.toml"))


def path_of(name: str) -> Path:
    """The file of a scenario: a shipped one by name, or any file."""
    return SCENARIOS / f"{name}.toml" if name in scenarios() else Path(name)
