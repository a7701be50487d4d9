"""A result by its file: the format is recognized by content, and read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from data.errors import DataError, UsageError
from data.results import kitti, tables, tum
from data.results.bag import is_bag, read_bag
from data.results.lines import Text, is_number, read_text
from data.results.path import GivenPath, Manner
from data.results.square import header_of

AS_SAID = Manner()
"""Nothing is said beyond the file."""
ACCEPTED = (
    "a CSV with the columns t,x,y,theta, TUM (8 columns), TUM with covariance (29), SQUARE, EuRoC (commas, ns), KITTI "
    "poses (12), or a ROS bag"
)


def read_path(name: str, manner: Manner = AS_SAID) -> GivenPath:
    """The trajectory in a file, or in a bag (`FILE` or `FILE:/TOPIC`).

    Raises:
        DataError: not one of the formats, or a value in it that is wrong, with file and line.
        UsageError: what the file does not say of itself was not said (stamps, topic), or what it does not need was.
    """
    path, topic = _with_topic(name)
    if is_bag(path):
        found, cov, times = read_bag(path, topic, manner), False, False
    elif path.is_dir():
        raise DataError.at(path, "a folder; a result is a file, or the folder of a run with online.csv or final.csv")
    else:
        text = read_text(path)
        read = _reader(text)
        found, cov, times = read(text, manner), read is tum.read_tum, read is kitti.read_kitti
    if manner.cov is not None and not cov:
        raise UsageError(f"--cov {manner.cov}: for a TUM file of 8 columns; {name} is {found.kind}")
    if manner.times is not None and not times:
        raise UsageError(f"--times {manner.times}: for KITTI poses; {name} is {found.kind}")
    if manner.frame is not None and found.covariance is None:
        raise UsageError(f"--cov-frame {manner.frame}: {name} has no covariance")
    return found


def _with_topic(name: str) -> tuple[Path, str | None]:
    """`FILE:/TOPIC` in its parts; the name of a file may itself hold a colon."""
    file, colon, topic = name.partition(":/")
    if colon and not Path(name).exists() and is_bag(Path(file)):
        return Path(file), f"/{topic}"
    return Path(name), None


def _reader(text: Text) -> Callable[[Text, Manner], GivenPath]:
    """Which format a text is in."""
    if "FORMAT" in header_of(text).values:
        return tum.read_square
    if tables.is_plane(text):
        return tables.read_plane
    if tables.is_euroc(text):
        return tables.read_euroc
    first = text.fields[0]
    by_width = {8: tum.read_tum, 29: tum.read_wide, 12: kitti.read_kitti}
    if not text.commas and len(first) in by_width and is_number(first[0]):
        return by_width[len(first)]
    shown = f"{len(first)} fields, {','.join(first)[:40]!r}"
    raise DataError.at(text.path, f"{shown}: not a trajectory that is known here; {ACCEPTED}", line=text.line[0])
