"""Figures of error: of each coordinate over time, with its claimed 3 sigma, of a distance from batch, of decisions."""

from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import ScaledTranslation

from data.inputs import Inputs, IntArray
from data.log import Log
from data.result import Run, Trajectory
from data.se2 import Array, pose_error
from eval.figures import kinds
from eval.figures.style import CLAIM, NARROW, Series, across, drawing, finish, key, page_width, points, series, style_of
from eval.referee.confusion import Confusion
from eval.referee.given.runs import log_of, match
from eval.referee.score import Trial, confusion_of

MOST_BINS = 600  # stretches of time in a panel; more than paper or screen can show
COORDINATES = (("x", "m", 1.0), ("y", "m", 1.0), ("heading", "deg", 180.0 / np.pi))
"""Name, unit, and factor from SI of each row of the error figure."""
WIDEST = 4.0  # A panel is at most this many times as high as its row's middle panel needs; beyond, the curve leaves it


def ticks(most: int) -> MaxNLocator:
    """At most so many intervals, at steps of 1, 2 or 5."""
    return MaxNLocator(most, steps=[1, 2, 5, 10])


def thinned(curve: Array, most: int = MOST_BINS) -> IntArray:
    """Indices of the points (N,) that a plot needs: of each of `most` stretches the ends, extremes and one gap."""
    n = len(curve)
    if n <= 4 * most:
        return np.arange(n)
    edge = np.linspace(0, n, most + 1).astype(int)
    first, after = edge[:-1, None], edge[1:, None]
    at = np.minimum(first + np.arange(int(np.diff(edge).max())), after - 1)  # a short stretch repeats its end
    gap = np.isnan(curve[at])
    least, greatest, missing = (
        np.take_along_axis(at, each.argmax(axis=1)[:, None], axis=1)
        for each in (np.where(gap, -np.inf, -curve[at]), np.where(gap, -np.inf, curve[at]), gap)
    )
    known = ~gap.all(axis=1)
    return np.unique(np.concatenate([first, after - 1, least[known], greatest[known], missing[gap.any(axis=1)]]))


def sigmas(trajectory: Trajectory) -> Array:
    """Standard deviations (N, 3) [m, m, rad] claimed; variances slightly below zero (rounding) count as zero."""
    return np.asarray(np.sqrt(np.maximum(np.diagonal(trajectory.covariance, axis1=1, axis2=2), 0.0)))


def longest_sigma(trajectory: Trajectory) -> Array:
    """Standard deviation of the position (N,) [m] along its least certain direction; NaN where unknown."""
    P = trajectory.covariance[:, :2, :2]
    mean, half = 0.5 * (P[:, 0, 0] + P[:, 1, 1]), 0.5 * (P[:, 0, 0] - P[:, 1, 1])
    return np.asarray(np.sqrt(np.maximum(mean + np.hypot(half, P[:, 0, 1]), 0.0)))


def time_label(inputs: Inputs) -> str:
    """Label of the time axis: seconds, or the frame number of a log without stamps."""
    return "frame" if inputs.time_is_index else "time [s]"


def time_axis(ax: Axes, inputs: Inputs) -> None:
    """The axis of time, from a log's first to its last frame."""
    ax.set_xlabel(time_label(inputs))
    if len(inputs.time) > 1:
        ax.set_xlim(inputs.time[0], inputs.time[-1])


def panels(runs: Sequence[Run], most: int = kinds.MOST_PANELS) -> tuple[list[Series], str]:
    """The series that get a panel of their own (dead reckoning only if it is alone), and a remark if not all fit."""
    shown = series(runs)
    estimates = [s for s in shown if s.run.estimator != "dead-reckoning"] or shown
    kept = estimates[:most]
    if most == 2 < len(estimates):  # the first filter and the last smoother that had the same decisions
        alike = [s for s in estimates if s.run.association == estimates[0].run.association]
        kept = [alike[0], alike[-1]] if len(alike) > 1 else kept
    missing = [s.label for s in estimates if s not in kept]
    return kept, f"\nnot shown: {', '.join(missing)}" if missing else ""


def heading_of(s: Series) -> str:
    """Title of a panel: who, and where it stopped, or from where it is implausible."""
    flaw = s.run.flaw
    return s.label if flaw is None else f"{s.label}\n{flaw.status} at frame {flaw.frame}"


