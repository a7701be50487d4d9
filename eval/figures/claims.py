"""Claims over time: NEES of one run and of many, NIS, sigmas, their growth, systematic errors; of studies, by rate."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from data.inputs import ERRORS, Systematic
from data.log import Log
from data.result import Run, Systematics
from data.se2 import Array
from data.terminal import counted
from data.words import number
from eval.figures import kinds, style as house
from eval.figures.error import heading_of, longest_sigma, panels, sigmas, thinned, ticks, time_axis
from eval.figures.plane import SIGMAS, longest_axis
from eval.referee.consistency import anees_band, mean_or_nan, nees, nis_bounds
from eval.referee.given.runs import log_of
from eval.referee.score import Trial
from eval.replay.settings import ESTIMATORS, associations

WINDOWS = 40  # stretches that a log is cut into for its NIS; each has the same number of degrees of freedom, or nearly
LEAST = 20  # degrees of freedom of a stretch: fewer have bounds so wide that nothing is ever outside
BINS = 200  # stretches in a curve of sigmas, which are smooth
LOG_ABOVE = 10.0  # the axis of NIS becomes logarithmic where a stretch exceeds the upper bound this many times


class Stretches(NamedTuple):
    """NIS per degree of freedom (K,) of stretches that begin and end at the instants edge (K + 1,), bounds (K, 2)."""

    edge: Array
    nis: Array
    bounds: Array


def stretches_of(time: Array, run: Run) -> Stretches | None:
    """NIS in stretches of equal degrees of freedom, with bounds that heed the gate; None without innovations."""
    if run.innovations is None:
        return None
    nis, dof = run.innovations.nis, np.where(np.isfinite(run.innovations.nis), run.innovations.dof, 0)
    total = int(dof.sum())
    if total == 0:
        return None
    count = max(min(WINDOWS, total // LEAST), 1)
    ends = np.searchsorted(np.cumsum(dof), total * np.arange(1, count + 1) / count)
    ends = np.unique(np.minimum(ends, len(nis) - 1))
    starts = np.concatenate([[0], ends[:-1] + 1])
    spent = np.add.reduceat(dof, starts)
    value = np.add.reduceat(np.nan_to_num(nis), starts) / np.maximum(spent, 1)
    bounds = np.array([nis_bounds(int(d), run.gated) if d else (np.nan, np.nan) for d in spent])
    return Stretches(np.concatenate([time[:1], time[ends]]), np.where(spent > 0, value, np.nan), bounds)


@house.drawing()
def claims_figure(log: Log, runs: Sequence[Run]) -> Figure:
    """NIS per dof over time, and claimed σ of position (least certain direction) and heading; no truth used."""
    shown = [s for s in house.series(runs) if s.run.estimator != "dead-reckoning"] or house.series(runs)
    fig = Figure(figsize=(house.page_width(), 4.6))
    top, middle, low = fig.subplots(3, 1, sharex=True, height_ratios=(1.3, 1.0, 1.0))
    handles: list[Line2D | Patch] = []
    found: list[Stretches] = []
    for s in shown:
        own = log_of(s.run, log).recorded.time
        stretches = stretches_of(own, s.run) if s.phase == "online" else None
        label, look = s.label, dict[str, Any](color=s.colour, linestyle=s.line, linewidth=0.9)
        if stretches is not None:
            found.append(stretches)
            top.stairs(stretches.nis, stretches.edge, baseline=None, zorder=3, **look)
            inside = (stretches.nis >= stretches.bounds[:, 0]) & (stretches.nis <= stretches.bounds[:, 1])
            label += f": NIS inside in {int(inside.sum())} of {len(inside)} stretches"
        for ax, curve in ((middle, longest_sigma(s.trajectory)), (low, np.degrees(sigmas(s.trajectory)[:, 2]))):
            keep = thinned(curve, BINS)
            ax.plot(own[keep], curve[keep], **look)
        handles.append(house.key(label, **look))
    _nis_axis(top, found)
    for ax, name in ((middle, "position σ [m]"), (low, "heading σ [deg]")):
        ax.set_ylabel(name)
        ax.set_ylim(bottom=0.0)
        ax.yaxis.set_major_locator(ticks(4))
    time_axis(low, log.recorded)
    if found:
        handles += [Patch(label="95 % bounds of NIS", **house.BAND), house.key("expected NIS", **house.EXPECTED)]
    house.finish(fig, f"{log.name}: what the runs say of themselves", handles)
    return fig


def _nis_axis(ax: Axes, found: Sequence[Stretches]) -> None:
    ax.set_ylabel("NIS per dof [–]")
    if not found:
        ax.text(0.5, 0.5, "no innovations were formed", transform=ax.transAxes, ha="center", va="center")
        return
    # stretches of the runs differ by a few frames; the widest bounds are those of the fewest degrees of freedom
    first = max(found, key=lambda s: float(np.nanmax(np.ptp(s.bounds, axis=1))))
    lower, upper = first.bounds.T
    ax.stairs(upper, first.edge, baseline=lower, fill=True, **house.BAND)
    ax.axhline(float(np.nanmean(first.bounds)), **house.EXPECTED, zorder=1.5)
    _scale([ax], [s.nis for s in found], float(np.nanmin(lower)), float(np.nanmax(upper)))


HEIGHT = 1.25  # in, of a row of panels
SETTLED = 0.2  # share of a log after which its estimates have to fit into their panel; before, they may leave it


@house.drawing()
def systematic_figure(log: Log, systematic: Systematic, runs: Sequence[Run]) -> Figure:
    """Each error over time, online (dashed beside a final one) and final, ±3σ; band: the prior; black: the truth."""
    columns = min(2, len(systematic.names))
    rows = -(-len(systematic.names) // columns)
    fig = Figure(figsize=(house.page_width(), 0.9 + HEIGHT * rows))
    axes: list[Axes] = list(np.ravel(fig.subplots(rows, columns, sharex=True, squeeze=False)))
    drawn: list[tuple[Run, Systematics, house.Line, str]] = []
    for r in runs:
        line = house.SOLID if r.errors_final is None else house.DASHED
        drawn += [] if r.errors_online is None else [(r, r.errors_online, line, "online")]
        drawn += [] if r.errors_final is None else [(r, r.errors_final, house.SOLID, "final")]
    time, truth = log.recorded.time, log.truth.errors
    for i, (name, ax) in enumerate(zip(systematic.names, axes, strict=False)):
        before = 3.0 * float(systematic.sigma[i])
        ax.axhspan(-before, before, **house.BAND)
        ax.axhline(0.0, color="#909090", linewidth=0.5)
        reach = 0.0
        for run, errors, dashes, _ in drawn:
            mean, bound = errors.mean[:, i], 3.0 * errors.sigma[:, i]
            colour = house.style_of(run.estimator).colour
            keep = np.unique(np.concatenate([thinned(mean), thinned(bound)]))
            low, high = (mean - bound)[keep], (mean + bound)[keep]
            ax.fill_between(time[keep], low, high, color=colour, alpha=0.15, linewidth=0)
            ax.plot(time[keep], mean[keep], color=colour, linestyle=dashes, linewidth=0.9)
            late = slice(int(SETTLED * len(time)), None)
            reach = max(reach, float(np.nanmax(np.abs(mean[late]) + bound[late], initial=0.0)))
        if truth is not None:
            true = truth.mean[:, truth.names.index(name)] if name in truth.names else np.zeros(len(time))
            ax.plot(time, true, color=house.TRUTH_COLOUR, linewidth=0.8, linestyle=house.DASHED)
            reach = max(reach, float(np.abs(true).max()))
        limit = 1.1 * (reach or before)
        ax.set(ylim=(-limit, limit), ylabel=name if ERRORS[name] == "1" else f"{name} [{ERRORS[name]}]")
        ax.yaxis.set_major_locator(ticks(5))
    for ax in axes[len(systematic.names) :]:
        ax.set_visible(False)
    for ax in axes[max(0, len(systematic.names) - columns) : len(systematic.names)]:
        ax.tick_params(labelbottom=True)
        time_axis(ax, log.recorded)
    handles: list[Line2D | Patch] = []
    for run, _, dashes, when in drawn:
        style = house.style_of(run.estimator)
        handles.append(house.key(f"{style.label} ({when})", color=style.colour, linestyle=dashes))
    if truth is not None:
        handles.append(house.key("true error", color=house.TRUTH_COLOUR, linestyle=house.DASHED, linewidth=0.8))
    handles.append(Patch(label="known before (±3σ)", **house.BAND))
    house.finish(fig, f"{log.name}: systematic errors as estimated along, with ±3σ", handles, 4)
    return fig


POSE_DOF = 3
MARKERS = 8  # about so many on a curve of many, staggered: in grey the lines alone are too alike


def _band(ax: Axes, lower: float, upper: float, dof: int) -> None:
    ax.axhspan(lower, upper, zorder=1, **house.BAND)
    ax.axhline(dof, **house.EXPECTED, zorder=1.5)


def _scale(axes: Sequence[Axes], curves: Sequence[Array], lower: float, upper: float) -> None:
    """Linear from 0, or logarithmic if the curves need it; the same for all axes."""
    finite = np.concatenate([c[np.isfinite(c)] for c in curves] or [np.empty(0)])
    highest = float(np.quantile(finite, 0.999)) if len(finite) else 0.0
    for ax in axes:
        if highest > LOG_ABOVE * upper:
            low = min(0.5 * lower, float(np.quantile(finite[finite > 0.0], 0.02)))
            ax.set_yscale("log")
            ax.set_ylim(max(low, 1e-3), 1.5 * float(finite.max()))
            if highest < 1e4:
                ax.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{y:g}"))
        else:
            ax.set_ylim(0.0, 1.08 * max(highest, 1.2 * upper))
            ax.yaxis.set_major_locator(ticks(5))


@house.drawing()
def nees_figure(log: Log, runs: Sequence[Run]) -> Figure:
    """NEES of the pose (or position) per frame of every phase, its mean, and the 95 % band of one value."""
    shown, remark = panels(runs)
    rows = max(len(shown), 1)
    fig = Figure(figsize=(house.page_width(), 1.0 + 1.15 * rows))
    axes = list(fig.subplots(rows, 1, sharex=True, squeeze=False)[:, 0])
    of, dof = ("pose", POSE_DOF) if log.truth.has_headings else ("position", POSE_DOF - 1)
    lower, upper = anees_band(dof, 1)
    curves = []
    for ax, s in zip(axes, shown, strict=False):
        t, own = s.trajectory, log_of(s.run, log)
        at, truth = own.recorded.time, own.truth.pose
        values = np.full(len(at), np.nan) if truth is None else nees(t.pose, t.covariance, truth, of)
        curves.append(values)
        _band(ax, lower, upper, dof)
        keep = thinned(values)
        ax.plot(at[keep], values[keep], color=s.colour, linewidth=0.7, zorder=2)
        mean = mean_or_nan(values)
        measured = f"mean {number(mean)}" if np.isfinite(mean) else "nothing to compare with"
        ax.set_title(f"{heading_of(s)}: {measured}".replace("\n", ", "), loc="left")
        ax.set_ylabel(f"{of} NEES [–]")
    _scale(axes, curves, lower, upper)
    time_axis(axes[-1], log.recorded)
    handles = _handles(dof, f"95 % of single values, χ² with dof {dof}")
    house.finish(fig, f"{log.name}: {of} NEES of one run{remark}", handles)
    return fig


def _handles(dof: int, band: str) -> list[Line2D | Patch]:
    return [Patch(label=band, **house.BAND), house.key(f"expected of a consistent estimator: {dof}", **house.EXPECTED)]


@house.drawing()
def anees_figure(
    time: Array, average: Mapping[str, Array], dof: int, runs: int, *, title: str = "", time_is_index: bool = False
) -> Figure:
    """NEES averaged over `runs` Monte Carlo runs at each instant (N,) by estimator, with its 95 % band."""
    fig = Figure(figsize=(house.page_width(), 2.7 + 0.13 * ((len(average) + 3) // 2)))
    ax = fig.add_subplot()
    lower, upper = anees_band(dof, runs)
    _band(ax, lower, upper, dof)
    handles: list[Line2D | Patch] = []
    few = max(len(time) // MARKERS, 1)
    for i, (name, values) in enumerate(average.items()):
        style, first = house.style_of(name), few * i // len(average)
        mean, known = mean_or_nan(values), values[np.isfinite(values)]
        outside = float(np.mean((known < lower) | (known > upper))) if len(known) else np.nan
        label = style.label + (f": mean {number(mean)}, {100.0 * outside:.0f} % outside" if len(known) else "")
        handles += ax.plot(time, values, markevery=(first, few), markersize=3.0, label=label, zorder=2, **style.look)
    _scale([ax], list(average.values()), lower, upper)
    ax.set(ylabel="average pose NEES [–]", xlabel="frame" if time_is_index else "time [s]")
    if len(time) > 1:
        ax.set_xlim(time[0], time[-1])
    what = f"average pose NEES over {counted(runs, 'run')}, dof {dof}"
    ax.set_title(f"{title}: {what}" if title else what[0].upper() + what[1:], loc="left")
    handles += _handles(dof, f"95 % band {lower:.2f} to {upper:.2f}: 5 % outside by design")
    fig.legend(handles=handles, loc="outside lower center", ncols=2, handlelength=house.LONG_HANDLE)
    return fig


@kinds.figure("nees", lambda trial, _: kinds.measured(trial) and bool(kinds.claiming(trial)), kinds.FRONT)
def _nees(trial: Trial, _: kinds.Variants) -> tuple[Figure, kinds.Facts]:
    shown = kinds.for_panels(kinds.claiming(trial))
    return nees_figure(trial.log, shown), {"others": kinds.left_out(trial, shown, kinds.unclaimed)}


@kinds.figure("claims", lambda trial, _: kinds.blind(trial) and bool(kinds.claiming(trial)), kinds.FRONT)
def _claims(trial: Trial, _: kinds.Variants) -> tuple[Figure, kinds.Facts]:
    shown = kinds.for_panels(kinds.claiming(trial))
    return claims_figure(trial.log, shown), {"others": kinds.left_out(trial, shown, kinds.unclaimed)}


@kinds.figure("systematic", lambda trial, _: bool(kinds.calibrated(trial)), kinds.SECTION, quick=True)
def _systematic(trial: Trial, _: kinds.Variants) -> tuple[Figure, kinds.Facts]:
    runs, systematic = kinds.calibrated(trial), trial.log.recorded.systematic
    assert systematic is not None  # or nothing was estimated
    return systematic_figure(trial.log, systematic, runs), {"runs": runs}


LOG_RATIO = 12.0  # a column's axes become logarithmic where its values span more than this factor
SPREAD = 0.6  # width over which the estimators of one rate are spread; 1 is the distance between rates
PANELS = (
    ("rmse_position_m", "rmse_lower", "rmse_upper", "RMSE position [m]"),
    ("nees_pose", "nees_lower", "nees_upper", "pose NEES [–]"),
)  # value, bounds and label of each column of panels


@house.drawing()
def outlier_figure(table: pd.DataFrame, title: str) -> Figure:
    """Position RMSE and pose NEES with their intervals against the share of wrong associations, a row per task. `table`
    has a row per task, estimator and rate, with the columns of `PANELS`; NaN values are gaps.
    """
    tasks, names = list(dict.fromkeys(table["task"])), list(dict.fromkeys(table["estimator"]))
    rates = sorted({float(r) for r in table["rate"]})
    rows = max(len(tasks), 1)
    columns = min(len(names) + 1, 4)
    fig = Figure(figsize=(house.page_width(), 0.75 + 1.9 * rows + 0.13 * -(-(len(names) + 1) // columns)))
    axes = fig.subplots(rows, len(PANELS), sharex=True, squeeze=False)
    for row, task in zip(axes, tasks, strict=False):
        for ax, (value, lower, upper, label) in zip(row, PANELS, strict=True):
            part = table[table["task"] == task]
            for i, name in enumerate(names):
                offset = SPREAD * ((i + 0.5) / len(names) - 0.5)
                curve = part[part["estimator"] == name].sort_values("rate")
                y, low, high = (curve[c].to_numpy(float) for c in (value, lower, upper))
                x = np.searchsorted(rates, curve["rate"].to_numpy(float)) + offset
                bars = np.nan_to_num(np.abs(np.stack([y - low, high - y])), posinf=0.0)
                look = house.style_of(name).look
                ax.errorbar(x, y, bars, markersize=3.5, elinewidth=0.8, capsize=1.2, zorder=2, **look)
            if value == "nees_pose":
                ax.axhline(POSE_DOF, **house.EXPECTED, zorder=1.5)
            _scale_of_rates(ax, part[value].to_numpy(float))
            ax.set_title(task, loc="left")
            ax.set_ylabel(label)
    for ax in axes[-1]:
        ax.set_xlabel("wrong associations [%]")
        ax.set_xticks(range(len(rates)), [f"{100.0 * r:g}" for r in rates])
    handles = [house.key(s.label, **s.look) for s in map(house.style_of, names)]
    handles.append(house.key(f"expected NEES: {POSE_DOF}", **house.EXPECTED))
    house.finish(fig, f"{title}: wrong associations put in", handles, columns, handlelength=house.LONG_HANDLE)
    return fig


def _scale_of_rates(ax: Axes, values: Array) -> None:
    """Linear from 0, or logarithmic where the values span more than `LOG_RATIO`."""
    values = values[np.isfinite(values) & (values > 0.0)]
    if len(values) and values.max() > LOG_RATIO * values.min():
        ax.set_yscale("log")
        span = values.max() / values.min()
        subs = (1.0, 2.0, 5.0) if span < 100.0 else (1.0, 3.0) if span < 1e3 else (1.0,)
        ax.yaxis.set_major_locator(LogLocator(10.0, subs=subs))
        ax.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{y:g}" if 1e-3 <= y < 1e5 else f"{y:.0e}"))
        ax.yaxis.set_minor_formatter(NullFormatter())
    else:
        ax.set_ylim(0.0, None)
        ax.yaxis.set_major_locator(ticks(5))


LOOP = 0.3  # a landmark seen again after this share of the run means that a loop was closed


def closing_frame(log: Log, run: Run) -> int | None:
    """First frame that pairs a landmark unseen for a good part of the run; None if no loop is closed."""
    frames = log.recorded.observations.frame
    number = np.where(run.created >= 0, run.created, run.decisions)
    last: dict[int, int] = {}
    for frame, n in zip(frames.tolist(), number.tolist(), strict=True):
        if n >= 0:
            if frame - last.get(n, frame) > LOOP * len(log.recorded):
                return int(frame)
            last[n] = frame
    return None


@house.drawing()
def growth_figure(log: Log, runs: Sequence[Run]) -> Figure:
    """Standard deviation, along its least certain direction, of the robot online and of each landmark in the last map.
    A vertical line marks the frame that closed a loop.
    """
    time = log.recorded.time
    fig = Figure(figsize=(house.page_width(), 2.9))
    robot, landmarks = fig.subplots(1, 2)
    for i, run in enumerate(runs):
        style, sigma = house.style_of(run.estimator), longest_sigma(run.trajectory("online"))
        known = sigma[np.isfinite(sigma)]
        most, end = (float(known.max()), float(known[-1])) if len(known) else (np.nan, np.nan)
        label = f"{style.label}, {run.association}: at most {number(most)} m, {number(end)} m at the end"
        line = house.SOLID if i == 0 else house.DASHED
        robot.plot(time, sigma, color=style.colour, linestyle=line, linewidth=1.2, label=label)
        if run.map is not None and len(run.map):
            last = longest_axis(run.map.covariance) / SIGMAS
            face, size = (style.colour, 2.2) if i == 0 else ("none", 4.0)
            look = dict[str, Any](markeredgecolor=style.colour, markeredgewidth=0.7)
            landmarks.plot(run.map.number, last, "o", markersize=size, markerfacecolor=face, **look)
    closed = next((f for f in (closing_frame(log, r) for r in runs) if f is not None), None)
    if closed is not None:
        robot.axvline(
            time[closed], color="#505050", linestyle=house.DOTTED, linewidth=1.0, label="first landmarks seen again"
        )
    robot.set(ylabel="robot σ [m]", ylim=(0.0, None))
    time_axis(robot, log.recorded)
    landmarks.set(xlabel="landmark number [–]", ylabel="landmark σ [m]", ylim=(0.0, None))
    for ax in (robot, landmarks):
        ax.xaxis.set_major_locator(ticks(6))
        ax.yaxis.set_major_locator(ticks(6))
    robot.set_title("robot, online", loc="left")
    landmarks.set_title("landmarks in the last map, in order of initialization", loc="left")
    handles: Any = robot.get_legend_handles_labels()[0]
    house.finish(fig, f"{log.name}: claimed σ along the least certain direction", handles, 1 if len(handles) > 3 else 2)
    return fig


def growing(trial: Trial) -> list[Run]:
    """A filter and an incremental smoother under one association, known if there is one: how uncertainty grew."""
    estimates = [r for r in kinds.plausible(trial) if r.task == "slam" and r.online is not None and r.map is not None]
    order = associations(estimates)
    alike = [r for r in estimates if r.association == order[0]] if order else []
    found = [next((r for r in alike if r.estimator == name), None) for name in ("ekf", "isam2")]
    found += [r for r in alike if r.estimator not in ESTIMATORS and kinds.has_covariance(r)]
    return [r for r in found if r is not None]


def _in_numbers(trial: Trial, run: Run) -> dict[str, object]:
    """Standard deviations [m] along the least certain direction: of the robot online, and of the last landmarks."""
    closed, sigma = closing_frame(trial.log, run), longest_sigma(run.trajectory("online"))
    before = float(sigma[closed - 1]) if closed is not None and closed > 0 else None
    made: dict[str, object] = {"estimator": run.estimator, "at_most": float(np.nanmax(sigma))}
    # landmarks: of the first, the last, and the least certain one
    made |= {"at_end": float(sigma[-1]), "before_closing": before, "landmarks": None}
    if run.map is not None and len(run.map):
        each = longest_axis(run.map.covariance) / SIGMAS
        largest = int(each.argmax())
        made["landmarks"] = (float(each[0]), float(each[-1]), float(each[largest]))
        made["number"] = int(run.map.number[largest])
    return made


@kinds.figure("growth", lambda trial, _: trial.log.truth.known_poses > 0 and bool(growing(trial)))
def _growth(trial: Trial, _: kinds.Variants) -> tuple[Figure, kinds.Facts]:
    runs = growing(trial)
    grown = [_in_numbers(trial, r) for r in runs]
    alike = replace(trial, runs=tuple(r for r in trial.runs if r.association == runs[0].association))
    others = kinds.left_out(alike, runs, lambda run: "online" if run.online is None or run.map is None else "room")
    return growth_figure(trial.log, runs), {"association": runs[0].association, "grown": grown, "others": others}
