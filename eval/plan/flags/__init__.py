"""What may be asked: the table of flags, read from a command line and config files into checked options."""

from pathlib import Path

TEXTS = Path(__file__).parent / "texts"


def texts_of(command: str) -> tuple[str, str]:
    """What the help of a command says before its flags, and its examples behind them: `texts/<command>.txt`."""
    about, _, examples = (TEXTS / f"{command}.txt").read_text(encoding="utf-8").partition("\n\nexamples:")
    return about, f"examples:{examples.rstrip()}"
