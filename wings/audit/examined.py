"""The audit of a factor graph for users: tables, words, a figure, and the page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from data.inputs import IntArray
from data.se2 import Array, BoolArray
from eval.report.words import as_sentence, say
from wings.audit.audit import DRAWS, LOG_FAMILY, Audit, Statistics, examined, left_out
from wings.audit.factors import FAMILY, UNCHECKED, log_p_of
from wings.audit.kinds import AXES, Grouping, plain_noise
from wings.audit.linear import Graph, Values, name

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TEN, SHOWN = 10, 6  # rows of the worst factors; names in a sentence
FAR, FAR_SHARE = 9.0, 0.1  # decrease of the sum of squares from which values are no optimum; over the freedom
TINY = 1e-12  # share of a squared sigma, or m, below which a number is rounding
LEAST, FLAT = -8.0, 1e-9  # log10 of the smallest p value with a colour of its own; m of height of a graph in the plane
ALIKE = 1e-3  # relative difference up to which tests are equal: rounding, where little is redundant
NOTHING = 1e-7  # variance component below which its search has run into its lower bound
SUSPICION = ("#500000", "#d7301f", "#f0a030", "#8899aa")
LOG10 = "log10_"
NARROW = ["factor", "keys", "kind", "wrong", "redundancy", "deleted", "rank", "p", "p_family", "minimal_error"]
NARROW += ["influence_m", LOG10 + "p", LOG10 + "p_family"]
"""Columns that fit a page, p values with their logarithms; factors.csv has all."""


class Second(NamedTuple):
    """Another minimum: where the optimizer started, both errors, and where they differ."""

    start: str
    error: float
    ours: float
    apart: int
    most: str
    metres: float


class Question(NamedTuple):
    """A convention that a kind of factors may have: `found` is what the components say, `expected` what it implies."""

    kind: str
    convention: str
    found: float
    error: float
    expected: float


class Scale(NamedTuple):
    """A wrong variance in a sentence."""

    name: str
    kind: str
    value: float
    error: float
    sigma: float

    @property
    def vanishes(self) -> bool:
        """Whether the component is at the bound of its search, and no estimate."""
        return self.value < NOTHING

    @property
    def vague(self) -> bool:
        """Whether the residuals do not tell how small the component is."""
        return self.value < min(self.error, 1.0)

    def told(self, large: bool) -> tuple[bool, bool, bool, float]:
        """Sort key of what to tell first, where all residuals together are too `large`, or too small."""
        return not self.vanishes, not self.vague, (self.value > 1.0) == large, float(abs(np.log(self.sigma)))


@dataclass(frozen=True, eq=False)
class AuditReport:
    """An audit.

    Columns of `factors`: index, number in the graph; keys, kind, dim; chi2 of the whitened residual; redundancy,
    unchecked; deleted (T), rank, p, p_family (Holm); minimal_error [sigma]; influence_m [m]; p_drawn (draws of the
    graph's own noise); missed_m [m], motion of its own ends by a just missed error; weight (robust); cost; wrong:
    without these, if they are few, no other is rejected; resolved_m, resolved_cost: motion and decrease of the graph
    solved again, NaN where it was not; log10_p, log10_p_family: they rank where p values are 0.
    """

    factors: pd.DataFrame
    kinds: pd.DataFrame  # a row each: n, dim, chi2, redundancy, component, se, sigma_factor, unchecked, p, p_family
    components: pd.DataFrame  # a row for each axis of a kind with diagonal noise
    audit: Audit  # the numbers
    minima: tuple[Second, ...] = ()
    questions: tuple[Question, ...] = ()
    unread: tuple[str, ...] = ()
    met: tuple[str, ...] = ()  # landmarks without a stated place that ranges or bearings alone see
    either: tuple[str, ...] = ()  # of ranges, that fit on both sides of the path
    even: tuple[float, ...] = ()  # information that relations of poses state for m and rad alike, if all do
    space: bool = False  # relations in space are read by gtsam's convention
    untagged: bool = False  # rows without a tag were read by their number of columns
    held: int = 0  # directions of the gauge that a fixed vertex ties
    optimized: bool = False  # whether the optimizer ran first

    @property
    def clusters(self) -> pd.DataFrame:
        """Loops that agree with each other, tested together."""
        a = self.audit
        rows = [(c.factors, c.T, c.rank, c.moved) for c in a.clusters]
        frame = pd.DataFrame(rows, columns=["factors", "deleted", "rank", "influence_m"])
        for place, what, log_p in ((3, "p", [c.log_p for c in a.clusters]), (4, "p_family", a.log_p_cluster)):
            frame.insert(place, what, np.exp(log_p))
            frame[LOG10 + what] = np.array(log_p, float) / np.log(10.0)
        return frame.sort_values(LOG10 + "p", kind="stable", ignore_index=True)

    @property
    def rejected(self) -> bool:
        """Whether a factor or a component is rejected at a family-wise 5 %."""
        return self.audit.rejected

    @property
    def facts(self) -> SimpleNamespace:
        """What the words say."""
        return _facts(self)

    def words(self) -> str:
        """Three sentences: what to trust, what is wrong most, what cannot be known; then what the structure says."""
        facts = self.facts
        lines = [as_sentence(say(f"audit#{part}", a=facts, r=self)) for part in ("trust", "worst", "unknown")]
        found = say("audit#findings", a=facts, r=self).strip()
        return "\n".join([*lines, *([found] if found else [])])

    @property
    def ranked(self) -> pd.DataFrame:
        """The tested factors: the wrong ones first, each part by the p value of the family."""
        tested = self.factors.dropna(subset="p")
        return tested.iloc[np.lexsort((tested[LOG10 + "p"], tested[LOG10 + "p_family"], ~tested["wrong"]))]

    def worst(self, count: int = TEN) -> pd.DataFrame:
        """The factors of least p value, with keys as gtsam prints them."""
        return printable(self.ranked.head(count))

    def figure(self) -> Figure:
        """The graph from above, in space also from the side: by p value, the worst numbered, and by redundancy."""
        from matplotlib.collections import LineCollection
        from matplotlib.colors import LinearSegmentedColormap
        from matplotlib.figure import Figure
        from matplotlib.patheffects import withStroke

        from eval.figures.style import drawing

        place, t = self.audit.place, self.audit.factors
        row = {key: v for v, key in enumerate(self.audit.f.system.keys)}
        some = [i for i, keys in enumerate(self.audit.keys) if len(keys) > 1]
        pairs = [(row[self.audit.keys[i][0]], row[self.audit.keys[i][-1]]) for i in some]
        lines = place[np.array(pairs, np.int64).reshape(-1, 2)]
        log_p = np.clip(np.nan_to_num(t.log_p[some]) / np.log(10.0), LEAST, 0.0)
        share = (t.redundancy[some] / np.maximum(t.dim[some], 1)).clip(0.0, 1.0)
        width = np.where(np.isin(some, self.audit.wrong), 2.5, 0.8)
        drawn = np.flatnonzero(np.isfinite(lines).all((1, 2)))
        at = {some[k]: k for k in drawn.tolist()}
        ten = [at[i] for i in self.ranked.index[:TEN] if i in at]
        suspicion = LinearSegmentedColormap.from_list("suspicion", SUSPICION)
        views = [([0, 1], "y [m]"), ([0, 2], "z [m]")][: 1 + bool(np.nanmax(np.abs(place[:, 2]), initial=0.0) > FLAT)]
        with drawing():
            fig = Figure(figsize=(9.0, 4.2 * len(views)), layout="constrained")
            for of_view, (columns, y) in zip(fig.subplots(len(views), 2, squeeze=False), views, strict=True):
                of_p = (of_view[0], log_p, suspicion, LEAST, 0.0, "log10 of p")
                of_share = (of_view[1], share, "viridis", 0.0, 1.0, "redundancy / dimension")
                for ax, value, cmap, low, high, title in (of_p, of_share):
                    order = drawn[np.argsort(-value[drawn], kind="stable")]
                    shown = list(lines[order][:, :, columns])
                    edges = LineCollection(shown, array=value[order], cmap=cmap, linewidths=width[order])
                    edges.set_clim(low, high)
                    ax.add_collection(edges)
                    ax.autoscale()
                    room = 0.03 * max(ax.dataLim.width, ax.dataLim.height)
                    middles: list[Array] = []
                    for k in ten if value is log_p else []:
                        middle = lines[k].mean(0)[columns]
                        if all(np.hypot(*(middle - other)) > room for other in middles):
                            halo = [withStroke(linewidth=2.0, foreground="white")]
                            ax.annotate(str(some[k]), middle, fontsize="x-small", path_effects=halo, zorder=3.0)
                            middles.append(middle)
                    ax.set(aspect="equal", adjustable="datalim", xlabel="x [m]", ylabel=y, title=title)
                    fig.colorbar(edges, ax=ax, shrink=0.8)
        return fig


def audit(
    graph: Graph, values: Values, *, groups: Grouping = None, draws: int = DRAWS, seed: int = 0, resolve: int = 0
) -> AuditReport:
    """Examine any gtsam graph at its optimum: which factor is wrong, which noise is wrong, what is unchecked.

    Args:
        graph: factors of any type; empty slots keep their number.
        values: the optimum. Elsewhere, statistics are those of the linearized problem, and the words say so.
        groups: kind of each factor, as names in the order of the graph or a function of number and factor; an empty
            name, or nothing: by type, odometry or loop, and noise.
        draws: number of draws of the graph's own noise for `p_drawn`; 0: none.
        seed: of the draws, and of the probes of the variance components.
        resolve: number of the most influential factors without which the graph is solved again: `resolved_m`,
            `resolved_cost`, beside the linear `influence_m`, `cost`.

    Returns:
        The report: `factors`, `kinds`, `components` (pandas), `words()`, `figure()`, `rejected`.

    Raises:
        DataError: a factor without its variable's value, a residual that is not finite, or no factor.

    Example:
        >>> import gtsam
        >>> graph, values = gtsam.readG2o(gtsam.findExampleDataFile("noisyToyGraph.txt"))
        >>> graph.addPriorPose2(0, values.atPose2(0), gtsam.noiseModel.Isotropic.Sigma(3, 0.01))
        >>> report = slamref.audit(graph, gtsam.LevenbergMarquardtOptimizer(graph, values).optimize())
        >>> report.factors[["kind", "redundancy", "p_family"]]  # a row for each factor
    """
    with threadpool_limits(1):
        return reported(examined(graph, values, groups, draws, seed), graph, values, resolve)


def reported(a: Audit, graph: Graph, values: Values, resolve: int = 0) -> AuditReport:
    """The report of an audit of a graph and its values; `resolve` as of `audit`."""
    factors, kinds, components = tables(a)
    ranked = np.argsort(-np.nan_to_num(a.factors.moved), kind="stable")
    alone = [(int(i),) for i in ranked[:resolve].tolist() if np.isfinite(a.factors.chi2[i])]
    for (i,), found in zip(alone, left_out(graph, values, a, alone), strict=True):
        factors.loc[i, ["resolved_m", "resolved_cost"]] = _settled(np.array(found))
    return AuditReport(factors, kinds, components, a, questions=questions(a, graph))


def tables(a: Statistics) -> tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame]:
    """The tables `factors`, `kinds` and `components` of an `AuditReport`."""
    t, of = a.factors, a.kinds.of
    unchecked, p = t.redundancy < UNCHECKED * t.dim, _p_values(t.log_p, a.log_p_family)
    factors = pd.DataFrame(
        {
            "keys": list(a.keys), "kind": [a.kinds.names[k] if k >= 0 else "" for k in of.tolist()], "dim": t.dim,
            "chi2": t.chi2, "redundancy": t.redundancy, "unchecked": unchecked, "deleted": t.deleted, "rank": t.rank,
            "p": p["p"], "p_family": p["p_family"], "minimal_error": t.minimal_error, "influence_m": t.moved,
            "p_drawn": a.p_drawn, "missed_m": t.missed, "weight": t.weight, "cost": t.cost,
            "wrong": np.isin(np.arange(len(t.dim)), a.wrong), "resolved_m": np.nan, "resolved_cost": np.nan, **p,
        }
    )  # fmt: skip
    for column in ("chi2", "redundancy", "deleted", "influence_m", "missed_m", "cost"):
        factors[column] = _settled(factors[column].to_numpy())
    factors.index.name = "factor"

    def total(column: Array | IntArray | BoolArray) -> Array:
        return np.bincount(of[of >= 0], np.nan_to_num(column)[of >= 0], len(a.kinds.names)).astype(float)

    n = total(np.ones(len(of)))
    kinds = pd.DataFrame(
        {
            "n": n.astype(int), "dim": total(t.dim).astype(int), "chi2": _settled(total(t.chi2)),
            "redundancy": _settled(total(t.redundancy)), "component": a.by_kind.component, "se": a.by_kind.error,
            "sigma_factor": np.sqrt(a.by_kind.component), "unchecked": total(unchecked).astype(int),
            **_p_values(a.by_kind.log_p, a.log_p_kind), "assumed": np.isin(a.kinds.names, a.kinds.assumed),
        }, index=pd.Index(a.kinds.names, name="kind"),
    )  # fmt: skip
    divided = [i for i, (_, x) in enumerate(a.axis.tolist()) if x >= 0]
    components = pd.DataFrame(
        {
            "kind": [a.kinds.names[a.axis[i, 0]] for i in divided],
            "axis": [a.kinds.axes[a.axis[i, 0]][a.axis[i, 1]] for i in divided],
            "redundancy": _settled(a.by_axis.redundancy[divided]), "component": a.by_axis.component[divided],
            "se": a.by_axis.error[divided], "sigma_factor": np.sqrt(a.by_axis.component[divided]),
            **_p_values(a.by_axis.log_p[divided], a.log_p_axis[divided]),
        }
    )  # fmt: skip
    return factors, kinds, components


def _settled(of: Array) -> Array:
    """Numbers without rounding errors of zero."""
    return np.where(np.abs(of) < TINY, 0.0, of)


def _p_values(log_p: Array, log_p_family: Array) -> dict[str, Array]:
    """P values, then their logarithms."""
    each = {"p": log_p, "p_family": log_p_family}
    return {what: np.exp(v) for what, v in each.items()} | {LOG10 + what: v / np.log(10.0) for what, v in each.items()}


def printable(frame: pd.DataFrame) -> pd.DataFrame:
    """Factors with keys as gtsam prints them."""
    return frame.assign(keys=[" ".join(map(name, keys)) for keys in frame["keys"]])


def _facts(report: AuditReport) -> SimpleNamespace:
    """What the words of an audit say besides the numbers of its report; see `wings.audit.audit.Audit`."""
    a, factors, kinds, components = report.audit, report.factors, report.kinds, report.components
    wrong = factors[factors["p_family"] < FAMILY]
    order = report.ranked
    share = (np.ptp(wrong["deleted"]) < ALIKE * wrong["deleted"].max()) if len(wrong) else False
    alike = len(wrong) if share and len(wrong) > 1 else 0
    first = order[order.index.isin(wrong.index) & order.index.isin(a.wrong)]
    # from the optimum that the search found, none is: these values are another minimum
    most = not alike and ((len(a.wrong) or len(wrong)) > 0.5 * len(order) or (a.searched and not len(a.wrong)))
    scaled = scales(kinds[kinds["p_family"] < FAMILY], components[components["p_family"] < FAMILY])
    asked = scales(kinds[kinds["assumed"]], components[components["kind"].isin(a.kinds.assumed)])
    unchecked = factors[factors["unchecked"]]
    seen = factors["missed_m"][np.isfinite(factors["missed_m"]) & ~factors["unchecked"]]
    missed = factors.loc[[seen.idxmax()] if seen.max() > 0.0 else []]
    # rejected at the stated noise, not at the one that the residuals of a whole kind ask for; one axis explains less
    whole = scales(kinds[kinds["p_family"] < FAMILY], components.iloc[:0])
    wide = max([1.0, *(s.value for s in whole)])
    widened, clusters = log_p_of(wrong["deleted"].to_numpy() / wide, wrong["rank"].to_numpy()), report.clusters
    tests, all_ = max(int(np.isfinite(a.factors.log_p).sum()), 1), max(len(clusters), 1)
    explained = bool(np.all(widened > LOG_FAMILY - np.log(tests))) and wide > 1.0
    clusters = clusters[clusters["p_family"] < FAMILY]
    apart = log_p_of(clusters["deleted"].to_numpy() / wide, clusters["rank"].to_numpy(int)) < LOG_FAMILY - np.log(all_)
    if a.searched:  # others seem wrong beside these
        apart = np.array([set(c).issubset(a.wrong.tolist()) for c in clusters["factors"]], bool)
    apart &= not most
    touching = {f.variable: [] for f in a.condition.loose}  # type: dict[int, list[int]]
    for g in a.f.system.groups if touching else []:
        for i, variables in zip(g.factor.tolist(), g.variables.tolist(), strict=True):
            for v in touching.keys() & set(variables):
                touching[v].append(i)
    only = {v: some[0] if len(some) == 1 else -1 for v, some in touching.items()}
    return SimpleNamespace(
        factors=int(factors["chi2"].notna().sum()), chi2=float(factors["chi2"].sum()), wrong=len(a.wrong) or len(wrong),
        # rejected only beside them; those of them that stand for rejected ones, and are not rejected themselves
        beside=len(set(wrong.index) - set(a.wrong.tolist())), standing=len(set(a.wrong.tolist()) - set(wrong.index)),
        rest=a.freedom - int(factors["dim"].to_numpy()[a.wrong].sum()), explained=len(wrong) * explained,
        # the wrong ones, if they are several but few
        named=", ".join(map(str, a.wrong.tolist())) if 1 < len(a.wrong) <= TEN else "",
        # rejected factors that share one test, if all do: nothing tells them apart
        alike=alike, most=most, far=a.gained > max(FAR, FAR_SHARE * a.freedom) and not a.searched,
        scaled=tuple(dict.fromkeys(s.kind for s in scaled)),
        # kinds whose noise nobody stated, and what their residuals ask for
        assumed=a.kinds.assumed, asked=tuple(s for s in asked if s.error < s.value),
        component=max(scaled, key=lambda s: s.told(factors["chi2"].sum() > a.freedom), default=None),
        worst=None
        if explained or alike or most or first.empty
        else _in_words(first.iloc[0], first.index[0], beside=a.beside[first.index[0]]),
        least=None if order.empty else _in_words(order.iloc[0], order.index[0]),
        cluster=_in_words(clusters[apart].iloc[0], _some(clusters[apart].iloc[0]["factors"])) if apart.any() else None,
        unchecked=len(unchecked),
        unchecked_kinds=tuple(f"{n} of {int(kinds.loc[k, 'n'])} {k}" for k, n in Counter(unchecked["kind"]).items()),
        hidden=None if missed.empty else _in_words(missed.iloc[0], missed.index[0]),
        gauge=max(a.condition.gauge - report.held, 0), scale=a.condition.scale,
        # name, directions, whether it moves, and turns, and the number of the one factor that ties it, or -1
        loose=tuple((name(a.f.system.keys[f[0]]), *f[1:], only[f[0]]) for f in a.condition.loose),
        unused=tuple(map(name, a.unused)), parts=a.condition.parts,
        points=sum(key >> 56 == ord("l") for key in a.f.system.keys),
        duplicates=tuple(f"{i} and {j}" for i, j in a.condition.duplicates),
        ignored=int((factors["weight"] < 1.0).sum()),
        zero=tuple(str(k) for k, zero in zip(kinds.index, a.by_kind.zero, strict=True) if zero),
    )  # fmt: skip


def _some(numbers: Sequence[int]) -> str:
    """The first numbers and the last one."""
    return ", ".join(map(str, numbers if len(numbers) <= SHOWN else [*numbers[: SHOWN - 1], "...", numbers[-1]]))


def _in_words(row: pd.Series[Any], number: object, **more: object) -> SimpleNamespace:
    """A row of the table of factors, or of clusters, for a sentence."""
    keys = " ".join(map(name, row.get("keys", ())))
    return SimpleNamespace(**{**row, "number": number, "keys": keys, "log10_p": row[LOG10 + "p_family"], **more})


def scales(kinds: pd.DataFrame, components: pd.DataFrame) -> list[Scale]:
    """Of some axes, and of some kinds that have none of them; rows of an `AuditReport`'s tables."""
    rows = [(f"{row['kind']}, {row['axis']}", row["kind"], row) for _, row in components.iterrows()]
    rows += [(str(k), str(k), row) for k, row in kinds.iterrows() if k not in set(components["kind"])]
    return [Scale(title, kind, row["component"], row["se"], row["sigma_factor"]) for title, kind, row in rows]


def write_audit(report: AuditReport, folder: Path, title: str, command: str) -> None:
    """Write factors.csv, kinds.csv, components.csv, and report.html with its figure."""
    from eval.figures.style import save
    from eval.report.page.blocks import Picture, Report, Section, Table
    from eval.report.render import write_report

    folder.mkdir(parents=True, exist_ok=True)
    printable(report.factors).to_csv(folder / "factors.csv", lineterminator="\n")
    report.kinds.to_csv(folder / "kinds.csv", lineterminator="\n")
    report.components.to_csv(folder / "components.csv", index=False, lineterminator="\n")
    facts = report.facts

    def caption(part: str) -> str:
        return as_sentence(say(f"audit#{part}_caption", a=facts, r=report))

    sections = [Section(HEADINGS[what], (Table(frame, caption(what)),)) for what, frame in shown_tables(report).items()]
    if np.isfinite(report.audit.place).any() and any(len(keys) > 1 for keys in report.audit.keys):
        save(report.figure(), folder / "figures", "graph", ("png",))
        alt = "The graph's edges, coloured by p value and by redundancy"
        sections.append(Section("Graph", (Picture("graph", caption("figure"), alt),)))
    write_report(folder, Report(title, command, tuple(report.words().split("\n")), tuple(sections)))


HEADINGS = {"kinds": "Kinds of factors", "axes": "Axes", "factors": "Worst factors", "clusters": "Clusters"}


def shown_tables(report: AuditReport) -> dict[str, pd.DataFrame]:
    """The tables of an audit for a person, without empty ones."""
    clusters = report.clusters[report.clusters["p_family"] < FAMILY].head(TEN)
    every = {
        "kinds": report.kinds.drop(columns=["p", LOG10 + "p", "assumed"]).reset_index(), "axes": report.components,
        "factors": report.worst().reset_index()[NARROW],
        "clusters": clusters.assign(factors=[_some(c) for c in clusters["factors"]]),
    }  # fmt: skip
    return {what: shown(frame) for what, frame in every.items() if len(frame)}


def shown(frame: pd.DataFrame) -> pd.DataFrame:
    """A table with four digits, for a person; p values from their logarithms, where these are beside them."""
    out = frame.copy()
    for column in map(str, out.select_dtypes("float")):
        logs = frame[LOG10 + column] if LOG10 + column in out else [np.nan] * len(out)
        out[column] = [_text(v, log) for v, log in zip(frame[column], logs, strict=True)]
    return out.drop(columns=[c for c in map(str, out) if c.startswith(LOG10)])


def _text(v: float, log10: float) -> str:
    if v == 0.0 and np.isfinite(log10):
        return f"{10.0 ** (log10 % 1.0):.3f}e{int(np.floor(log10))}"
    return f"{v + 0.0:.4g}" if np.isfinite(v) else ("" if np.isnan(v) else "inf")


HALF, ORDER, ROOT = "half-angle", "order", "root"
HALF_ANGLE = 4.0  # variance of the angle over that of a quaternion's vector part
SURE, LARGEST = 2.5, 0.3  # standard errors within which a pattern fits; of a logarithm, beyond which none is told
FITS, SLACK = 22.5, 0.1  # chi-square of six axes that fit, at 0.1 %; of a logarithm, what linearization may add
APART = 1.0  # least logarithm of a pattern, else it is none


def questions(a: Audit, graph: Graph) -> tuple[Question, ...]:
    """Conventions in which an information matrix may have been written, where the residuals speak for one.

    Writers of relations in space differ: rotation before or after translation, of the angle or of a quaternion's vector
    part (half the angle, so that the variance of the angle is four times the stated one), information or its root.
    Each would leave its own pattern of variance components; the question is asked if the pattern is there and the
    stated reading is rejected.
    """
    out = list[Question]()
    for k, kind in enumerate(a.kinds.names):
        if a.kinds.axes[k] != AXES["Pose3"]:
            continue
        rows = np.array([i for i, (of, x) in enumerate(a.axis.tolist()) if of == k and x >= 0])
        component, error = a.by_axis.component[rows], a.by_axis.error[rows]
        if np.isfinite(component).all() and (a.log_p_axis[rows] < LOG_FAMILY).any():
            sigmas = [plain_noise(graph.at(i))[0].sigmas() for i in np.flatnonzero(a.kinds.of == k).tolist()]
            stated = np.mean(2.0 * np.log(np.maximum(sigmas, np.finfo(float).tiny)), axis=0)
            out += _of_kind(kind, np.log(component), error / component, stated)
    return tuple(out)


def _of_kind(kind: str, c: Array, e: Array, v: Array) -> list[Question]:
    """From the logarithms of components (6,), with standard errors, and of the stated variances."""

    def mean(part: slice, values: Array) -> tuple[float, float]:
        weight = 1.0 / e[part] ** 2
        return float(np.sum(weight * values[part]) / weight.sum()), float(1.0 / np.sqrt(weight.sum()))

    turn, shift = slice(0, 3), slice(3, 6)
    (rotation, by_turn), (translation, by_shift) = mean(turn, c), mean(shift, c)
    error = float(np.hypot(by_turn, by_shift))
    ratio = rotation - translation
    out = []
    swapped = 2.0 * float(v[shift].mean() - v[turn].mean())  # the rotation has the other's variance, and vice versa
    patterns = ((HALF, ratio, error, float(np.log(HALF_ANGLE))), (ORDER, ratio, error, swapped))
    for convention, found, se, expected in patterns:
        if se < LARGEST and abs(expected) > APART and abs(found - expected) < SURE * se + SLACK:
            ratio_ = float(np.exp(found))
            out.append(Question(kind, convention, ratio_, ratio_ * se, float(np.exp(expected))))
    off = c - v  # the stated number is the root of the information: component times root is 1 in each axis
    fits = float(np.sum(off**2 / (e**2 + SLACK**2))) < FITS
    if fits and max(by_turn, by_shift) < LARGEST and np.abs(v).max() > APART:
        found, se = mean(slice(0, 6), off)
        out.append(Question(kind, ROOT, float(np.exp(found)), float(np.exp(found) * se), 1.0))
    return out
