"""The audit of a factor graph for users: tables, words, a figure, and the page."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from scipy.stats import chi2
from threadpoolctl import threadpool_limits

from data.inputs import IntArray
from data.se2 import Array, BoolArray
from eval.report.words import as_sentence, say
from wings.audit.audit import DRAWS, FAMILY, Audit, Statistics, examined
from wings.audit.conventions import Question, questions
from wings.audit.factors import UNCHECKED
from wings.audit.kinds import Grouping
from wings.audit.leaving_out import left_out
from wings.audit.linear import Graph, Values, name

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TEN, SHOWN = 10, 6  # rows of the worst factors; names in a sentence
FAR, FAR_SHARE = 9.0, 0.1  # decrease of the sum of squares from which values are no optimum; over the freedom
NARROW = ["factor", "keys", "kind", "redundancy", "deleted", "rank", "p", "p_family", "minimal_error", "influence_m"]
"""Columns that fit a page; factors.csv has all."""


@dataclass(frozen=True)
class One:
    """A factor in a sentence."""

    number: int
    keys: str
    kind: str
    deleted: float
    rank: int
    p: float


@dataclass(frozen=True)
class Together:
    """A cluster in a sentence."""

    count: int
    some: str
    deleted: float
    rank: int
    p: float
    moved: float


@dataclass(frozen=True)
class Scale:
    """A wrong variance in a sentence."""

    name: str
    value: float
    error: float
    sigma: float


@dataclass(frozen=True)
class Hidden:
    """The error that does most harm unseen."""

    number: int
    keys: str
    sigmas: float
    metres: float


@dataclass(frozen=True)
class Second:
    """Another minimum: where the optimizer started, both errors, and where they differ."""

    start: str
    error: float
    ours: float
    apart: int
    most: str
    metres: float


@dataclass(frozen=True)
class AuditFacts:
    """What the words of an audit say; see `wings.audit.audit.Audit`."""

    factors: int
    freedom: int
    chi2: float
    rejected: bool
    wrong: int
    scaled: tuple[str, ...]
    component: Scale | None
    worst: One | None
    cluster: Together | None
    least: One
    unchecked: int
    unchecked_kinds: tuple[str, ...]
    hidden: Hidden | None
    decrement: float
    gained: float
    minima: tuple[Second, ...]
    questions: tuple[Question, ...]
    curvature: float
    gauge: int
    loose: tuple[str, ...]
    parts: tuple[int, ...]
    duplicates: tuple[str, ...]
    ignored: int
    unread: tuple[str, ...]
    zero: tuple[str, ...]
    far: bool
    most: bool
    beside: int
    explained: int


@dataclass(frozen=True, eq=False)
class AuditReport:
    """An audit.

    Attributes:
        factors: a row each, index: number in the graph. keys, kind, dim; chi2 of the whitened residual; redundancy,
            unchecked; deleted (T), rank, p, p_family (Holm); minimal_error [sigma]; influence_m [m]; p_drawn (draws of
            the graph's own noise); missed_m [m], motion of its own ends by a just missed error; weight (robust); cost;
            wrong: without these, if they are few, no other is rejected;
            resolved_m, resolved_cost: motion and decrease of the graph solved again, NaN where it was not.
        kinds: a row each: n, dim, chi2, redundancy, component, se, sigma_factor, unchecked, p, p_family.
        components: a row for each axis of a kind with diagonal noise.
        audit: the numbers.
    """

    factors: pd.DataFrame
    kinds: pd.DataFrame
    components: pd.DataFrame
    audit: Audit
    minima: tuple[Second, ...] = ()
    questions: tuple[Question, ...] = ()
    clusters_again: dict[int, float] = field(default_factory=dict)
    unread: tuple[str, ...] = ()

    @property
    def clusters(self) -> pd.DataFrame:
        """Loops that agree with each other, tested together; `resolved_m` of those that were left out."""
        rows = [
            (c.factors, c.T, c.rank, c.p, p, c.moved, self.clusters_again.get(k, np.nan))
            for k, (c, p) in enumerate(zip(self.audit.clusters, self.audit.p_cluster, strict=True))
        ]
        heads = ["factors", "deleted", "rank", "p", "p_family", "influence_m", "resolved_m"]
        frame = pd.DataFrame(rows, columns=heads)
        return frame.sort_values("p", kind="stable", ignore_index=True)

    @property
    def rejected(self) -> bool:
        """Whether a factor or a component is rejected at a family-wise 5 %."""
        return self.audit.rejected

    @property
    def facts(self) -> AuditFacts:
        """What the words say."""
        return _facts(self)

    def words(self) -> str:
        """Three sentences: what to trust, what is wrong most, what cannot be known; then what the structure says."""
        facts = self.facts
        lines = [as_sentence(say(f"audit#{part}", a=facts)) for part in ("trust", "worst", "unknown")]
        found = say("audit#findings", a=facts).strip()
        return "\n".join([*lines, *([found] if found else [])])

    def worst(self, count: int = TEN) -> pd.DataFrame:
        """The factors of least p value, with keys as gtsam prints them."""
        some = self.factors.dropna(subset="p").sort_values(["p", "deleted"], ascending=[True, False], kind="stable")
        return printable(some.head(count))

    def figure(self) -> Figure:
        """The graph, edges coloured by p value and by redundancy."""
        from wings.audit.figure import audit_figure

        place = {key: v for v, key in enumerate(self.audit.f.system.keys)}
        some = [i for i, keys in enumerate(self.audit.keys) if len(keys) > 1]
        ends = np.array([(place[self.audit.keys[i][0]], place[self.audit.keys[i][-1]]) for i in some], np.int64)
        ends = ends.reshape(-1, 2)
        t = self.audit.factors
        wrong = np.flatnonzero(np.isin(some, self.audit.wrong)).tolist()
        share = (t.redundancy[some] / np.maximum(t.dim[some], 1)).clip(0.0, 1.0)
        return audit_figure(self.audit.place, ends, t.p[some], share, wrong)


def audit(
    graph: Graph,
    values: Values,
    *,
    groups: Grouping = None,
    draws: int = DRAWS,
    seed: int = 0,
    full: bool = False,
    resolve: int = 0,
) -> AuditReport:
    """Examine any gtsam graph at its optimum: which factor is wrong, which noise is wrong, what is unchecked.

    Args:
        graph: factors of any type; empty slots keep their number.
        values: the optimum. Elsewhere, statistics are those of the linearized problem, and the words say so.
        groups: kind of each factor, as names in the order of the graph or a function of number and factor; an empty
            name, or nothing: by type, odometry or loop, and noise.
        draws: number of draws of the graph's own noise for `p_drawn`; 0: none.
        seed: of the draws, and of the probes of the variance components.
        resolve: number of the most influential factors, and of rejected clusters, without which the graph is solved
            again: `resolved_m`, `resolved_cost`, beside the linear `influence_m`, `cost`.
        full: each draw is a graph of drawn measurements, optimized again: exact, and many times slower.

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
        return reported(examined(graph, values, groups, draws, seed, full=full), graph, values, resolve)


def reported(a: Audit, graph: Graph, values: Values, resolve: int = 0) -> AuditReport:
    """The report of an audit of a graph and its values; `resolve` as of `audit`."""
    factors, kinds, components = tables(a)
    ranked = np.argsort(-np.nan_to_num(a.factors.moved), kind="stable")
    alone = [(int(i),) for i in ranked[:resolve].tolist() if np.isfinite(a.factors.chi2[i])]
    order = np.argsort(a.p_cluster, kind="stable")[:resolve]
    together = [int(k) for k in order if a.p_cluster[k] < FAMILY]
    again = left_out(graph, values, a, [*alone, *(a.clusters[k].factors for k in together)])
    for name_, column in (("resolved_m", 0), ("resolved_cost", 1)):
        factors[name_] = np.nan
        for (i,), found in zip(alone, again, strict=False):
            factors.loc[i, name_] = found[column]
    clusters = {k: found[0] for k, found in zip(together, again[len(alone) :], strict=True)}
    return AuditReport(factors, kinds, components, a, questions=questions(a, graph), clusters_again=clusters)


def tables(a: Statistics) -> tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame]:
    """The tables `factors`, `kinds` and `components` of an `AuditReport`."""
    t, of = a.factors, a.kinds.of
    unchecked = np.where(np.isfinite(t.redundancy), t.redundancy < UNCHECKED * t.dim, False)
    factors = pd.DataFrame(
        {
            "keys": list(a.keys), "kind": [a.kinds.names[k] if k >= 0 else "" for k in of.tolist()], "dim": t.dim,
            "chi2": t.chi2, "redundancy": t.redundancy, "unchecked": unchecked, "deleted": t.deleted, "rank": t.rank,
            "p": t.p, "p_family": a.p_family, "minimal_error": t.minimal_error, "influence_m": t.moved,
            "p_drawn": a.p_drawn, "missed_m": t.missed, "weight": t.weight, "cost": t.cost,
            "wrong": np.isin(np.arange(len(t.dim)), a.wrong),
        }
    )  # fmt: skip
    factors.index.name = "factor"

    def total(column: Array | IntArray | BoolArray) -> Array:
        return np.bincount(of[of >= 0], np.nan_to_num(column)[of >= 0], len(a.kinds.names)).astype(float)

    n = total(np.ones(len(of)))
    kinds = pd.DataFrame(
        {
            "n": n.astype(int), "dim": total(t.dim).astype(int), "chi2": total(t.chi2),
            "redundancy": total(t.redundancy), "component": a.by_kind.component, "se": a.by_kind.error,
            "sigma_factor": np.sqrt(a.by_kind.component), "unchecked": total(unchecked).astype(int),
            "p": a.by_kind.p, "p_family": a.p_kind,
        }, index=pd.Index(a.kinds.names, name="kind"),
    )  # fmt: skip
    divided = [i for i, (_, x) in enumerate(a.axis.tolist()) if x >= 0]
    components = pd.DataFrame(
        {
            "kind": [a.kinds.names[a.axis[i, 0]] for i in divided],
            "axis": [a.kinds.axes[a.axis[i, 0]][a.axis[i, 1]] for i in divided],
            "redundancy": a.by_axis.redundancy[divided], "component": a.by_axis.component[divided],
            "se": a.by_axis.error[divided], "sigma_factor": np.sqrt(a.by_axis.component[divided]),
            "p": a.by_axis.p[divided], "p_family": a.p_axis[divided],
        }
    )  # fmt: skip
    return factors, kinds, components


