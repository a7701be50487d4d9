"""Pictures of a laser log: occupancy grid and path, pose graph with loop closures, and these in the player."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke

from data.result import Run
from data.se2 import Array, BoolArray
from eval.figures.plane import draw_start, plan_axes
from eval.figures.style import DASHED, DOTTED, SOLID, Line, drawing, page_width, settle, style_of
from eval.player.pack import Pack
from eval.player.scene import dashes
from eval.referee.score import Trial
from wings.laser.scans.constraints import KEPT, LaserRun, Loops
from wings.laser.scans.occupancy import Grid
from wings.laser.score import wrong_closures

UNKNOWN_GREY, FREE_GREY = 0.85, 1.0
RARE = 0.005
"""Share of the known cells that may be left out at each edge: a beam through a window does not squash the picture."""
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
    title = f"{name}: pose graph of {style.label}, {len(loops)} loop closures looked at"
    _on_paper(fig, ax, low, high, title, handles)
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
