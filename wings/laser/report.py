"""The report's section on a laser log and its files: map pictures, `map.pgm` and `map.yaml`, loops.csv, graph.g2o.

Map files are as ROS map_server and nav2_map_server read them: a pixel v is occupied with (255 - v) / 255, north up.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from data.formats.g2o import MOTION, written
from data.log import Log, folder_name
from data.result import Run
from data.se2 import Array, BoolArray
from eval.figures.kinds import Facts, Kind, Variants
from eval.figures.plane import draw_start, plan_axes
from eval.figures.style import DASHED, DOTTED, SOLID, Line, drawing, page_width, save, settle, style_of
from eval.plan.flags.table import Output
from eval.player.pack import Pack
from eval.player.scene import dashes
from eval.referee import result_files
from eval.referee.given.runs import GivenRun
from eval.referee.relations import ALL, ROW, relation_rows
from eval.referee.score import Trial
from eval.report.page.blocks import Block, FinePrint, Picture, Section, folded
from eval.report.page.files import number, stem, written_table
from eval.report.words import paragraph, say, template_text
from wings.laser.scans.constraints import KEPT, LaserRun, Loops
from wings.laser.scans.occupancy import Grid, occupancy_grid
from wings.laser.score import mapped, wrong_closures

UNKNOWN_GREY, FREE_GREY = 0.85, 1.0
RARE = 0.005  # Share of known cells that may be left out at each edge: a beam through a window squashes no picture
END_COLOUR = "#F0E442"
AROUND = 1.0  # m of the plan about what is shown
LOOP_STATES: dict[str, tuple[str, Line, float]] = {
    "not believed": ("#BBBBBB", DOTTED, 0.7),
    "believed and kept": ("#0072B2", SOLID, 0.7),
    "believed, later switched off": ("#E69F00", DASHED, 1.3),
    "kept, though false": ("#B2182B", SOLID, 1.8),
}  # colour, line and width of a loop closure, in the order of drawing; dark, light and dashed for grey prints


@drawing()
def map_picture(grid: Grid, path: Array, *, name: str, estimator: str = "isam2", phase: str = "final") -> Figure:
    """The occupancy grid, dark where occupied, and an estimated path (N, 3) on it; metres, equal aspect."""
    fig = Figure()
    ax = fig.add_subplot()
    p = grid.probability  # free space is white and what is unknown light grey, however often either was looked at
    shade = np.where(
        grid.log_odds > 0.0, UNKNOWN_GREY * 2.0 * (1.0 - p), FREE_GREY - (FREE_GREY - UNKNOWN_GREY) * 2.0 * p
    )
    ax.imshow(shade, cmap="gray", vmin=0.0, vmax=1.0, origin="lower", extent=grid.extent, zorder=1)
    style = style_of(estimator)
    label = f"{style.label} ({phase})"
    handles: list[Line2D | Patch] = [*ax.plot(*path[:, :2].T, color=style.colour, linewidth=0.8, label=label, zorder=3)]
    handles += _ends(ax, path)
    handles += [
        Patch(facecolor="black", label="occupied"),
        Patch(facecolor="white", edgecolor="#A0A0A0", linewidth=0.5, label="free"),
        Patch(facecolor=str(UNKNOWN_GREY), label="never seen"),
    ]
    low, high = _shown(grid, path)
    _on_paper(fig, ax, low, high, f"{name}: occupancy grid, cells of {100.0 * grid.resolution:g} cm", handles)
    ax.grid(False)
    ax.set_facecolor(str(UNKNOWN_GREY))
    return fig


@drawing()
def loop_picture(
    keys: Array, loops: Loops, weight: Array, *, name: str, false: BoolArray | None = None, estimator: str = "isam2"
) -> Figure:
    """The pose graph at its end: key poses (K, 3) in a chain, a line for each loop closure in the colour of its state.
    `weight` (L,) 0 to 1: what the back end gives each in the end; `false` (L,): which are wrong, None without truth.
    """
    fig = Figure()
    ax = fig.add_subplot()
    style = style_of(estimator)
    dots: dict[str, Any] = {"color": "#404040", "linewidth": 0.6, "marker": ".", "markersize": 1.6}
    handles: list[Line2D | Patch] = [*ax.plot(*keys[:, :2].T, **dots, label="key poses", zorder=3), *_ends(ax, keys)]
    loop_state = loop_states(loops, weight, false)
    lines = np.stack([keys[loops.key1, :2], keys[loops.key2, :2]], axis=1)
    for order, (what, (colour, line, wide)) in enumerate(LOOP_STATES.items()):
        if what == "kept, though false" and false is None:
            continue
        some = loop_state == what
        look: dict[str, Any] = {"colors": colour, "linestyles": [line], "linewidths": wide, "zorder": 2.0 + 0.1 * order}
        ax.add_collection(LineCollection(list(lines[some]), **look), autolim=False)
        label = f"{what}: {np.count_nonzero(some)}"
        handles.append(Line2D([], [], color=colour, linestyle=line, linewidth=wide + 0.3, label=label))
    low, high = keys[:, :2].min(axis=0) - AROUND, keys[:, :2].max(axis=0) + AROUND
    _on_paper(fig, ax, low, high, f"{name}: pose graph of {style.label}, {len(loops)} loop closures looked at", handles)
    return fig


def loop_states(loops: Loops, weight: Array, false: BoolArray | None = None) -> Array:
    """What became of each loop closure, (L,) of the keys of `LOOP_STATES`."""
    kept = weight >= KEPT
    loop_state = np.where(kept, "believed and kept", "believed, later switched off").astype(object)
    if false is not None:
        loop_state[kept & false] = "kept, though false"
    loop_state[loops.believed < 0] = "not believed"
    return loop_state


def add_loops(pack: Pack, key: str, run: Run, trial: Trial, step: float) -> list[dict[str, Any]]:
    """Add a run's loop closures to the player; returns colour, line and name of each of their states."""
    if not isinstance(run, LaserRun) or run.loops is None or not len(run.loops):
        return []
    chain, loops, pose, _ = run.parts
    false = wrong_closures(run, trial.log.truth.pose)
    weight = np.ones(len(loops)) if run.weight is None else run.weight
    names, loop_state = list(LOOP_STATES), loop_states(loops, weight, false)
    pack.add(f"{key}key_frame", chain.frame)
    pack.add(f"{key}key_xy", pose[:, :2], step)
    pack.add(f"{key}loop_keys", np.column_stack([loops.key1, loops.key2]))
    pack.add(f"{key}loop_state", np.array([names.index(f) for f in loop_state]))
    told = [(name, of) for name, of in LOOP_STATES.items() if false is not None or name != names[-1]]
    return [{"name": name, "colour": colour, "dash": dashes(line)} for name, (colour, line, _) in told]


