"""Rows of files that are no text: packed ones, spreadsheets, Parquet, tracks of GPS receivers (GPX, NMEA), as CSV."""

import csv
import gzip
import importlib
import io
import math
import re
import tomllib
import zipfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from data.csv_table import is_number
from data.errors import DataError

MOST = 2**30  # bytes of an unpacked file
OTHERS = {  # What files are that have no rows of ours, by their first bytes
    b"\x89HDF": "HDF5 (named .h5 it is read as arrays)", b"<?xml": "XML other than GPX", b"SQLite": "a database",
    b"\xd0\xcf\x11\xe0": "an old spreadsheet (.xls)",
}  # fmt: skip
DAY = 86400.0  # s
ECHOED = tomllib.loads(Path(__file__).with_name("echoed.toml").read_text(encoding="utf-8"))
"""Names of the columns that `ros2 topic echo --csv` prints, by type of message; NAME*9 are nine of them."""


def file_and_word(path: Path) -> tuple[Path, str]:
    """The file of FILE:WORD, and the word that its rows hold; empty: all rows."""
    parts = [] if path.exists() else str(path).rstrip(":").split(":")
    each = ((Path(":".join(parts[:-k])), ":".join(parts[-k:])) for k in range(1, len(parts)))
    return next((pair for pair in each if pair[0].is_file()), (path, ""))


def unwrapped(path: Path, content: bytes, word: str) -> tuple[bytes, str]:
    """Contents of a file as text, and the word that its rows hold, empty where it named the sheet. DataError for what
    cannot be read, or needs a package that is not installed.
    """
    if content.startswith(b"\x1f\x8b"):
        try:
            content = gzip.GzipFile(fileobj=io.BytesIO(content)).read(MOST)
        except (OSError, EOFError) as error:
            raise DataError.at(path, f"cannot be unpacked: {error}") from None
    if content.startswith(b"PK\x03\x04"):
        return _of_archive(path, content, word)
    if content.startswith(b"PAR1"):
        table = package(path, "pandas", "pyarrow").read_parquet(io.BytesIO(content)).reset_index()
        return table.to_csv(index=False).encode(), word
    if b"<gpx" in content[:2000]:
        return csv_of(("t", "lat", "lon", "alt"), _of_gpx(content.decode("utf-8-sig", "replace"))), word
    if re.search(rb"(^|[\s,;])\$G[A-Z](GGA|RMC),", content[:20000]):
        return csv_of(("t", "lat", "lon", "alt"), _of_nmea(content.decode("latin-1"))), word
    if other := next((what for start, what in OTHERS.items() if content.startswith(start)), ""):
        raise DataError.at(path, f"{other}, not a text file; save its rows as CSV")
    return content, word


def csv_of(names: Sequence[str], rows: Iterable[Sequence[Any]]) -> bytes:
    """Rows below names, as text."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([names, *rows])
    return text.getvalue().encode()


def package(path: Path, name: str, install: str = "") -> Any:
    """A package that reads a file; `install`: what installs what it needs. DataError without it."""
    try:
        importlib.import_module(install if install == "pyarrow" else name)
        return importlib.import_module(name)
    except ImportError:
        what = f"this format needs `pip install {install or name}`, or save its rows as CSV"
        raise DataError.at(path, what) from None


def _of_archive(path: Path, content: bytes, word: str) -> tuple[bytes, str]:
    """The sheet of a spreadsheet, the first unless `word` names one, or the only file of a zip."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            files = [info for info in archive.infolist() if not info.is_dir()]
            if "xl/workbook.xml" not in archive.namelist():
                if len(files) == 1 and files[0].file_size < MOST:
                    return unwrapped(path, archive.read(files[0]), word)
                some = ", ".join(info.filename for info in files[:6])
                raise DataError.at(path, f"an archive of {len(files)} files ({some}); unpack it and name one")
    except (zipfile.BadZipFile, RuntimeError) as error:
        raise DataError.at(path, f"cannot be unpacked: {error}") from None
    book = package(path, "openpyxl").load_workbook(io.BytesIO(content), read_only=True, data_only=True)
    sheets = [sheet for sheet in book.worksheets if sheet.title == word] or book.worksheets[:1]
    several = len(book.worksheets) > 1 and sheets[0].title != word
    said = f"sheet {sheets[0].title} of {len(book.worksheets)} (FILE:SHEET names another)\n" * several
    rows = ([v.isoformat() if hasattr(v, "isoformat") else v for v in r] for r in sheets[0].iter_rows(values_only=True))
    table = [r for r in rows if any(v is not None for v in r)]
    return said.encode() + csv_of(table[0] if table else (), table[1:]), "" if sheets[0].title == word else word