def reach(curves: Sequence[Array]) -> float:
    """Half height of an axis: what the curves (N,) need, short of a rare spike; 0 where nothing is known."""
    finite = [c[np.isfinite(c)] for c in curves]
    return max([float(np.quantile(np.abs(c), 0.998)) for c in finite if len(c)], default=0.0)


def common_reach(needs: Sequence[float]) -> float:
    """One half height for a row of panels; a run that went astray does not flatten the others."""
    known = [n for n in needs if np.isfinite(n) and n > 0.0]
    return 1.1 * min(max(known), WIDEST * float(np.median(known))) if known else 1.0


def draw_band(ax: Axes, time: Array, bound: Array, colour: str, mirror: float) -> None:
    """A claimed bound (N,) as a band from `mirror` times the bound up to it, with its edges."""
    keep = thinned(bound)
    t, b = time[keep], bound[keep]
    ax.fill_between(t, mirror * b, b, color=colour, alpha=0.2, linewidth=0.0)
    ax.plot(t, b, color=colour, linewidth=0.5)
    if mirror:
        ax.plot(t, mirror * b, color=colour, linewidth=0.5)


CORNERS = ((0.98, 0.96, "right", "top"), (0.02, 0.96, "left", "top"), (0.98, 0.04, "right", "bottom"),
           (0.02, 0.04, "left", "bottom"))  # fmt: skip


def _note_outside(ax: Axes, time: Array, curves: Sequence[Array], low: float, high: float, unit: str) -> None:
    """How far the first curve (N,) reaches if it leaves the panel, in the corner that all curves leave free."""
    finite = np.abs(curves[0][np.isfinite(curves[0])])
    if not len(finite) or finite.max() <= high:
        return
    across = np.tile((time - time[0]) / max(float(time[-1] - time[0]), 1e-9), len(curves))
    up = np.clip((np.concatenate(curves) - low) / (high - low), 0.0, 1.0)
    x, y, ha, va = min(CORNERS, key=lambda c: int(((np.abs(across - c[0]) < 0.5) & (np.abs(up - c[1]) < 0.15)).sum()))
    look: dict[str, Any] = {"xycoords": "axes fraction", "fontsize": points(6), "color": "#404040"}
    ax.annotate(f"up to {finite.max():.3g} {unit}", (x, y), ha=ha, va=va, **look)


@drawing()
def error_figure(log: Log, runs: Sequence[Run]) -> Figure:
    """Error (estimate minus truth, heading wrapped) with the claimed ±3σ: rows x, y, heading; a column per phase."""
    shown, remark = panels(runs, across(kinds.MOST_PANELS))
    columns = max(len(shown), 1)
    fig = Figure(figsize=(page_width(), 5.0))
    axes = fig.subplots(3, columns, sharex=True, sharey="row", squeeze=False)
    own = [log_of(s.run, log) for s in shown]
    times = [o.recorded.time for o in own]
    truths = (np.full((len(o.recorded.time), 3), np.nan) if o.truth.pose is None else o.truth.pose for o in own)
    errors = [pose_error(s.trajectory.pose, truth) for s, truth in zip(shown, truths, strict=True)]
    bounds = [3.0 * sigmas(s.trajectory) for s in shown]
    for i, (name, unit, factor) in enumerate(COORDINATES):
        limit = common_reach([factor * reach([e[:, i], b[:, i]]) for e, b in zip(errors, bounds, strict=True)])
        for j, s in enumerate(shown):
            ax: Axes = axes[i, j]
            error, bound = factor * errors[j][:, i], factor * bounds[j][:, i]
            draw_band(ax, times[j], bound, s.colour, -1.0)
            ax.axhline(0.0, color="#909090", linewidth=0.5)
            keep = thinned(error)
            ax.plot(times[j][keep], error[keep], color="black", linewidth=0.7)
            _note_outside(ax, times[j], (error, bound, -bound), -limit, limit, unit)
        axes[i, 0].set(ylim=(-limit, limit), ylabel=f"{name} error [{unit}]")
        axes[i, 0].yaxis.set_major_locator(ticks(6))
    for j, s in enumerate(shown):
        axes[0, j].set_title("\n".join(fill(line, 28) for line in heading_of(s).split("\n")))
    for ax in axes[-1]:
        time_axis(ax, log.recorded)
        ax.xaxis.set_major_locator(ticks(5 if columns > 2 else 8))
    what = "error and claimed ±3σ" if log.truth.known_poses else "claimed ±3σ (the log has no truth, so no error)"
    known = [key("error", color="black", linewidth=0.7)] if log.truth.known_poses else []
    title = f"{log.name}: {what}, world frame, no alignment{remark}"
    finish(fig, title, [*known, Patch(label="claimed ±3σ", **CLAIM)])
    return fig


