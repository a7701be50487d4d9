"""The report's section on a log made from images: models, plan, what was found in the images, and how well.

The equations of the models stand in `templates/models/`, as LaTeX and as MathML. What they say is computed by
`data.motion.velocity.step`, `data.se2.compose` and `data.sensors.measure`; a test evaluates their entries and compares.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from data.inputs import IntArray
from data.log import Log, folder_name
from data.pictures import Detection, Evidence, Found, InView
from data.terminal import counted
from data.visual.observations import COMMAND_SIGMA, true_pictures
from eval.figures.paper import tex_escape
from eval.figures.style import save
from eval.figures.visual import Tile, contact_sheet, plan_figure
from eval.plan.flags.options import Options
from eval.referee.score import Trial
from eval.report.names import stem
from eval.report.page.document import Block, Formula, Picture, Section, written_table
from eval.report.page.tables import drop_blank_columns, number
from eval.report.shown_runs import for_map, left_out
from eval.report.words import template_text


@dataclass(frozen=True)
class Model:
    """What is modelled, in words (plain text) and equations; `name` is its part of file names."""

    name: str
    title: str
    about: str

    @property
    def latex(self) -> str:
        """The equations, aligned, as what stands in math mode (needs amsmath)."""
        return template_text(f"models/{self.name}.tex").strip()

    @property
    def formula(self) -> Formula:
        """The equations as a block of the report."""
        return Formula(self.latex, template_text(f"models/{self.name}.mathml").strip())


MOTION = Model(
    "motion",
    "Motion model",
    "The pose is (x, y, θ) in the world frame. A command (v, ω) holds for Δt and drives the robot along a circular arc,"
    " exactly: displacement D along the arc, rotation α, and from these the step (dx, dy, α) in the robot's own frame,"
    " composed with the pose; the heading is then wrapped to ±180°. As ω goes to zero, a goes to 1, b and a' go to 0"
    " and b' to 1/2, and the arc becomes a straight line; the program takes these limits by series. F is the Jacobian"
    " with respect to the pose, G the one with respect to the command, and the noise of v and ω is independent at each"
    " command. Source: Probabilistic Robotics, section 5.3; code: data.motion.velocity.step, data.se2.compose.",
)
OBSERVATION = Model(
    "observation",
    "Observation model",
    "Corner j of a picture is the point l in the world's plan. The stereo camera sees it at x to the right and z ahead;"
    " rotation (by the angle φ) and translation T lead from the robot's frame to the camera's. H is the Jacobian with"
    " respect to the pose and L the one with respect to the corner, which only SLAM needs. All corners of a frame are"
    " stacked into one update, with independent noise. Source: Probabilistic Robotics, section 6.6, for a point instead"
    " of range and bearing; code: data.sensors.measure.",
)
UPDATE = Model(
    "update",
    "Update",
    "What was seen corrects what was predicted (the lab's equations 10 to 13): the innovation of all corners of a"
    " frame, its gain, the pose and its covariance after it; quantities with a minus are predicted. S and H are those"
    " of the observation model. Heading differences are wrapped, and in SLAM the corners are part of the state. Source:"
    " Probabilistic Robotics, table 3.3; code: ekf.updates.",
)
MODELS = (MOTION, OBSERVATION, UPDATE)


def models_latex(models: tuple[Model, ...] = MODELS) -> str:
    """Words and equations of models as a LaTeX fragment; it needs amsmath."""
    greek = str.maketrans({"ω": r"$\omega$", "φ": r"$\varphi$", "ψ": r"$\psi$", "Δ": r"$\Delta$"})
    parts = ["% \\usepackage{amsmath}"]
    for model in models:
        about = tex_escape(model.about).translate(greek)
        parts.append(f"\\paragraph{{{model.title}.}} {about}\n\\[\n{model.latex}\n\\]")
    return "\n".join(parts) + "\n"


@dataclass(frozen=True)
class PictureStatistics:
    """How well one picture was found; None: unknown, because the truth is.

    Attributes:
        picture: its number.
        detected: frames in which it was found.
        in_view: frames with it fully in view, near enough and not too oblique; found_in_view: those of them in which
            it was found where it is.
        median_inliers: of its detections. corner_error: px, median over their corners.
        wrong: detections that lie on another picture in view, or elsewhere than this one while it is in view.
        refused: frames in which it was looked for in vain, by reason.
    """

    picture: int
    detected: int
    in_view: int | None = None
    found_in_view: int | None = None
    median_inliers: float | None = None
    corner_error: float | None = None
    wrong: int | None = None
    refused: Mapping[str, int] = field(default_factory=dict)

    @property
    def recall(self) -> float | None:
        """Share of the frames in view in which it was found; None without such frames."""
        if not self.in_view or self.found_in_view is None:
            return None
        return self.found_in_view / self.in_view


def detection_table(stats: Sequence[PictureStatistics]) -> pd.DataFrame:
    """A row per picture; a column for each reason it was not found for, most frequent first. Unknown is blank."""
    total: dict[str, int] = {}
    for s in stats:
        for reason, count in s.refused.items():
            total[reason] = total.get(reason, 0) + count
    reasons = sorted(total, key=lambda reason: (-total[reason], reason))
    rows = [
        {
            "picture": s.picture,
            "frames in view": s.in_view,
            "of these found": s.found_in_view,
            "recall [%]": None if s.recall is None else 100.0 * s.recall,
            "detections": s.detected,
            "wrong": s.wrong,
            "not judged": None if s.found_in_view is None else s.detected - s.found_in_view - (s.wrong or 0),
            "inliers, median": s.median_inliers,
            "corner error, median [px]": s.corner_error,
            **{f"not found: {reason}": s.refused.get(reason, 0) for reason in reasons},
        }
        for s in stats
    ]
    return pd.DataFrame(rows, dtype=object)


def statistics_of(evidence: Evidence) -> list[PictureStatistics]:
    """Statistics of every picture of a recording, in the order of their numbers."""
    found, truth = evidence.found, evidence.in_view
    shown = None if truth is None else true_pictures(found, truth)
    result = []
    for p in range(len(evidence.setup.corners)):
        own = found.picture == p
        s = PictureStatistics(
            p,
            int(own.sum()),
            median_inliers=float(np.median(found.inliers[own])) if own.any() else None,
            refused=found.refused[p],
        )
        if truth is not None and shown is not None:
            s = _with_truth(s, found, truth, shown)
        result.append(s)
    return result


def _with_truth(s: PictureStatistics, found: Found, truth: InView, shown: IntArray) -> PictureStatistics:
    """The same with what only the truth can tell; `shown` (D,) as from `true_pictures`."""
    there = truth.picture == s.picture
    right = (found.picture == s.picture) & (shown == s.picture)
    at = {int(f): k for f, k in zip(truth.frame[there], np.flatnonzero(there), strict=True)}
    pairs = [(d, at[int(found.frame[d])]) for d in np.flatnonzero(right)]
    off = [np.linalg.norm(found.pixels[d] - truth.pixels[k], axis=1) for d, k in pairs]
    claimed = found.picture == s.picture
    here = np.array([int(f) in at for f in found.frame], bool)
    return replace(
        s,
        in_view=int(there.sum()),
        found_in_view=len(pairs),
        corner_error=float(np.median(off)) if off else None,
        wrong=int((claimed & (shown != s.picture) & ((shown >= 0) | here)).sum()),
    )


def tiles_of(evidence: Evidence) -> list[Tile]:
    """The frames kept to look at, with what was found in them and, where the truth is known, what was not."""
    return [_tile(evidence, frame, image) for frame, image in evidence.found.tiles]


def _tile(evidence: Evidence, frame: int, image: bytes) -> Tile:
    found, truth = evidence.found, evidence.in_view
    rgb: NDArray[np.uint8] = cv2.imdecode(np.frombuffer(image, np.uint8), cv2.IMREAD_COLOR_RGB)  # type: ignore[assignment]
    here = np.flatnonzero(found.frame == frame)
    detections = [
        Detection(int(found.picture[d]), found.pixels[d], found.points[d], int(found.inliers[d])) for d in here
    ]
    notes = []
    if truth is not None:
        missed = sorted(set(truth.picture[truth.frame == frame].tolist()) - set(found.picture[here].tolist()))
        notes += [f"in view, not found: {', '.join(map(str, missed))}"] if missed else []
    return Tile(f"frame {frame}, {found.time[frame] - found.time[0]:.1f} s", rgb, detections, notes)


def visual_sections(folder: Path, options: Options, trials: Sequence[Trial]) -> list[Section]:
    """For each log made from images: models, a plan for each task, contact sheet and statistics, below `folder`."""
    logs = {t.log.name: t.log for t in trials if t.log.evidence is not None and t.beside is None}
    sections = []
    for name, log in logs.items():
        blocks = [] if options.lab is not None else list(models(folder, options, log))
        blocks += [_plan(folder, options, t) for t in trials if t.log is log and not options.no_plots]
        blocks += _detections(folder, options, log)
        sections.append(Section(f"Pictures as landmarks: {name}", tuple(blocks)))
    return sections


def models(folder: Path, options: Options, log: Log) -> Iterator[Block]:
    """Words and formulas of every model, and their constants on a log."""
    name = folder_name(log.name)
    if "tex" in options.formats:
        (folder / "tables").mkdir(parents=True, exist_ok=True)
        (folder / "tables" / f"{name}-models.tex").write_text(models_latex(), encoding="utf-8", newline="\n")
    for model in MODELS:
        yield f"**{model.title}.** {model.about}"
        yield model.formula
    yield constants(log)


def constants(log: Log) -> str:
    """The models' constants on this log."""
    inputs = log.recorded
    sensor, R = inputs.sensor, inputs.observations.R
    v, omega = COMMAND_SIGMA
    text = (
        f"On `{log.name}`: standard deviations {100.0 * v:g} cm/s of v and {math.degrees(omega):g} °/s of ω;"
        f" φ = {math.degrees(sensor.rotation):.1f}°,"
        f" T = ({sensor.translation[0]:.3f}, {sensor.translation[1]:.3f}) m."
    )
    if len(R) == 0:
        return text
    side, ahead = 100.0 * np.sqrt(R[:, 0, 0]), 100.0 * np.sqrt(R[:, 1, 1])
    if np.ptp(side) < 1e-9 and np.ptp(ahead) < 1e-9:
        return f"{text} Of a corner: {side[0]:.3g} cm to the right and {ahead[0]:.3g} cm ahead."
    return (
        f"{text} Of a corner, from the noise of its depth: {side.min():.2g} to {side.max():.2g} cm to the right and"
        f" {ahead.min():.2g} to {ahead.max():.2g} cm ahead, correlated along the line of sight."
    )


