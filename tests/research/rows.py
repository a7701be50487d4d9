"""Rows of a study, a named tuple each, in a CSV file that an interrupted study goes on with."""

import csv
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

Kept = TypeVar("Kept", bound=tuple[Any, ...])


def read(kind: type[Kept], path: Path) -> list[Kept]:
    """The rows of a file; none if it is not there. A last line that was cut off is left out."""
    if not path.exists():
        return []
    types = get_type_hints(kind)
    lines = csv.DictReader(_whole(path.read_bytes()).decode().splitlines())
    return [
        kind(**{f: (text == "True") if types[f] is bool else types[f](text) for f, text in row.items()})
        for row in lines
    ]


def append(row: Any, path: Path) -> None:
    """The row at the end of the file, which is begun with the names of the columns; a line cut off there goes."""
    before = _whole(path.read_bytes()) if path.exists() else b""
    with path.open("w", newline="", encoding="utf-8") as file:
        file.write(before.decode())
        writer = csv.writer(file, lineterminator="\n")
        if not before:
            writer.writerow(row._fields)
        writer.writerow([f"{v:.8g}" if isinstance(v, float) else v for v in row])


def _whole(content: bytes) -> bytes:
    """A file without a last line that was cut off."""
    return content[: content.rfind(b"\n") + 1]