def _shown(grid: Grid, path: Array) -> tuple[Array, Array]:
    """Corners (2,) of what is worth showing: the path, and nearly all cells of which something is known."""
    low, high = path[:, :2].min(axis=0), path[:, :2].max(axis=0)
    rows, columns = np.nonzero(grid.log_odds)
    if len(rows):
        seen = np.quantile(np.stack([columns, rows], 1) * grid.resolution + grid.origin, (RARE, 1.0 - RARE), axis=0)
        low, high = np.minimum(low, seen[0]), np.maximum(high, seen[1])
    return low - AROUND, high + AROUND


def _ends(ax: Axes, path: Array) -> list[Line2D | Patch]:
    """Start, an arrowhead along the heading, and end of a path."""
    halo = [withStroke(linewidth=2.0, foreground="white")]
    square: dict[str, Any] = {"marker": "s", "markersize": 5, "color": END_COLOUR, "markeredgecolor": "black"}
    end = ax.plot(*path[-1, :2], linestyle="none", label="end", zorder=6, path_effects=halo, **square)
    return [*draw_start(ax, path[0], END_COLOUR, halo), *end]


def _on_paper(fig: Figure, ax: Axes, low: Array, high: Array, title: str, handles: list[Line2D | Patch]) -> None:
    """Axes, title, and paper cut to the scene, so that equal aspect leaves no blank."""
    plan_axes(ax, low, high)
    ax.set_title(title, loc="left")
    width = page_width()
    scene = (width - 0.65) * float((high[1] - low[1]) / (high[0] - low[0]))
    columns = 3 if width > 5.0 else 2
    fig.set_size_inches(width, float(np.clip(scene, 1.5, 1.3 * width)) + 0.6 + 0.155 * -(-len(handles) // columns))
    fig.legend(handles=handles, loc="outside lower left", ncols=columns)
    settle(fig)


FREE_PIXEL, OCCUPIED_PIXEL, UNKNOWN_PIXEL = 254, 0, 205  # as map_saver writes them
OCCUPIED_ABOVE, FREE_BELOW = 0.65, 0.35
"""Probabilities by which a cell is called occupied or free: map_saver's for the one, and as sure for the other, which
one beam more that crossed than ended here is not."""


def pixels(grid: Grid) -> NDArray[np.uint8]:
    """The picture (H, W), north up."""
    p = grid.probability
    cells = np.full(p.shape, UNKNOWN_PIXEL, np.uint8)
    cells[p > OCCUPIED_ABOVE] = OCCUPIED_PIXEL
    cells[p < FREE_BELOW] = FREE_PIXEL
    return cells[::-1]


def write_map(grid: Grid, folder: Path) -> list[Path]:
    """Write `map.pgm` and `map.yaml`; same grid, same bytes."""
    picture, text = folder / "map.pgm", folder / "map.yaml"
    rows = pixels(grid)
    folder.mkdir(parents=True, exist_ok=True)
    picture.write_bytes(f"P5\n{rows.shape[1]} {rows.shape[0]}\n255\n".encode("ascii") + rows.tobytes())
    x, y = (float(each) for each in grid.origin)
    about = template_text("map.yaml").format(image=picture.name, resolution=float(grid.resolution), x=x, y=y)
    text.write_text(about, encoding="utf-8")
    return [picture, text]


def grid_of(trial: Trial, run: LaserRun) -> Grid:
    """The occupancy grid of a run's key scans at its last key poses, in larger cells where 5 cm would be too many."""
    scans, (chain, _, keys, _) = trial.log.recorded.scans, run.parts
    assert scans is not None
    row = np.minimum(np.searchsorted(scans.frame, chain.frame), len(scans.frame) - 1)
    there = scans.frame[row] == chain.frame
    return occupancy_grid(keys[there], scans.ranges[row[there]], scans.scanner)


def write_laser_files(folder: Path, trial: Trial) -> None:
    """`map.png`, `map.pgm`, `map.yaml`, `loops.csv`, `graph.g2o` in `runs/<log>/`; nothing if no run matched scans."""
    run = mapped(trial)
    if run is None or run.loops is None:  # corners have no loops
        return
    place = folder / "runs" / folder_name(trial.log.name)
    place.mkdir(parents=True, exist_ok=True)
    grid = grid_of(trial, run)
    write_map(grid, place)
    save(_map_figure(trial, run, grid), place, "map", ("png",))
    # loops.csv: every loop closure looked at; accepted: it joined the graph, final: it kept its weight.
    (_, loops, _, _), (rows, columns) = run.parts, np.triu_indices(3)
    loop_state = [run.kept(phase).astype(int) for phase in ("online", "final")]
    covariance = loops.covariance[:, rows, columns].T
    values = [loops.key1, loops.key2, *loops.relative.T, *covariance, loops.score, *loop_state]
    result_files.LOOPS.write(pd.DataFrame(dict(zip(result_files.LOOPS.names, values, strict=True))), place)
    (place / "graph.g2o").write_text(graph_of(run), encoding="utf-8")


def graph_of(run: LaserRun) -> str:
    """The key poses with the motion between them and the loop closures that kept their weight, as text for g2o."""
    chain, loops, pose, _ = run.parts
    keys = range(len(pose))
    edges = [(MOTION, k - 1, k, chain.motion[k], chain.covariance[k]) for k in keys[1:]]
    for i in np.flatnonzero(run.kept("final")).tolist():
        edges.append((MOTION, int(loops.key1[i]), int(loops.key2[i]), loops.relative[i], loops.covariance[i]))
    return written((keys, pose), ((), np.zeros((0, 2))), (0,), edges)


def _map_figure(trial: Trial, run: LaserRun, grid: Grid) -> Figure:
    return map_picture(grid, run.parts[3], name=trial.log.name, estimator=run.estimator, phase=run.phases[-1])


def _grid(trial: Trial, _: Variants) -> tuple[Figure, Facts]:
    run = mapped(trial)
    assert run is not None
    return _map_figure(trial, run, grid_of(trial, run)), {"estimator": run.estimator, "phase": run.phases[-1]}


def _loops(trial: Trial, _: Variants) -> tuple[Figure, Facts]:
    run = mapped(trial)
    assert run is not None
    loops, keys = run.parts[1:3]
    weight, name = np.ones(len(loops)) if run.weight is None else run.weight, trial.log.name
    false = wrong_closures(run, trial.log.truth.pose)
    figure = loop_picture(keys, loops, weight, name=name, false=false, estimator=run.estimator)
    return figure, {"estimator": run.estimator, "phase": run.phases[-1]}


GRID = Kind(lambda trial, _: mapped(trial) is not None, _grid, in_quick=True, macro="laser#grid")
LOOPS = Kind(lambda trial, _: len(getattr(mapped(trial), "loops", None) or ()) > 0, _loops, macro="laser#loops")


def laser_sections(
    folder: Path, wanted: Output, trials: Sequence[Trial], published: Sequence[Sequence[Picture]],
    in_lab: bool = False, factor: int | None = 1,
) -> list[Section]:  # fmt: skip
    """A section for each laser log."""
    sections = []
    for trial, pictures in zip(trials, published, strict=True):
        run = mapped(trial)
        if run is None or trial.variant_of is not None:
            continue
        blocks: list[Block] = list(_relations(folder, wanted, trial))
        facts = facts_of(trial, run)
        blocks += folded(say("laser#statements", laser=facts), "The graph and time")
        blocks += [p for p in pictures if p.stem in (stem(trial, "grid"), stem(trial, "loops"))]
        sections.append(Section(f"Laser: {trial.log.name}", tuple(blocks), facts=facts))
    return sections


def _relations(folder: Path, wanted: Output, trial: Trial) -> list[Block]:
    rows = [row for run in trial.runs for row in _relation_rows(run, trial.log)]
    if not rows:
        return []
    caption = f"{trial.log.name}: errors against the reference relations, mean ± standard deviation."
    fine = FinePrint("Reference relations", paragraph("laser#relations"))
    return [written_table(pd.DataFrame(rows), folder, stem(trial, "relations"), caption, wanted, fine=fine)]


def _relation_rows(run: Run, log: Log) -> list[dict[str, object]]:
    if not isinstance(run, LaserRun) and not (isinstance(run, GivenRun) and run.log is log):
        return []
    rows = dict[str, dict[str, object]]()
    for e in relation_rows(run, log):
        row = rows.setdefault(e["phase"], {name: e[name] for name in ("estimator", "association", "phase")})
        row[f"{e['subset']} by {e['tie']} ({e['relations']}) [m]"] = f"{e['trans_mean_m']:.4f} ± {e['trans_std_m']:.4f}"
        if (e["tie"], e["subset"]) == (ROW, ALL):
            row["heading [°]"] = f"{e['rot_mean_deg']:.3f} ± {e['rot_std_deg']:.3f}"
            row["largest [m]"] = number(e["trans_max_m"])
    return list(rows.values())


def facts_of(trial: Trial, run: LaserRun) -> dict[str, object]:
    """Sizes of a laser log's graph, loop closures, time."""
    chain, loops, _, _ = run.parts
    recorded, seconds = trial.log.recorded, run.frame_seconds
    robust = [r for r in trial.runs if isinstance(r, LaserRun) and r.estimator in ("batch-cauchy", "gnc")]
    time = None
    if seconds is not None and not recorded.time_is_index:
        time = {
            "span": float(recorded.time[-1] - recorded.time[0]),  # s of driving
            "spent": float(seconds.sum()),
            "late": float(np.quantile(seconds, 0.99)),
            "longest": float(seconds.max()),
        }
    return {
        "scans": 0 if recorded.scans is None else len(recorded.scans.frame),
        "frames": len(recorded),
        "keys": len(chain.frame),
        "loops": len(loops),
        "believed": int((loops.believed >= 0).sum()),
        "left_out": tuple((r.estimator, int((r.weight < KEPT).sum())) for r in robust if r.weight is not None),
        "scale": run.scale,  # of the variances that scan matching claims, and its error
        "time": time,
    }
