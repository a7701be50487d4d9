"""Graphs for the audit by what a user types: a file or a function; and the cure of a file."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import gtsam
import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from data.errors import UsageError
from data.formats.graph_file import Edge, GraphFile, graph_file_of, read_graph_file, with_information
from data.origin import Origin
from data.se2 import Array
from eval.replay.external.adapter import load
from eval.replay.external.spec import settled
from wings.audit.audit import DRAWS, LOG_FAMILY, TURNS, Audit, Told, examined, places, unheard
from wings.audit.examined import AuditReport, Second, reported
from wings.audit.files import EDGES, LAST_FIRST, across, build, optimized, other_starts, point_key, seen, with_landmarks
from wings.audit.linear import Graph, Values, name, value_of

LARGEST, SMALL = 6000, 2000  # factors up to which other starts are tried, and the graph is solved without a factor
BAD = 4.0  # sum of squares over the degrees of freedom from which they are tried at any size
FAR_OFF = 10.0  # times as bad: vertices than BAD, and than the best other start, from which a large graph begins there
VERTICES = "the vertices"
DIFFERENT, SHARE = 1e-3, 0.1  # relative difference of errors of two minima; share of the largest motion that is named


@dataclass(frozen=True, eq=False)
class Opened:
    """A graph with its values and audit; `file` if it came from one."""

    report: AuditReport
    graph: Graph
    values: Values
    file: GraphFile | None


def opened(
    place: str, optimize: bool | None, draws: int = DRAWS, seed: int = 0, *, resolve: int = 0, noise: str | None = None,
    steps: int = TURNS, told: Told = unheard, more: Sequence[str] = (),
) -> Opened:  # fmt: skip
    """The audit of a graph file, or of a `FILE.py:FUNCTION`; `noise`, `more` as of `read_graph_file`, others of `audit`
    and `examined`. `optimize` first; None: a file yes, the values of a function not. `resolve` is of a small graph.
    """
    script, _, function = place.rpartition(":")
    audit = partial(examined, draws=draws, seed=seed, steps=steps, told=told)
    with threadpool_limits(1):
        if not (script.endswith(".py") and function.isidentifier()):
            file = read_graph_file(Path(place), noise, more=[Path(other) for other in more])
            return _of_file(file, audit, resolve, optimize=optimize is not False, told=told)
        made = load(settled("GRAPH", place, "maintenance")).thing()
        match made:
            case (gtsam.NonlinearFactorGraph() as graph, gtsam.Values() as values):
                values = optimized(graph, values) if optimize else values
            case _:
                raise UsageError(f"{place} returned {type(made).__name__}; (NonlinearFactorGraph, Values) is needed")
        report = replace(_reported(audit(graph, values, None), graph, values, resolve), optimized=bool(optimize))
        return Opened(report, graph, values, None)


def _reported(a: Audit, graph: Graph, values: Values, resolve: int) -> AuditReport:
    return reported(a, graph, values, resolve if graph.size() <= SMALL else 0)


def _of_file(
    file: GraphFile, audit: Callable[..., Audit], resolve: int = 0, *, optimize: bool = True, told: Told = unheard
) -> Opened:
    graph, values, names = build(file := with_landmarks(file))
    told("opened", factors=graph.size(), variables=values.size())
    ends = _ends(file, graph, values) if optimize else {}  # of several minima the lowest is examined
    values, either = across(file, graph, min(ends.values(), key=graph.error)) if ends else (values, ())
    if optimize:
        told("optimized", chi2=2.0 * graph.error(values))
    report = _reported(audit(graph, values, names), graph, values, resolve)
    unread = tuple(f"{count} {tag}" for tag, count in file.other.items())
    minima = _minima(ends, graph, values, report)
    (fixed,) = file.fixed if len(file.fixed) == 1 and not file.priors else (None,)
    held = 0 if fixed is None else values.dims().get(fixed if values.exists(fixed) else point_key(fixed), 0)
    met = tuple(name(key) for key, some in seen(file).items() if some[0].ends[1] not in file.points)
    space = not file.space and any(e.origin is Origin.STATED and len(e.measured) == 7 for e in file.edges)
    report = replace(report, minima=minima, unread=unread, met=met, either=either, held=held, optimized=optimize)
    relations = [e.information for e in file.edges if e.origin is Origin.STATED and len(e.information) > 2]
    alike = all(np.array_equal(P, P[0, 0] * np.eye(len(P))) for P in relations)  # one number for m and rad
    even = tuple(sorted({float(P[0, 0]) for P in relations})) if alike else ()
    report = replace(report, even=even, space=space, untagged=any(part[2] for part in file.parts))
    return Opened(report, graph, values, file)


def _ends(file: GraphFile, graph: Graph, values: Values) -> dict[str, Values]:
    """Where the optimizer ends, by start; of a large graph with far worse vertices from the other start alone."""
    poor = BAD * max(sum(graph.at(i).dim() for i in range(graph.size())) - sum(values.dims().values()), 1)
    if graph.size() > LARGEST and 2.0 * graph.error(values) > FAR_OFF * poor:
        starts = other_starts(file, values)
        near = min(starts, key=lambda start: graph.error(starts[start]), default="")
        if near and FAR_OFF * graph.error(starts[near]) < graph.error(values):
            return {near: optimized(graph, starts[near])}
    first, small = VERTICES if file.poses else EDGES, graph.size() <= LARGEST
    starts = {first: values} | (other_starts(file, values) if small else {})
    ends, least = dict.fromkeys(starts, values), np.inf
    for start in reversed(starts):  # from the chordal start first: others that cannot get as low end early
        ends[start] = optimized(graph, starts[start], least)
        least = min(least, graph.error(ends[start]))
    if not small and 2.0 * least > poor:
        ends |= {start: optimized(graph, begin) for start, begin in other_starts(file, ends[first]).items()}
    return ends


def _minima(ends: dict[str, Values], graph: Graph, ours: Values, report: AuditReport) -> tuple[Second, ...]:
    """Each other minimum once."""
    out: list[Second] = []
    lowest = graph.error(ours)
    for start, other in ends.items():
        error = graph.error(other)
        if not any(abs(error - e) < DIFFERENT * max(1.0, min(e, error)) for e in (lowest, *(s.error for s in out))):
            keys, place = report.audit.f.system.keys, report.audit.place
            apart = np.nan_to_num(np.linalg.norm(places(other, keys) - place, axis=1))
            most = int(np.argmax(apart))
            far = int((apart > SHARE * apart.max(initial=0.0)).sum())
            out.append(Second(start, error, lowest, far, name(keys[most]), float(apart[most])))
    return tuple(out)


def cured(before: Opened, out: Path, draws: int = DRAWS, seed: int = 0, *, robust: bool = False) -> pd.DataFrame:
    """Write the graph with variance components applied and rejected factors left out, or `robust`; a row before and
    one after. UsageError: a graph of no file. DataError: a part would have no factor.
    """
    if before.file is None:
        raise UsageError(f"--rescale {out}: only a graph file can be written; a .g2o or .graph is needed")
    with threadpool_limits(1):
        made = cure(before.file, before.report.audit, before.values, robust=robust)
        text = with_information(before.file, made.information, made.left_out)
        out.write_text(text, encoding="utf-8", newline="\n")
        noise = before.file.space or before.file.noise or None
        after = _of_file(graph_file_of(out, text, noise), partial(examined, draws=draws, seed=seed))
    return pd.DataFrame([_row("before", before.report.audit), _row("after", after.report.audit, made)])


def _row(title: str, a: Audit, made: "Cure | None" = None) -> dict[str, object]:
    return {
        "graph": title, "factors": int(np.isfinite(a.factors.chi2).sum()),
        "left_out": len(made.left_out) if made else 0, "robust": len(made.robust) if made else 0,
        "chi2_per_freedom": float(np.nansum(a.factors.chi2)) / max(a.freedom, 1),
        "rejected": int((a.log_p_family < LOG_FAMILY).sum()),
    }  # fmt: skip


ROUNDS = 7  # of rescaling and leaving out in turn, at most; the last rescales


@dataclass(frozen=True)
class Cure:
    """What a cure changes: information (d, d) of edges by number, edges left out, and weights of those made robust."""

    information: dict[int, Array]
    left_out: set[int]
    robust: dict[int, float]


def cure(file: GraphFile, a: Audit, values: gtsam.Values, *, robust: bool = False) -> Cure:
    """Components and rejected factors in turn, as each disturbs the other: first rescaled, then the rejected left out.

    `a` is the audit of the graph at `values`, which gross errors may have bent: the lowest minimum of what is left is
    taken each time. `robust`: keep rejected factors under Cauchy's loss; their information is multiplied by their
    weight at the end, so that the file, which has no losses, has the optimum of the robust graph.
    """
    kept, edges, loose = np.arange(len(file.edges)), list(file.edges), set[int]()
    named = set(a.wrong.tolist()) if a.searched else set()
    kind = [a.kinds.names[k] for k in a.kinds.of[: len(edges)].tolist()]  # a loss makes no other kind
    for turn in range(ROUNDS):
        if turn % 2 == 0:
            scaled = zip(edges, rescaled(edges, a), strict=True)
            edges = [replace(e, information=each, origin=Origin.INFERRED) for e, each in scaled]
        else:
            rejected = set(a.wrong.tolist()) - loose
            if turn == 1 and 0 < len(named) < len(rejected):  # fewer errors explain the same
                rejected = named
            rejected = {i for i in rejected if i < len(edges)}
            if not a.rejected:
                break
            if not rejected:
                continue
            if robust:
                loose |= rejected
            else:
                kept = np.delete(kept, sorted(rejected))
                edges = [edge for i, edge in enumerate(edges) if i not in rejected]
        sound = replace(file, edges=[edge for i, edge in enumerate(edges) if i not in loose])
        graph, start, names = build(sound)
        for key in start.dims():
            start.update(key, value_of(values, key))
        values = min(_ends(sound, graph, start).values(), key=graph.error)
        if loose:
            graph, start, names = build(replace(file, edges=edges), loose)
            start.update(values)
            values = optimized(graph, start)
        a = examined(graph, values, [kind[i] for i in kept.tolist()] + names[len(edges) :], draws=0)
    weight = {i: float(a.factors.weight[i]) for i in loose}
    information = {int(i): e.information * weight.get(k, 1.0) for k, (i, e) in enumerate(zip(kept, edges, strict=True))}
    return Cure(information, set(range(len(file.edges))) - set(information), weight)


def rescaled(edges: Sequence[Edge], a: Audit) -> list[Array]:
    """Information (d, d) of each edge with its components applied, of the axes of its kind or of the whole kind."""
    every, out = np.nan_to_num(a.by_axis.component, nan=1.0), []
    for i, edge in enumerate(edges):
        component = np.broadcast_to(every[a.axis[:, 0] == a.kinds.of[i]], len(edge.information))
        component = component[LAST_FIRST] if len(component) == 6 else component  # of the file, translation first
        root = 1.0 / np.sqrt(component)
        out.append(edge.information * root[:, None] * root)
    return out
