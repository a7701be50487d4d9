"""The report's section on a laser log and its files: map pictures, `map.pgm` and `map.yaml`, loops.csv, graph.g2o.

Map files are as ROS map_server and nav2_map_server read them: a pixel v is occupied with (255 - v) / 255, north up.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from data.formats.g2o import MOTION, written
from data.log import Log, folder_name
from data.result import Run
from eval.figures.kinds import Facts, Kind, Variants
from eval.figures.style import save
from eval.plan.flags.table import Output
from eval.referee import result_files
from eval.referee.given.runs import GivenRun
from eval.referee.relations import ALL, ROW, relation_rows
from eval.referee.score import Trial
from eval.report.page.blocks import Block, FinePrint, Picture, Section, folded
from eval.report.page.files import stem, written_table
from eval.report.page.tables import number
from eval.report.words import say
from wings.laser.figures import loop_picture, map_picture
from wings.laser.scans.constraints import KEPT, LaserRun
from wings.laser.scans.occupancy import Grid, occupancy_grid
from wings.laser.score import mapped, wrong_closures

FREE_PIXEL, OCCUPIED_PIXEL, UNKNOWN_PIXEL = 254, 0, 205  # as map_saver writes them
OCCUPIED_ABOVE, FREE_BELOW = 0.65, 0.35
"""Probabilities by which a cell is called occupied or free: map_saver's for the one, and as sure for the other, which
one beam more that crossed than ended here is not."""
YAML = """\
image: {image}
mode: trinary
resolution: {resolution!r}
origin: [{x!r}, {y!r}, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""


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
    text.write_text(YAML.format(image=picture.name, resolution=float(grid.resolution), x=x, y=y), encoding="utf-8")
    return [picture, text]


GRAPH = "graph.g2o"


def phase_of(run: LaserRun) -> str:
    """Phase that its last path belongs to, in words."""
    return "final" if run.final is not None else "online"


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
    (place / GRAPH).write_text(graph_of(run), encoding="utf-8")


def graph_of(run: LaserRun) -> str:
    """The key poses with the motion between them and the loop closures that kept their weight, as text for g2o."""
    chain, loops, pose, _ = run.parts
    keys = range(len(pose))
    edges = [(MOTION, k - 1, k, chain.motion[k], chain.covariance[k]) for k in keys[1:]]
    for i in np.flatnonzero(run.kept("final")).tolist():
        edges.append((MOTION, int(loops.key1[i]), int(loops.key2[i]), loops.relative[i], loops.covariance[i]))
    return written((keys, pose), ((), np.zeros((0, 2))), (0,), edges)


def _map_figure(trial: Trial, run: LaserRun, grid: Grid) -> Figure:
    return map_picture(grid, run.parts[3], name=trial.log.name, estimator=run.estimator, phase=phase_of(run))


def _grid(trial: Trial, _: Variants) -> tuple[Figure, Facts]:
    run = _of(trial)
    return _map_figure(trial, run, grid_of(trial, run)), {"estimator": run.estimator, "phase": phase_of(run)}


def _loops(trial: Trial, _: Variants) -> tuple[Figure, Facts]:
    run = _of(trial)
    loops, keys = run.parts[1:3]
    weight, name = np.ones(len(loops)) if run.weight is None else run.weight, trial.log.name
    false = wrong_closures(run, trial.log.truth.pose)
    figure = loop_picture(keys, loops, weight, name=name, false=false, estimator=run.estimator)
    return figure, {"estimator": run.estimator, "phase": phase_of(run)}


def _of(trial: Trial) -> LaserRun:
    run = mapped(trial)
    assert run is not None
    return run


def _has_loops(trial: Trial, _: Variants) -> bool:
    run = mapped(trial)
    return run is not None and run.loops is not None and len(run.loops) > 0


GRID = Kind(lambda trial, _: mapped(trial) is not None, _grid, in_quick=True, macro="laser#grid")
LOOPS = Kind(_has_loops, _loops, macro="laser#loops")


RELATIONS_CAPTION = "errors against the reference relations, mean ± standard deviation."
RELATIONS_FINE = FinePrint(
    "Reference relations",
    "A relation is tied to frames by its *row* in"
    " the log, or by its *time* stamp, which in bursts of stamps is another frame; *exact*: relations whose frames are"
    " sure. Errors are (a⁻¹b)·rel⁻¹.",
)


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
    caption = f"{trial.log.name}: {RELATIONS_CAPTION}"
    return [written_table(pd.DataFrame(rows), folder, stem(trial, "relations"), caption, wanted, fine=RELATIONS_FINE)]


def _relation_rows(run: Run, log: Log) -> list[dict[str, object]]:
    if not isinstance(run, LaserRun) and not (isinstance(run, GivenRun) and run.log is log):
        return []
    rows = dict[str, dict[str, object]]()
    for e in relation_rows(run, log):
        row = rows.setdefault(e["phase"], {name: e[name] for name in ("estimator", "association", "phase")})
        spread = f"{e['trans_mean_m']:.4f} ± {e['trans_std_m']:.4f}"
        row[f"{e['subset']} by {e['tie']} ({e['relations']}) [m]"] = spread
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
