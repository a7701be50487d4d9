"""Read a result in any format, recognized by content; a header that names columns decides first."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from data.csv_table import is_number
from data.errors import DataError, UsageError
from data.formats.results import pose_lines, tables
from data.formats.results.bags import is_bag, read_bag
from data.formats.results.columns import header_names, read_named
from data.formats.results.path import GivenPath, Manner
from data.formats.results.square import POSE, header_of
from data.formats.results.text import Text, read_text

PLAIN = Manner()
ACCEPTED = (
    "a CSV with the columns t,x,y,theta, TUM (8 columns), TUM with covariance (29 or 44), SQUARE, OpenVINS (20), EuRoC "
    "(commas, ns), KITTI poses (12), columns named in a header, or a ROS bag"
)
WIDTHS: dict[int, Callable[[Text, Manner], GivenPath]] = {
    8: pose_lines.read_tum,
    29: pose_lines.read_wide,
    44: pose_lines.read_wide,
    20: pose_lines.read_openvins,
    12: pose_lines.read_kitti,
}


def read_path(name: str, manner: Manner = PLAIN) -> GivenPath:
    """The trajectory in a file, or in a bag (`FILE` or `FILE:/TOPIC`).

    Raises DataError for an unknown format or invalid value, UsageError for missing or inapplicable options.
    """
    path, topic = _with_topic(name)
    if is_bag(path):
        found, cov, times = read_bag(path, topic, manner), False, False
    elif path.is_dir():
        raise DataError.at(path, "a folder; a result is a file, or the folder of a run with online.csv or final.csv")
    else:
        text = read_text(path)
        read = _reader(text)
        found, cov, times = read(text, manner), read is pose_lines.read_tum, read is pose_lines.read_kitti
    if manner.cov is not None and not cov:
        raise UsageError(f"--cov {manner.cov}: {name} is {found.kind}; a TUM file of 8 columns is needed")
    if manner.times is not None and not times:
        raise UsageError(f"--times {manner.times}: {name} is {found.kind}; KITTI poses are needed")
    for flag, value in (("--cov-frame", manner.frame), ("--cov-order", manner.order)):
        if value is not None and found.covariance is None:
            raise UsageError(f"{flag} {value}: {name} has no covariance")
    return found


def _with_topic(name: str) -> tuple[Path, str | None]:
    """File and topic of `FILE:/TOPIC`; a file name may hold a colon, too."""
    file, colon, topic = name.partition(":/")
    if colon and not Path(name).exists() and is_bag(Path(file)):
        return Path(file), f"/{topic}"
    return Path(name), None


def _reader(text: Text) -> Callable[[Text, Manner], GivenPath]:
    """The reader of a text's format."""
    if "FORMAT" in header_of(text).values:
        return pose_lines.read_square
    if tables.is_plane(text):
        return tables.read_plane
    first = text.fields[0]
    columns = header_names(text)
    if columns is not None and not _is_usual(columns.order, columns.named, len(first), text):
        return partial(read_named, columns=columns)
    if tables.is_euroc(text):
        return tables.read_euroc
    if not text.commas and len(first) in WIDTHS and is_number(first[0]):
        return WIDTHS[len(first)]
    shown = f"{len(first)} fields, {','.join(first)[:40]!r}"
    raise DataError.at(text.path, f"{shown}: no known trajectory format; {ACCEPTED} is needed", line=text.line[0])


def _is_usual(order: tuple[str, ...], named: int, width: int, text: Text) -> bool:
    """Whether a header names the columns of TUM in their order, which the reader of that format reads."""
    return order == POSE and named == len(POSE) and width in (8, 29, 44) and not text.commas