def _plan(folder: Path, options: Options, trial: Trial) -> Picture:
    log, drawn, name = trial.log, for_map(trial), stem(trial, "plan")
    assert log.evidence is not None  # `visual_sections` asks for the plan of no other log
    figure = plan_figure(
        log, drawn, log.evidence.setup.corners, factor=None if options.lab is not None else options.ellipse_factor
    )
    save(figure, folder / "figures", name, ("png",) if options.quick else ("pdf", "png"))
    truth = "" if log.truth.known_poses else " The true path is not known."
    return Picture(
        name,
        f"`{log.name}`, {trial.task}: pictures on their walls, dead reckoning and estimates with 3σ (x, y)"
        f" ellipses. World frame, no alignment.{truth}{left_out(trial, drawn)}",
        f"Plan of {log.name} with pictures and the paths of {', '.join(r.estimator for r in drawn)}",
    )


def _detections(folder: Path, options: Options, log: Log) -> Iterator[Block]:
    evidence, name = log.evidence, f"{folder_name(log.name)}-detections"
    assert evidence is not None  # see `_plan`
    stats, found, tiles = statistics_of(evidence), evidence.found, tiles_of(evidence)
    yield summary(stats, found)
    if tiles and not options.no_plots:
        # images are the whole figure: as PDF it would be many times as large and show no more
        sheet = contact_sheet(tiles, f"{log.name}: pictures found, with their numbers")
        save(sheet, folder / "figures", name, ("png",))
        yield Picture(
            name,
            f"`{log.name}`: {len(tiles)} of {counted(len(found.time), 'frame')}. Outlines: pictures found;"
            " dots: corners; the number stands at the upper left one.",
            f"{counted(len(tiles), 'frame')} of {log.name} with outlined pictures",
        )
    frame = drop_blank_columns(detection_table(stats))
    caption = f"{log.name}: detections by picture, numbered from 0 in the order of the reference images."
    if evidence.in_view is not None:
        caption += (
            " In view: wholly in the image, near enough and not too oblique. Wrong: it lies on another picture, or not"
            " where this one is. Not judged: found where none is in view by that definition."
        )
    caption += " Not found: frames, by the reason."
    yield written_table(frame, folder, name, caption, options)


def summary(stats: Sequence[PictureStatistics], found: Found) -> str:
    """All pictures together, in a paragraph."""
    notes = [f"**Detections.** {len(found.frame)} in {counted(len(found.time), 'frame')}."]
    in_view = sum(s.in_view or 0 for s in stats)
    if in_view:
        right, wrong = sum(s.found_in_view or 0 for s in stats), sum(s.wrong or 0 for s in stats)
        notes.append(f"Of {in_view} pictures in view {right} were found ({100.0 * right / in_view:.1f} %).")
        notes.append(f"Wrong: {wrong}.")
    if math.isfinite(found.pixel_noise) and math.isfinite(found.depth_noise):
        notes.append(
            f"Noise of a corner as this recording itself shows it: {number(found.pixel_noise)} px in the image, and in"
            f" depth z a standard deviation of {number(found.depth_noise)} z² (z in m)."
        )
    return " ".join(notes)