@drawing()
def difference_figure(log: Log, runs: Sequence[Run], reference: Run) -> Figure:
    """Distance [m] of every path from the final one of a reference (batch, known association), for a log without truth.

    Beside it the run's own 3σ along its least certain direction: of an optimal estimator the difference has covariance
    P_run - P_reference, so it stays inside.
    """
    shown, remark = panels([r for r in runs if r is not reference])
    rows = max(len(shown), 1)
    fig = Figure(figsize=(page_width(), 1.0 + 1.15 * rows))
    axes = fig.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
    time, centre = log.recorded.time, reference.trajectory(reference.phases[-1]).pose
    for ax, s in zip(axes, shown, strict=False):
        own = log_of(s.run, log)
        at = own.recorded.time
        there = centre if own is log else match(at, time, centre).truth
        distance = np.hypot(*(s.trajectory.pose - there)[:, :2].T)
        bound = 3.0 * longest_sigma(s.trajectory)
        draw_band(ax, at, bound, s.colour, 0.0)
        keep = thinned(distance)
        ax.plot(at[keep], distance[keep], color="black", linewidth=0.8)
        limit = common_reach([reach([distance]), reach([bound])])
        ax.set(ylim=(-0.03 * limit, limit), ylabel="distance [m]")
        ax.set_title(heading_of(s).replace("\n", ": "), loc="left")
        _note_outside(ax, at, (distance, bound), -0.03 * limit, limit, "m")
        ax.yaxis.set_major_locator(ticks(5))
    time_axis(axes[-1], log.recorded)
    name = series([reference])[-1].label
    handles = [key("distance", color="black", linewidth=0.8), Patch(label="own 3σ, least certain direction", **CLAIM)]
    finish(fig, f"{log.name}: distance from {name} over time (not an error: no truth){remark}", handles)
    return fig


@kinds.figure("error", kinds.measured, kinds.FRONT, quick=True)
def _error(trial: Trial, _: kinds.Variants) -> tuple[Figure, kinds.Facts]:
    shown = kinds.for_panels(kinds.finished(trial))
    beside = panels(shown, across(kinds.MOST_PANELS))[0]
    return error_figure(trial.log, shown), {"others": kinds.left_out(trial, [s.run for s in beside])}


def _has_difference(trial: Trial, _: kinds.Variants) -> bool:
    reference = trial.find("batch")
    return kinds.blind(trial) and reference is not None and reference.flaw is None and len(kinds.finished(trial)) > 1


@kinds.figure("difference", _has_difference, kinds.FRONT, quick=True)
def _difference(trial: Trial, _: kinds.Variants) -> tuple[Figure, kinds.Facts]:
    reference = trial.find("batch")
    assert reference is not None  # or there is no such figure
    rows = kinds.for_panels([r for r in kinds.finished(trial) if r is not reference], complete=(reference.association,))
    return difference_figure(trial.log, rows, reference), {"others": kinds.left_out(trial, [*rows, reference])}


LETTERS = 24  # in a line of a bar's name in a narrow figure
NUMBER = 22.0  # pt that a number of four digits takes, beside bars in a narrow figure
OUTCOME_COLOURS = {"tp": "#0072B2", "tn": "#A9CBE3", "fp": "#D55E00", "fn": "#F0E442"}
"""Right is blue, wrong is warm; within each pair one is dark and one is light (Okabe and Ito's, and a tint)."""


@dataclass(frozen=True)
class Part:
    """A stretch of a bar: a kind of outcome, its share of the colour's outcome, and its hatch."""

    key: str
    outcome: str
    label: str
    hatch: str = ""

    @property
    def look(self) -> dict[str, Any]:
        """As matplotlib draws it."""
        edge: dict[str, Any] = {"edgecolor": "#303030", "linewidth": 0.4, "hatch": self.hatch}
        return {"facecolor": OUTCOME_COLOURS[self.outcome], **edge}


PARTS = (
    Part("tp", "tp", "TP: right landmark"), Part("tn", "tn", "TN: rightly none"),
    Part("wrong", "fp", "FP: another landmark (wrong)"),
    Part("spurious", "fp", "FP: though none is right (spurious)", "/////"),
    Part("duplicate", "fn", "FN: initialized a second one (duplicate)"),
    Part("missed", "fn", "FN: discarded (missed)", "....."),
)  # fmt: skip


