"""Graphs for the audit by what a user types: a file or a function; and the cure of a file, with its proof."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from data.errors import UsageError
from data.formats.graph_file import GraphFile, graph_file_of, read_graph_file, with_information
from wings.audit.audit import DRAWS, examined, places
from wings.audit.cure import LEVELS, Cure, coverage, cure, known
from wings.audit.examined import AuditReport, Second, reported
from wings.audit.files import EDGES, build, built_by, callbacks, optimized, other_starts
from wings.audit.kinds import ODOMETRY
from wings.audit.linear import Graph, Values, name

LARGEST, SMALL = 6000, 2000  # factors up to which other starts are tried, and the graph is solved without a factor
BAD = 4.0  # sum of squares over the degrees of freedom from which they are tried at any size
VERTICES = "the vertices"
FEW = 200  # callbacks, which are slow, up to which it is
DIFFERENT, SHARE = 1e-3, 0.1  # relative difference of errors of two minima; share of the largest motion that is named


@dataclass(frozen=True, eq=False)
class Opened:
    """A graph with its values and audit; `file` if it came from one."""

    report: AuditReport
    graph: Graph
    values: Values
    file: GraphFile | None


def opened(
    place: str,
    optimize: bool | None,
    draws: int = DRAWS,
    seed: int = 0,
    *,
    full: bool = False,
    resolve: int = 0,
    noise: str | None = None,
) -> Opened:
    """The audit of a graph file, or of a `FILE.py:FUNCTION`.

    Args:
        place: what a user types.
        optimize: first; None: a file yes, the values of a function not.
        draws: as of `audit`.
        seed: as of `audit`.
        full: as of `audit`.
        resolve: as of `audit`, of a small graph.
        noise: as of `read_graph_file`.
    """
    script, _, function = place.rpartition(":")
    with threadpool_limits(1):
        if script.endswith(".py") and function.isidentifier():
            graph, values = built_by(place)
            return Opened(
                _audit(graph, values, None, bool(optimize), draws, seed, full, resolve)[0], graph, values, None
            )
        return _of_file(
            read_graph_file(Path(place), noise), optimize is not False, draws, seed, full=full, resolve=resolve
        )


def _of_file(
    file: GraphFile,
    optimize: bool,
    draws: int,
    seed: int,
    near: Values | None = None,
    *,
    full: bool = False,
    resolve: int = 0,
) -> Opened:
    graph, values, names = build(file)
    if near is not None:
        values.update(known(near, values))
    ends = _ends(file, graph, values) if near is None and optimize else {}
    if ends:  # of several minima the lowest is examined
        lowest = min(map(graph.error, ends.values()))
        values = next(v for v in ends.values() if graph.error(v) - lowest < DIFFERENT * max(1.0, lowest))
    report, values = _audit(graph, values, names, optimize and not ends, draws, seed, full, resolve)
    unread = tuple(f"{count} {tag}" for tag, count in file.other.items())
    return Opened(replace(report, minima=_minima(ends, graph, values, report), unread=unread), graph, values, file)


def _ends(file: GraphFile, graph: Graph, values: Values) -> dict[str, Values]:
    """Where the optimizer ends, by start: the vertices, and other starts if the graph is small or fits badly."""
    first = optimized(graph, values)
    ends = {VERTICES if file.poses else EDGES: first}
    rows, unknowns = sum(graph.at(i).dim() for i in range(graph.size())), sum(values.dims().values())
    if graph.size() <= LARGEST or 2.0 * graph.error(first) > BAD * max(rows - unknowns, 1):
        for start, begin in other_starts(file, first).items():
            ends[start] = optimized(graph, begin)
    return ends


def _minima(ends: dict[str, Values], graph: Graph, ours: Values, report: AuditReport) -> tuple[Second, ...]:
    """Each other minimum once."""
    out: list[Second] = []
    lowest = graph.error(ours)
    for start, other in ends.items():
        error = graph.error(other)
        if not any(
            abs(error - known) < DIFFERENT * max(1.0, min(known, error)) for known in (lowest, *(s.error for s in out))
        ):
            keys, place = report.audit.f.system.keys, report.audit.place
            apart = np.nan_to_num(np.linalg.norm(places(other, keys) - place, axis=1))
            most = int(np.argmax(apart))
            far = int((apart > SHARE * apart.max(initial=0.0)).sum())
            out.append(Second(start, error, lowest, far, name(keys[most]), float(apart[most])))
    return tuple(out)


def _audit(
    graph: Graph,
    values: Values,
    names: list[str] | None,
    optimize: bool,
    draws: int,
    seed: int,
    full: bool,
    resolve: int = 0,
) -> tuple[AuditReport, Values]:
    values = optimized(graph, values) if optimize else values
    a = examined(graph, values, names, draws, seed, full=full)
    small = graph.size() <= SMALL and callbacks(graph) <= FEW
    return reported(a, graph, values, resolve if small else 0), values


LEAVE_OUT, ROBUST = "leave-out", "robust"
"""What becomes of rejected factors."""


def cured(before: Opened, out: Path, draws: int = DRAWS, seed: int = 0, rejected: str = LEAVE_OUT) -> pd.DataFrame:
    """Write the graph with variance components applied and rejected factors cured; a row before, one after each way.

    `rejected`: of the graph that is written, what becomes of rejected factors. Raises UsageError where the graph is of
    no file, DataError if what is left out leaves a part without a factor.
    """
    if before.file is None:
        raise UsageError(f"--rescale {out}: only a graph file can be written; a .g2o or .graph is needed")
    with threadpool_limits(1):
        rows = [_row("before", before, Cure({}, set(), {}))]
        for way in (LEAVE_OUT, ROBUST):
            made = cure(before.file, before.report.audit, before.values, robust=way == ROBUST)
            text = with_information(before.file, made.information, made.left_out)
            if way == rejected:
                out.write_text(text, encoding="utf-8", newline="\n")
            after = _of_file(graph_file_of(out, text), True, draws, seed, before.values)
            rows.append(_row(f"after, {way}", after, made))
    return pd.DataFrame(rows)


def _row(title: str, o: Opened, made: Cure) -> dict[str, object]:
    a = o.report.audit
    loops = np.flatnonzero(a.kinds.loops)
    if not len(loops):  # observations of landmarks close the loops
        odometry = [k for k, each in enumerate(a.kinds.names) if each.startswith(ODOMETRY)]
        two = np.array([len(keys) == 2 for keys in a.keys])
        loops = np.flatnonzero(two & ~np.isin(a.kinds.of, odometry))
    share, count = coverage(o.graph, o.values, loops)
    chi2 = float(np.nansum(a.factors.chi2))
    return {
        "graph": title, "factors": int(np.isfinite(a.factors.chi2).sum()), "left_out": len(made.left_out),
        "robust": len(made.robust),
        "chi2_per_freedom": chi2 / max(a.freedom, 1), "rejected": int((a.p_family < 0.05).sum()),
        "loops_predicted": count,
        **{f"coverage_{100 * level:.0f}": float(each) for level, each in zip(LEVELS, share, strict=True)},
    }  # fmt: skip
