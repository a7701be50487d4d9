"""g2o graphs in the plane as open logs, and logs and runs as g2o graphs."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from data.convert import TEXTS, said_of

if TYPE_CHECKING:
    from data.command import Add
    from data.log import Log

KINDS = ("g2o",)
SUFFIX = ".g2o"
TORO = (".graph", ".toro")


def add_parsers(add: Add, *, parameters: bool) -> None:
    """The parser of `g2o`; `parameters` is unused."""
    sub = add("g2o", **said_of("g2o"))
    says = TEXTS["g2o"]["says"]
    sub.add_argument("source", metavar="SOURCE", help=says["source"])
    sub.add_argument("out", metavar="OUT", type=Path, help=f"log folder to write, or {SUFFIX} file")
    sub.add_argument("--true", action="store_true", help="of a graph: its vertices are the true values")
    sub.add_argument("--noise", choices=("information", "covariance", "root"), help=says["noise"])
    sub.add_argument("--run", metavar="FOLDER", type=Path, help=says["run"])


def convert(args: argparse.Namespace) -> Log | str:
    """The log of the graph, or a sentence about the graph that was written."""
    from data.errors import DataError, UsageError
    from data.formats.recognize import edges_of

    if args.source.endswith((SUFFIX, *TORO)) or any(edges_of(Path(args.source))):
        from data.formats.g2o import log_of, read_graph

        if args.run is not None:
            raise UsageError("--run: SOURCE is a graph already; a log is needed")
        return log_of(args.out.absolute().name, read_graph(Path(args.source), args.noise), true=args.true)
    from data.formats.g2o import POSE_IDS, graph_text, labelled, of_result, pose_ids
    from data.logs import open_log
    from data.terminal import counted

    if args.out.suffix != SUFFIX:
        raise UsageError(f"{args.out}: a log is written as a file {SUFFIX}; only a graph (SOURCE{SUFFIX}) as a log")
    if args.true:
        raise UsageError("--true: SOURCE is a log; a graph is needed")
    log = open_log(args.source)
    estimate = labelled(log) if args.run is None else of_result(log, args.run)
    given, closures, fixes = log.source.get(POSE_IDS), log.recorded.closures, log.recorded.fixes
    kept = isinstance(given, list) and len(given) == len(log.recorded)
    ids = given if isinstance(given, list) and kept else pose_ids(len(log.recorded), estimate)
    text = graph_text(log.recorded, estimate, ids)
    try:
        args.out.write_text(text, encoding="utf-8", newline="")
    except OSError as error:
        raise DataError.at(args.out, f"cannot be written: {error.strerror}") from error
    paired = int((estimate.of >= 0).sum())
    left = len(estimate.of) - paired
    sentence = f"{args.out}: {len(log.recorded)} poses, {len(estimate.landmark)} landmarks, {paired} observations"
    if closures is not None:
        sentence += f", {counted(len(closures), 'closure')}"
    if fixes is not None:
        sentence += f"; {counted(len(fixes), 'fix', 'fixes')} omitted"
    if log.truth.relations is not None:
        sentence += f"; {counted(len(log.truth.relations), 'reference relation')} omitted"
    if not kept and ids[0]:
        sentence += f"; poses have the ids {ids[0]} to {ids[-1]}, as landmarks keep theirs"
    return sentence + (f"; {left} observations of no landmark omitted" if left else "")
