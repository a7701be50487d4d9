"""The Victoria Park log bundled with gtsam, as an open log."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from data.convert.parsers import Add
    from data.log import Log


KINDS = ("victoria-park",)


def add_parsers(add: Add, *, parameters: bool) -> None:
    """The parser of `victoria-park`; `parameters` is unused."""
    sub = add(
        "victoria-park",
        help="the Victoria Park log that gtsam bundles",
        description="Victoria Park: 6969 frames of a car among trees, from the installed gtsam wheel. No ground truth.",
        epilog="example:\n  python -m data.convert victoria-park logs/victoria",
    )
    sub.add_argument("out", metavar="OUT", type=Path, help="log folder to write")


def convert(args: argparse.Namespace) -> Log:
    """The log, all of it."""
    from data.formats.recordings.victoria_park import load_victoria_park

    return load_victoria_park()
