"""The report's section on a log made from images: models, plan, what was found in the images, and how well.

The equations in `templates/models/` are those of `data.motion.velocity.step`, `data.se2.compose` and
`data.sensors.measure`; a test evaluates their entries and compares.
"""

import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray
from PIL import Image

from data.log import Log, folder_name
from data.pictures import COMMAND_SIGMA, Evidence, Found, true_pictures
from data.result import Run
from data.se2 import Array
from data.terminal import counted
from eval.figures.kinds import for_map, left_out
from eval.figures.map import enlarged, map_figure
from eval.figures.style import SINGLE, across, drawing, page_width, save, save_for_page
from eval.plan.flags.table import Output
from eval.referee.score import Trial
from eval.report.page.blocks import Block, Formula, Picture, Section
from eval.report.page.files import drop_blank_columns, stem, written_table
from eval.report.words import one_line, say, template_text
from wings.camera.detector import outlined

CAPTION, LINE = 6.5, 0.115  # pt, in. A tile's caption, and the height of a line of it


def contact_sheet(tiles: Sequence[tuple[NDArray[np.uint8], Sequence[str]]], title: str) -> Figure:
    """Images (H, W, 3) side by side, RGB, with lines of text below each."""
    columns = min(len(tiles), 2 if len(tiles) in (2, 4) else across(3))
    width = SINGLE if columns == 1 else page_width()
    side = width / columns
    captions = ["\n".join(fill(t, round(20.0 * side)) for t in lines) for _, lines in tiles]
    high = max(image.shape[0] / image.shape[1] for image, _ in tiles) * side
    high += LINE * (max(c.count("\n") for c in captions) + 2)
    with drawing():
        fig = Figure(figsize=(width, 0.3 + high * -(-len(tiles) // columns)))
        axes = fig.subplots(-(-len(tiles) // columns), columns, squeeze=False)
        for ax in axes.flat:
            ax.set_axis_off()
        for ax, (image, _), caption in zip(axes.flat, tiles, captions, strict=False):
            ax.imshow(image)
            ax.text(0.0, -0.02, caption, transform=ax.transAxes, va="top", fontsize=CAPTION)
        fig.suptitle(fill(title, round(16.0 * width)), x=0.01, ha="left", fontsize=8.0)
        return fig


def plan_figure(
    log: Log, runs: Sequence[Run], corners: Array, *, width: float | None = None, factor: int | None = 1
) -> Figure:
    """The map figure with pictures in place of landmarks: corners (L, 4, 2) m as in `data.pictures.VisualSetup`."""
    return map_figure(log, runs, width=width, surveyed=lambda ax: draw_pictures(ax, corners), factor=factor)


def draw_pictures(ax: Axes, corners: Array) -> list[Line2D]:
    """Pictures seen from above, thick lines on their walls, each with its number behind it; what the legend shows."""
    halo = [withStroke(linewidth=1.5, foreground="white")]
    drawn: list[Line2D] = []
    for number, (left, right) in enumerate(corners[:, :2]):
        look = dict[str, Any](color="black", linewidth=3.2, solid_capstyle="butt", zorder=4)
        drawn = ax.plot(*np.stack([left, right], axis=1), label="pictures (number behind)", **look)
        # seen from in front the left corner is to the left, so what is behind is a quarter turn left of left to right
        along = right - left
        length = math.hypot(*along.tolist())
        behind = np.array([-along[1], along[0]]) / length if length > 0.0 else np.zeros(2)
        at = dict[str, Any](textcoords="offset points", ha="center", va="center_baseline", fontsize=6.5)
        middle, away = tuple(0.5 * (left + right)), tuple(6.5 * behind)
        ax.annotate(str(number), middle, xytext=away, color="black", path_effects=halo, zorder=5.5, **at)
    return drawn


@dataclass(frozen=True)
class Model:
    """What is modelled; `name` is its part of file names."""

    name: str
    title: str

    @property
    def about(self) -> str:
        """The model in words, plain text."""
        return one_line(say(f"models/{self.name}"))

    @property
    def latex(self) -> str:
        """The equations, aligned, as what stands in math mode (needs amsmath)."""
        return template_text(f"models/{self.name}.tex").strip()

    @property
    def formula(self) -> Formula:
        """The equations as a block of the report."""
        return Formula(self.latex, template_text(f"models/{self.name}.mathml").strip())


MOTION, OBSERVATION = Model("motion", "Motion model"), Model("observation", "Observation model")
UPDATE = Model("update", "Update")
HEADS = (
    *("picture", "frames in view", "of these found", "recall [%]", "detections", "wrong", "not judged"),
    *("inliers, median", "corner error, median [px]"),
)  # of a table of pictures
MODELS = (MOTION, OBSERVATION, UPDATE)


def write_models(folder: Path, wanted: Output, log: Log) -> None:
    """Write words and equations of the models as LaTeX (it needs amsmath) below `tables/`, where that is asked for."""
    if "tex" in wanted.formats:
        (folder / "tables").mkdir(parents=True, exist_ok=True)
        place = folder / "tables" / f"{folder_name(log.name)}-models.tex"
        place.write_text(say("models/all", models=MODELS) + "\n", encoding="utf-8", newline="\n")


def statistics_of(evidence: Evidence) -> pd.DataFrame:
    """A row per picture with a column for each reason it was not found; unknown is blank. In view: fully, near, not too
    oblique; of these found: where it is; wrong: on another picture in view, or elsewhere than this one.
    """
    found, truth = evidence.found, evidence.in_view
    shown = None if truth is None else true_pictures(found, truth)
    rows = []
    for p, refused in enumerate(found.refused):
        own = found.picture == p
        row: dict[str, object] = dict.fromkeys(HEADS)
        row |= {"picture": p, "detections": int(own.sum())}
        if own.any():
            row["inliers, median"] = float(np.median(found.inliers[own]))
        if truth is not None and shown is not None:
            there = truth.picture == p
            at = {int(f): k for f, k in zip(truth.frame[there], np.flatnonzero(there), strict=True)}
            pairs = [(d, at[int(found.frame[d])]) for d in np.flatnonzero(own & (shown == p))]
            off = [np.linalg.norm(found.pixels[d] - truth.pixels[k], axis=1) for d, k in pairs]
            wrong = int((own & (shown != p) & ((shown >= 0) | np.isin(found.frame, list(at)))).sum())
            row |= {
                "frames in view": len(at), "of these found": len(pairs),
                "recall [%]": 100.0 * len(pairs) / len(at) if at else None,
                "wrong": wrong,
                "not judged": int(own.sum()) - len(pairs) - wrong,
                "corner error, median [px]": float(np.median(off)) if off else None,
            }  # fmt: skip
        rows.append(row | {f"not found: {reason}": refused.get(reason, 0) for reason in found.rejected})
    return pd.DataFrame(rows, dtype=object)


def detection_table(stats: pd.DataFrame) -> pd.DataFrame:
    """The pictures that were found or in view; reasons by frequency, the most frequent first."""
    seen = stats[[bool(row["detections"] or row["frames in view"]) for _, row in stats.iterrows()]]
    total = seen[[c for c in seen if c not in HEADS]].sum()
    return seen[[*HEADS, *sorted(total[total > 0].index, key=lambda c: (-total[c], c))]]


def tiles_of(evidence: Evidence) -> list[tuple[NDArray[np.uint8], list[str]]]:
    """The frames kept to look at, what was found outlined, with their names and, by the truth, what was missed."""
    found, truth, tiles = evidence.found, evidence.in_view, []
    for frame, image in found.tiles:
        rgb = np.asarray(Image.open(io.BytesIO(image)).convert("RGB"))
        here = np.flatnonzero(found.frame == frame)
        lines = [f"frame {frame}, {found.time[frame] - found.time[0]:.1f} s"]
        if truth is not None:
            missed = sorted(set(truth.picture[truth.frame == frame].tolist()) - set(found.picture[here].tolist()))
            lines += [f"in view, not found: {', '.join(map(str, missed))}"] if missed else []
        tiles.append((outlined(rgb, [(str(found.picture[d]), found.pixels[d]) for d in here], bold=3), lines))
    return tiles


def sheet(folder: Path, log: Log, evidence: Evidence) -> list[Picture]:
    """The contact sheet of a log, drawn; none without frames."""
    name, tiles = f"{folder_name(log.name)}-detections", tiles_of(evidence)
    if not tiles:
        return []
    # images are the whole figure: as PDF it would be many times as large and show no more
    save(contact_sheet(tiles, f"{log.name}: pictures found, with their numbers"), folder / "figures", name, ("png",))
    caption = say("visual#sheet", log=log.name, shown=len(tiles), frames=len(evidence.found.time))
    return [Picture(name, caption, f"{counted(len(tiles), 'frame')} of {log.name} with outlined pictures")]


def visual_sections(
    folder: Path, wanted: Output, trials: Sequence[Trial], _pictures: Sequence[Sequence[Picture]] = (),
    in_lab: bool = False, factor: int | None = 1,
) -> list[Section]:  # fmt: skip
    """For each log made from images: models and contact sheet (in a lab answers have them), plans, statistics."""
    logs = {t.log.name: t.log for t in trials if t.log.evidence is not None and t.variant_of is None}
    sections = []
    for name, log in logs.items():
        assert log.evidence is not None
        facts = (_constants(log), _detected(statistics_of(log.evidence), log.evidence.found))
        blocks = [] if in_lab else list(models(folder, wanted, log))
        own = [t for t in trials if t.log is log and not wanted.no_plots]
        blocks += [_plan(folder, t, None if in_lab else factor) for t in own]
        blocks += _detections(folder, wanted, log, log.evidence, in_lab=in_lab)
        page = "" if in_lab else f"{folder_name(name)}-pictures"
        sections.append(Section(f"Pictures as landmarks: {name}", tuple(blocks), facts=facts, page=page))
    return sections


def models(folder: Path, wanted: Output, log: Log) -> Iterator[Block]:
    """Words and formulas of every model, and their constants on a log."""
    write_models(folder, wanted, log)
    for model in MODELS:
        yield f"**{model.title}.** {model.about}"
        yield model.formula
    yield constants(log)


def _constants(log: Log) -> dict[str, object]:
    """Of the models: sigmas [cm/s, deg/s] of a command, pose [deg, m] of the camera, extremes [cm] of a corner."""
    sensor, R = log.recorded.sensor, log.recorded.observations.R
    x, z = sensor.translation
    sides = [100.0 * np.sqrt(R[:, i, i]) for i in (0, 1)] if len(R) else []
    right, forward = ((float(each.min()), float(each.max())) for each in sides) if sides else ((), ())
    return {
        "log": log.name, "v": 100.0 * COMMAND_SIGMA[0], "omega": math.degrees(COMMAND_SIGMA[1]),
        "rotation": math.degrees(sensor.rotation), "translation": (float(x), float(z)), "side": right,
        "ahead": forward, "by_depth": max((float(np.ptp(each)) for each in sides), default=0.0) >= 1e-9,
    }  # fmt: skip


def constants(log: Log) -> str:
    """The models' constants on this log, in words."""
    return say("visual#constants", c=_constants(log))


def _plan(folder: Path, trial: Trial, factor: int | None) -> Picture:
    log, drawn, name = trial.log, for_map(trial), stem(trial, "plan")
    assert log.evidence is not None  # `visual_sections` asks for the plan of no other log
    factor = enlarged(log, drawn, factor)
    save_for_page(partial(plan_figure, log, drawn, log.evidence.setup.corners, factor=factor), folder / "figures", name)
    known = bool(log.truth.known_poses)
    caption = say("visual#plan", log=log.name, task=trial.task, known=known, factor=factor) + left_out(trial, drawn)
    paths = ", ".join(r.estimator for r in drawn)
    return Picture(name, caption, f"Plan of {log.name} with pictures and the paths of {paths}")


def _detections(folder: Path, wanted: Output, log: Log, evidence: Evidence, *, in_lab: bool) -> Iterator[Block]:
    stats = statistics_of(evidence)
    yield summary(stats, evidence.found)
    if not (wanted.no_plots or in_lab):
        yield from sheet(folder, log, evidence)
    frame = drop_blank_columns(detection_table(stats))
    caption = say("visual#table", log=log.name, truth=evidence.in_view is not None, unseen=len(stats) - len(frame))
    yield written_table(frame, folder, f"{folder_name(log.name)}-detections", caption, wanted)


def _detected(stats: pd.DataFrame, found: Found) -> dict[str, object]:
    """All pictures together; noise of a corner in the image [px], and of depth z, times z^2 [1/m]; None: not known."""
    noise = (found.pixel_noise, found.depth_noise)
    return {
        "detections": len(found.frame), "frames": len(found.time), "in_view": int(stats["frames in view"].sum()),
        "found": int(stats["of these found"].sum()), "wrong": int(stats["wrong"].sum()),
        "noise": noise if np.isfinite(noise).all() else None,
    }  # fmt: skip


def summary(stats: pd.DataFrame, found: Found, head: str = "**Detections.**") -> str:
    """All pictures together, in a paragraph that begins with a word."""
    return say("visual#summary", d=_detected(stats, found), head=head)