def printable(frame: pd.DataFrame) -> pd.DataFrame:
    """Factors with keys as gtsam prints them."""
    return frame.assign(keys=[" ".join(map(name, keys)) for keys in frame["keys"]])


def _facts(report: AuditReport) -> AuditFacts:
    a, factors, kinds = report.audit, report.factors, report.kinds
    wrong = factors[factors["p_family"] < FAMILY]
    order = factors.dropna(subset="p").sort_values(["p", "deleted"], ascending=[True, False], kind="stable")
    least = _one(order.iloc[0]) if len(order) else One(-1, "", "", np.nan, 0, np.nan)
    first = order[order.index.isin(a.wrong)].head(1)
    worst = _one(first.iloc[0]) if len(first) and first["p_family"].iloc[0] < FAMILY else None
    scales = [_scale(row["kind"] + ", " + row["axis"], row) for _, row in report.components.iterrows()]
    scales += [_scale(str(k), row) for k, row in kinds.iterrows() if not (report.components["kind"] == k).any()]
    tested = [each for each in scales if each is not None]
    pooled = [_scale(str(k), row) for k, row in kinds.iterrows()]
    scaled = dict.fromkeys([s.name.rsplit(", ", 1)[0] if s.name not in kinds.index else s.name for s in tested])
    scaled |= dict.fromkeys(s.name for s in pooled if s is not None)
    component = max(tested or [s for s in pooled if s is not None], key=lambda s: abs(np.log(s.sigma)), default=None)
    unchecked = factors[factors["unchecked"]]
    counts = Counter(unchecked["kind"])
    seen = factors[np.isfinite(factors["missed_m"]) & ~factors["unchecked"]]
    hidden = None
    if len(seen) and seen["missed_m"].max() > 0.0:
        i = int(seen["missed_m"].idxmax())
        hidden = Hidden(i, _keys(factors, i), float(factors["minimal_error"][i]), float(factors["missed_m"][i]))
    # rejected at the stated noise, and not at the one that the residuals ask for
    wide = max([1.0, *(s.value for s in [*scales, *pooled] if s is not None)])
    tests = max(int(np.isfinite(a.factors.p).sum()), 1)
    explained = bool(np.all(chi2.sf(wrong["deleted"] / wide, wrong["rank"]) * tests > FAMILY)) and wide > 1.0
    together = _cluster(report, wide)
    loose = [f"{name(a.f.system.keys[v])} ({n} direction{'s' * (n > 1)})" for v, n in a.condition.loose[:SHOWN]]
    if len(a.condition.loose) > SHOWN:
        loose.append(f"{len(a.condition.loose) - SHOWN} more")
    return AuditFacts(
        int(factors["chi2"].notna().sum()), a.freedom, float(factors["chi2"].sum()), a.rejected, len(a.wrong),
        tuple(scaled), component, None if explained else worst, together, least,
        len(unchecked),
        tuple(f"{n} of {int(kinds.loc[k, 'n'])} {k}" for k, n in counts.items()),
        hidden, a.decrement, a.gained, report.minima, report.questions,
        a.curvature, a.condition.gauge, tuple(loose), a.condition.parts,
        tuple(f"{i} and {j}" for i, j in a.condition.duplicates), int((factors["weight"] < 1.0).sum()), report.unread,
        tuple(str(k) for k, zero in zip(kinds.index, a.by_kind.zero, strict=True) if zero),
        a.gained > max(FAR, FAR_SHARE * a.freedom), len(wrong) > 0.5 * len(order),
        len(set(wrong.index) - set(a.wrong.tolist())), len(wrong) * explained,
    )  # fmt: skip