def _of_gpx(text: str) -> list[tuple[str, str, str, str]]:
    """Stamp, latitude, longitude and height of the points of tracks (or ways), blank where there is none."""
    found = []
    for tag, rest in re.findall(r"<(?:trkpt|rtept|wpt)\s([^>]*)>(.*?)</(?:trkpt|rtept|wpt)>", text, re.DOTALL):
        place = dict(re.findall(r"(lat|lon)\s*=\s*[\"']([^\"']*)", tag))
        more = dict(re.findall(r"<(time|ele)>\s*([^<]*?)\s*<", rest))
        found.append((more.get("time", ""), place.get("lat", ""), place.get("lon", ""), more.get("ele", "")))
    return found


def _of_nmea(text: str) -> list[tuple[Any, ...]]:
    """Stamp, latitude, longitude and height of sentences GGA with a fix, else of RMC."""
    kind = "GGA" if "GGA," in text else "RMC"
    found, clocks, day = list[tuple[Any, ...]](), list[tuple[float, float]](), 0.0
    for line in text.splitlines():
        before, dollar, sentence = line.partition("$")
        f = sentence.split(",")
        at = 1 if kind == "RMC" else 0
        if not dollar or f[0][2:] != kind or len(f) < 10 or not all(map(is_number, (f[1], f[2 + at], f[4 + at]))):
            continue
        if f[6 if kind == "GGA" else 2] in ("0", "V"):
            continue
        clock = float(f[1])
        t = day + clock // 10000 * 3600.0 + clock // 100 % 100 * 60.0 + clock % 100
        if clocks and t < clocks[-1][0] - DAY / 2.0:
            day, t = day + DAY, t + DAY
        stamps = re.findall(r"\d+\.?\d*", before)
        clocks.append((round(t, 6), float(stamps[0]) if len(stamps) == 1 else math.nan))
        place = []
        for value, side in ((f[2 + at], f[3 + at]), (f[4 + at], f[5 + at])):
            whole = math.floor(float(value) / 100.0)
            place.append((-1.0 if side in "SW" else 1.0) * (whole + (float(value) - 100.0 * whole) / 60.0))
        found.append((*map(repr, place), f[9] if kind == "GGA" else ""))
    way, own_way = (last - first for first, last in zip(clocks[0], clocks[-1], strict=True)) if clocks else (0.0, 0.0)
    digits = math.log10(own_way / way) if own_way > 0.0 < way else 0.0
    own = not any(math.isnan(b) for _, b in clocks) and min(abs(digits - n) for n in (0, 3, 6, 9)) < 0.1
    return [(clock[own], *place) for clock, place in zip(clocks, found, strict=True)]


def echoed_names(first: str) -> str:
    """A header for rows of `ros2 topic echo --csv`, by the first of them; empty for any other row."""
    fields = first.split(",")
    for layout in ECHOED.values():
        names = [
            f"{n.partition('*')[0]}{k}" if "*" in n else n for n in layout for k in range(int(n.partition("*")[2] or 1))
        ]
        words = [n.endswith(("frame_id", "child_frame_id")) for n in names]
        if len(fields) == len(names) and all(word != is_number(f) for word, f in zip(words, fields, strict=True)):
            return ",".join(names)
    return ""