@dataclass(frozen=True)
class Bar:
    """One association method, who decided so, and what came of it."""

    label: str
    counts: Confusion

    def length(self, key: str) -> int:
        """Observations in a part of the bar; a deferred decision counts as missed."""
        return int(getattr(self.counts, key)) + (self.counts.deferred if key == "missed" else 0)


def bars(trial: Trial, variants: Sequence[Trial] = ()) -> list[Bar]:
    """A bar per run that decided, variants included, and per phase if revised; runs with equal decisions share one."""
    found: list[Bar] = []
    for t in (trial, *variants):
        extra = t.log.name.removeprefix(trial.log.name).strip(":+ ")
        grouped: dict[tuple[str, bytes, bytes], list[Run]] = {}
        for run in t.runs:
            if run.association != "none" and run.failure is None:
                key = (run.association, run.decisions.tobytes(), run.final_decisions.tobytes())
                grouped.setdefault(key, []).append(run)
        for runs in grouped.values():
            first, names = runs[0], ", ".join(style_of(r.estimator).label for r in runs)
            label = f"{first.association} ({names})" + (f", {extra}" if extra and t is not trial else "")
            implausible = [style_of(r.estimator).label for r in runs if r.implausible is not None]
            label += f", implausible: {', '.join(implausible)}" if implausible else ""
            online, final = (confusion_of(first, t.log, phase) for phase in ("online", "final"))
            if online is None or final is None:
                continue
            if all(getattr(online, p.key) == getattr(final, p.key) for p in PARTS):
                found.append(Bar(label, online))
            else:
                found += [Bar(f"{label}, online", online), Bar(f"{label}, final", final)]
    return found


@drawing()
def confusion_figure(title: str, shown: Sequence[Bar]) -> Figure:
    """Stacked bars of observation counts, FP and FN in numbers beside them; same colours in every figure."""
    names = [fill(b.label, LETTERS) if page_width() < NARROW else b.label for b in shown]
    height = 0.2 + 0.12 * max((n.count("\n") for n in names), default=0)
    fig = Figure(figsize=(page_width(), 1.35 + height * len(shown)))
    ax = fig.add_subplot()
    rows, left = np.arange(len(shown)), np.zeros(len(shown))
    present = [p for p in PARTS if any(b.length(p.key) for b in shown)]
    for part in present:
        width = np.array([b.length(part.key) for b in shown], float)
        ax.barh(rows, width, left=left, height=0.74, **part.look)
        left += width
    ax.set_yticks(rows, names)
    ax.set_ylim(len(shown) - 0.5, -0.5)
    ax.set_xlim(0.0, max(float(left.max(initial=0.0)), 1.0))
    ax.grid(axis="y", visible=False)
    ax.tick_params(axis="y", length=0)
    ax.set_xlabel("observations [–]")
    _numbers(ax, shown)
    finish(fig, title, [Patch(label=p.label, **p.look) for p in present], columns=3)
    return fig


def _numbers(ax: Axes, shown: Sequence[Bar]) -> None:
    """FP and FN of each bar, in columns to the right of it."""
    for column, (place, count) in enumerate(((1.065, "fp"), (1.125, "fn")), start=1):
        above, variants = ax.transAxes, ax.get_yaxis_transform()
        if page_width() < NARROW:  # there a share of the axes has no room for four digits
            place, right = 1.0, ScaledTranslation(points(NUMBER) * column / 72.0, 0.0, ax.figure.dpi_scale_trans)
            above, variants = above + right, variants + right
        ax.text(place, 1.02, count.upper(), transform=above, ha="right", va="bottom", fontsize=points(7), weight="bold")
        for row, bar in enumerate(shown):
            text = str(getattr(bar.counts, count))
            ax.text(place, row, text, transform=variants, ha="right", va="center", fontsize=points(7))


def has_outcomes(trial: Trial, variants: kinds.Variants = ()) -> bool:
    """Whether decisions were made (not only labels read) that can be scored."""
    each = ((r, t) for t in (trial, *variants) for r in t.runs if r.association != "known" and r.failure is None)
    return any(confusion_of(r, t.log, "online") is not None for r, t in each)


@kinds.figure("association", has_outcomes, kinds.SECTION, quick=True)
def _association(trial: Trial, variants: kinds.Variants) -> tuple[Figure, kinds.Facts]:
    return confusion_figure(f"{trial.log.name}, {trial.task}: decisions", bars(trial, variants)), {}