def _cluster(report: AuditReport, wide: float) -> Together | None:
    """The worst rejected cluster that variances `wide` times as large do not explain."""
    some = report.clusters[report.clusters["p_family"] < FAMILY]
    rows = [r for _, r in some.iterrows() if chi2.sf(r["deleted"] / wide, r["rank"]) * len(report.clusters) < FAMILY]
    if not rows:
        return None
    row = rows[0]
    names = ", ".join(map(str, row["factors"][:TEN])) + ", ..." * (len(row["factors"]) > TEN)
    return Together(len(row["factors"]), names, row["deleted"], row["rank"], row["p_family"], row["influence_m"])


def _keys(factors: pd.DataFrame, i: int) -> str:
    return " ".join(map(name, factors["keys"][i]))


def _one(row: pd.Series[Any]) -> One:
    keys = " ".join(map(name, row["keys"]))
    return One(int(str(row.name)), keys, row["kind"], row["deleted"], row["rank"], row["p_family"])


def _scale(name_: str, row: pd.Series[Any]) -> Scale | None:
    """The component of a row if it is rejected."""
    if not row["p_family"] < FAMILY:
        return None
    return Scale(name_, row["component"], row["se"], row["sigma_factor"])


def write_audit(report: AuditReport, folder: Path, title: str, command: str) -> None:
    """Write factors.csv, kinds.csv, components.csv, and report.html with its figure."""
    from eval.figures.style import save
    from eval.report.page.blocks import Block, Picture, Report, Section, Table
    from eval.report.render import write_report

    folder.mkdir(parents=True, exist_ok=True)
    printable(report.factors).to_csv(folder / "factors.csv", lineterminator="\n")
    report.kinds.to_csv(folder / "kinds.csv", lineterminator="\n")
    report.components.to_csv(folder / "components.csv", index=False, lineterminator="\n")
    facts = report.facts

    def caption(part: str) -> str:
        return as_sentence(say(f"audit#{part}_caption", a=facts))

    first: list[Block] = [Table(shown(report.kinds.reset_index()), caption("kinds"))]
    if len(report.components):
        first.append(Table(shown(report.components), caption("axes")))
    sections = [
        Section("Kinds of factors", tuple(first)),
        Section("Worst factors", (Table(shown(report.worst().reset_index()[NARROW]), caption("factors")),)),
    ]
    if (some := report.clusters[report.clusters["p_family"] < FAMILY].head(TEN)).size:
        listed = some.assign(factors=[" ".join(map(str, c)) for c in some["factors"]])
        sections.append(Section("Clusters", (Table(shown(listed), caption("clusters")),)))
    if np.isfinite(report.audit.place).any() and any(len(keys) > 1 for keys in report.audit.keys):
        save(report.figure(), folder / "figures", "graph", ("png",))
        alt = "The graph's edges, coloured by p value and by redundancy"
        sections.append(Section("Graph", (Picture("graph", caption("figure"), alt),)))
    write_report(folder, Report(title, command, tuple(report.words().split("\n")), tuple(sections)))


def shown(frame: pd.DataFrame) -> pd.DataFrame:
    """A table with four digits, for a person."""
    out = frame.copy()
    for column in out.select_dtypes("float"):
        out[column] = [f"{v:.4g}" if np.isfinite(v) else ("" if np.isnan(v) else "inf") for v in out[column]]
    return out
