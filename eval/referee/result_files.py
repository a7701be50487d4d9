"""What each file of the result folder holds: columns with unit and meaning, and how rows become its table and CSV.

First the kinds of columns and files, then the files of one run and of one log (`runs/<log>/`), those for readers, and
the CSV files at the top.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd

from data.inputs import ERRORS
from eval.referee.metrics import OF_DECISIONS, OF_ESTIMATES, Metric

Kind = Literal["text", "count", "number"]
BLANKS = {"text": "str", "count": "Int64", "number": "float64"}
"""Type of a column in a table: unknown is NaN, of a count (an integer column of pandas) `pd.NA`."""


@dataclass(frozen=True)
class Column:
    """A column of a CSV.

    Attributes:
        name: in the file's first line.
        about: what it holds, in words.
        unit: of its number; empty: it has none.
        kind: `text`, `count` (a whole number, also a frame or the number of a landmark) or `number`.
    """

    name: str
    about: str
    unit: str = ""
    kind: Kind = "number"

    def __post_init__(self) -> None:
        if not self.about.strip():
            raise ValueError(f"column {self.name!r}: what it holds must be said")


def text(name: str, about: str) -> Column:
    """A column of words."""
    return Column(name, about, kind="text")


def count(name: str, about: str) -> Column:
    """A column of whole numbers."""
    return Column(name, about, kind="count")


def measured(metric: Metric) -> Column:
    """The column of a metric."""
    expected = "" if metric.expected is None else f"; {metric.expected:.3g} expected of a consistent estimator"
    kind: Kind = {"d": "count", "s": "text"}.get(metric.form, "number")  # type: ignore[assignment]
    unit = "share, 0 to 1" if metric.percent else metric.unit
    return Column(metric.column, f"{metric.about or metric.spelled or metric.heading}{expected}", unit, kind)


@dataclass(frozen=True)
class File:
    """A file of the result folder, or a kind of them.

    Attributes:
        path: below the result folder; `<...>` stands for names.
        about: what it is, in a sentence or two.
        columns: of a CSV, in order; those `optional` stand in some of these files only.
        when: where it is not always there.
    """

    path: str
    about: str
    columns: tuple[Column, ...] = ()
    optional: tuple[str, ...] = ()
    when: str = ""

    @property
    def name(self) -> str:
        """The last component of the path."""
        return self.path.rpartition("/")[2]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns."""
        return tuple(c.name for c in self.columns)

    def table(self, rows: Sequence[Mapping[str, object]]) -> pd.DataFrame:
        """Rows as a table with exactly these columns, each of its type; what a row lacks is unknown."""
        unknown = {k for row in rows for k in row} - set(self.names)
        if unknown:
            raise AssertionError(f"{self.path}: columns {sorted(unknown)} are none of {', '.join(self.names)}")
        return pd.DataFrame({c.name: _typed([row.get(c.name) for row in rows], c.kind) for c in self.columns})

    def write(self, table: pd.DataFrame, place: Path) -> None:
        """Write `place/name`; a column that is not described here cannot be written, nor one be left out."""
        given = tuple(str(c) for c in table.columns)
        if given != tuple(n for n in self.names if n in given or n not in self.optional):
            raise AssertionError(f"{self.path} has the columns {', '.join(self.names)}, not {', '.join(given)}")
        table.to_csv(place / self.name, index=False, lineterminator="\n")


def _typed(values: Sequence[Any], kind: Kind) -> pd.Series:
    blank = [v is None or v is pd.NA or (isinstance(v, float) and not math.isfinite(v)) for v in values]
    if kind == "number":
        numbers = [math.nan if b else float(v) for v, b in zip(values, blank, strict=True)]
        return pd.Series(np.array(numbers, np.float64))
    plain: list[Any] = [None if b else v for v, b in zip(values, blank, strict=True)]
    return pd.Series(plain, dtype=BLANKS[kind])


LOG_FOLDER = "runs/<log>"
RUN_FOLDER = f"{LOG_FOLDER}/<task>-<estimator>-<association>"
NUMBER = "its number in the order of creation (SLAM), or its id in the map (localization)"
DECIDED = "landmark number; -1: initialized a new landmark; -2: discarded"


def covariance(names: str, what: str) -> tuple[Column, ...]:
    """The upper triangle of a covariance; `names` as in `xyt`."""
    return tuple(
        Column(f"c_{a}{b}", f"covariance of {what}, entry {LETTERS[a]}, {LETTERS[b]}", UNITS[(a == "t") + (b == "t")])
        for i, a in enumerate(names)
        for b in names[i:]
    )


UNITS = ("m²", "m rad", "rad²")
"""Of an entry of a covariance, by how many headings it is about."""
LETTERS = {"x": "x", "y": "y", "t": "theta"}
PATH = (
    Column("t", "time of the frame; of a log without stamps its number", "s"),
    Column("x", "of the robot in the world frame", "m"),
    Column("y", "of the robot in the world frame", "m"),
    Column("theta", "heading, counter-clockwise from the world's x axis", "rad"),
    *covariance("xyt", "the pose's error, additive, in the world frame"),
)
ESTIMATED = tuple(
    column
    for name, unit in ERRORS.items()
    for column in (
        Column(name, "this systematic error, as estimated along (`--calibrate`)", "" if unit == "1" else unit),
        Column(f"sigma_{name}", "its standard deviation", "" if unit == "1" else unit),
    )
)
"""Each of those that are estimated; they stand behind all others."""
OPTIONAL = tuple(c.name for c in ESTIMATED)
ONLINE = File(
    f"{RUN_FOLDER}/online.csv",
    "What was known at each instant, one row for each frame; not of batch smoothers.",
    (
        *PATH,
        Column("log_likelihood", "of the innovations used in the frame; blank where none are formed"),
        count("state_size", "length of the estimator's state vector after the frame"),
        *ESTIMATED,
    ),
    OPTIONAL,
)
FINAL = File(
    f"{RUN_FOLDER}/final.csv",
    "The path given all data, one row for each frame; not of filters.",
    (*PATH, *ESTIMATED),
    OPTIONAL,
)
LANDMARKS = File(
    f"{RUN_FOLDER}/landmarks.csv",
    "The last map; in SLAM only. Of walls x and y are rho [m] and alpha [rad].",
    (
        count("landmark", "landmark number: the order of creation, never given twice"),
        Column("x", "in the world frame", "m"),
        Column("y", "in the world frame", "m"),
        *covariance("xy", "the position's error in the world frame"),
        count("true_id", "true id of the observation that initialized it; -1: that observation was clutter"),
        count("first_frame", "frame in which it was initialized"),
        count("times_seen", "observations paired with it, the first included"),
        count(
            "ambiguous",
            "number of the nearest landmark that it cannot be told from: no frame saw both, and their difference is"
            " within the 99 % gate of their covariances and a reading's; its own number: by its readings it may be two;"
            " blank: neither",
        ),
    ),
)
DECISIONS = File(
    f"{RUN_FOLDER}/decisions.csv",
    "One row for each observation of the log: what it was paired with; not of dead reckoning and laser logs. A landmark"
    f" is meant by {NUMBER}.",
    (
        count("frame", "frame of the observation"),
        count("observation", "its place within the frame, from 0"),
        count("decision", f"made online: {DECIDED}"),
        count("truth", "the right landmark at that moment; -1: not in the map; blank: the true id is unknown"),
        text("outcome", "`tp`, `tn`, `fp` or `fn` of the decision; blank where the truth is unknown"),
        count(
            "final_decision",
            f"after all revisions: {DECIDED}; a landmark whose -1 was revised begins with its first observation",
        ),
        text("final_outcome", "outcome of the final decision against the landmarks that are left"),
    ),
)
LOOPS = File(
    f"{LOG_FOLDER}/loops.csv",
    "Every loop closure that was looked at.",
    (
        count("key1", "earlier key pose (row of the chain of key poses)"),
        count("key2", "later key pose"),
        Column("dx", "position of key2 in the body frame of key1", "m"),
        Column("dy", "position of key2 in the body frame of key1", "m"),
        Column("dtheta", "heading of key2 in the body frame of key1", "rad"),
        *covariance("xyt", "that relative pose"),
        Column("score", "share of the scan that the match explains, 0 to 1"),
        count("accepted", "1: it joined the graph"),
        count("final", "1: it kept its weight to the end"),
    ),
    when="laser logs, with scans that were matched",
)
LASER = "laser logs; from isam2's final phase, else from the first estimator"
LAB_TEXT = File(
    f"{RUN_FOLDER}/lab.txt",
    "Each step as the lab's program prints it: right answer, hypothesis, which are correct; steps and landmarks count "
    "from 1, 0 is none.",
    when="with `--lab-text`",
)
TUM = "`t x y z qx qy qz qw` in each line, without a header; frames without a pose are left out"
OF_RUNS = (
    ONLINE,
    FINAL,
    File(f"{RUN_FOLDER}/online.tum", f"The same path for other tools: {TUM}."),
    File(f"{RUN_FOLDER}/final.tum", f"The same path for other tools: {TUM}."),
    LANDMARKS,
    DECISIONS,
    LAB_TEXT,
)
OF_LOGS = (
    File(f"{LOG_FOLDER}/truth.tum", f"The true path, at the frames of the log: {TUM}.", when="logs with true poses"),
    LOOPS,
    File(
        f"{LOG_FOLDER}/graph.g2o", "Key poses, the motion between them and the loop closures kept, for g2o.", when=LASER
    ),
    File(f"{LOG_FOLDER}/map.png", "The occupancy grid with the path.", when=LASER),
    File(f"{LOG_FOLDER}/map.pgm", "The occupancy grid for map servers.", when=LASER),
    File(f"{LOG_FOLDER}/map.yaml", "Where `map.pgm` lies and how it is meant.", when=LASER),
)
OTHERS = (
    File("report.html", "The report, in one file."),
    File("report.md", "The same in Markdown."),
    File("report.json", "The facts that its sentences were written from: numbers, names and codes, without words."),
    File(
        "players/<log>.html",
        "Every run on a log, frame by frame, in a browser: one file, which loads nothing.",
        when="not with `--no-plots`",
    ),
    File("tables/<name>.csv", "A table of the report, every digit, with the heads that people read."),
    File("tables/<name>.md", "The same in Markdown, rounded."),
    File("tables/<name>.tex", "The same in LaTeX, for a column or a page of a paper (`--table-width`, `--columns`)."),
    File("tables/notes.tex", "What the LaTeX tables mean: their fine print, one paragraph for each."),
    File("figures/<name>.pdf", "A figure, for a paper.", when="not with `--quick` or `--no-plots`"),
    File("figures/<name>.png", "The same as an image.", when="not with `--no-plots`"),
    File(
        "figures/<name>.svg", "The small map of a log in the first table of the report.", when="not with `--no-plots`"
    ),
    File("figures/<name>.webm", "A film of a run (VP8, plays in browsers).", when="with `--animate`"),
    File("figures/<name>.pgf", "A figure that LaTeX sets with the document's own fonts.", when="with `--pgf`"),
    File(
        "figures/lab-<name>.png",
        "A figure of a lab's answers; `lab-update-time` shows measured times, so that it, its table and `report.html` "
        "differ from run to run.",
        when="with `--lab`",
    ),
    File("write-up.tex", "Answers, tables and figures, one page per log, for pdflatex.", when="with `--write-up`"),
    File("provenance.json", "Command, versions, seed, and the SHA-256 of every input."),
    File("run.log", "What the run said."),
)


LOG = text("log", "name of the log")
TASK = text("task", "`localization` (in a known map) or `slam`")
ESTIMATOR = text("estimator", "name of the estimator, as on the command line")
ASSOCIATION = text(
    "association", "who paired the observations, as on the command line; `none`: nobody (dead reckoning)"
)
PHASE = text("phase", "`online`: each pose from the data up to its frame; `final`: every pose from all data")
WHO = (LOG, TASK, ESTIMATOR, ASSOCIATION)
RUN = (*WHO, PHASE)

METRICS = File(
    "metrics.csv",
    "One row for each run and phase. A filter does not revise its past and has its `online` row only, batch smoothers "
    "only their `final` one.",
    (
        *RUN,
        text(
            "status",
            "`ok`; `diverged`, `incomplete`: there are no numbers; `implausible`: numbers that no honest run gives, in"
            " no average",
        ),
        *(measured(m) for m in OF_ESTIMATES),
    ),
)
DECISION_COUNTS = File(
    "association.csv",
    "One row for each run and phase that decided: outcomes of every observation's decision against the truth. On laser "
    "logs the decisions are about loop closures.",
    (*RUN, *(measured(m) for m in OF_DECISIONS)),
)
CONSISTENCY = File(
    "consistency.csv",
    "Verdicts of Monte Carlo studies, one row for each estimator and quantity. Only the header where no study ran.",
    (
        text("scenario", "name of the study"),
        ESTIMATOR,
        text(
            "quantity",
            "`pose`, `position`, `heading`, `landmarks`: NEES; `nis`: NIS per degree of freedom; `whiteness`:"
            " correlation of successive innovations; `coverage_50`, ...: share of last positions inside that ellipse;"
            " `covers_scale`, ...: share of runs whose systematic error is inside the 95 % interval claimed for it",
        ),
        Column("dof", "degrees of freedom of the quantity, which is its expected mean"),
        count("runs", "runs that count"),
        Column("mean", "mean over the runs of each run's mean; of a coverage the share"),
        Column("lower", "lower end of its 95 % interval"),
        Column("upper", "upper end of its 95 % interval"),
        text("verdict", "`consistent`, `overconfident`, `conservative`, or `not enough runs`"),
        TASK,
        ASSOCIATION,
        PHASE,
        Column("power", "probability that this test rejects a covariance claimed at 0.8 of the true one"),
        count("diverged", "runs that diverged or are implausible, in no average"),
    ),
)
TRUST = File(
    "trust.csv",
    "What each log says about itself, without any truth: statistics of innovations and residuals, beside those of"
    " twins (`--twins`).",
    (
        *WHO,
        text("statistic", "its name: `nis`, `innovation_lag1`, `filter_smoother_...`, `residual_...`, `slope_...`"),
        Column("value", "of the log"),
        Column("expected", "by theory where there is a theory, else the median of the twins"),
        count("twins", "twins it is compared with"),
        Column("p", "p value against the twins, by rank; blank without twins"),
        Column("p_family", "p value corrected for all statistics of this log"),
        Column("se", "standard error of the value, where one is known"),
        count("frame", "frame that a largest value is found in"),
    ),
)
RELATIONS = File(
    "relations.csv",
    "Errors of the runs against a log's reference relations.",
    (
        LOG,
        ESTIMATOR,
        ASSOCIATION,
        PHASE,
        text("tie", "how relations are tied to frames: `row` (of the log) or `time` (stamps)"),
        text("subset", "`all` relations, or only the `exact` ones"),
        count("relations", "how many"),
        Column("trans_mean_m", "mean error of the translation", "m"),
        Column("trans_std_m", "standard deviation of the error of the translation", "m"),
        Column("trans_max_m", "largest error of the translation", "m"),
        Column("rot_mean_deg", "mean error of the rotation", "deg"),
        Column("rot_std_deg", "standard deviation of the error of the rotation", "deg"),
        Column("rot_max_deg", "largest error of the rotation", "deg"),
    ),
    when="where a log has reference relations",
)
PUBLISHED = File(
    "published.csv",
    "Our numbers beside published ones.",
    (
        text("scenario", "name of the study"),
        text("estimator", "name of the estimator"),
        text("quantity", "column of metrics.csv that was published, or what a stored run is compared in"),
        Column("ours", "our number"),
        Column("se_ours", "its standard error"),
        Column("published", "the published number"),
        Column("se_published", "its standard error"),
        Column("difference_in_se", "the difference in standard errors of the difference"),
    ),
    when="where a scenario with published numbers ran",
)
TIMING = File(
    "timing.csv",
    "How long each estimator took; never the same twice, so not part of any comparison of bytes.",
    (
        *WHO,
        count("frames", "frames of the log"),
        Column("seconds", "wall time of the estimation; of a laser log with the front end", "s"),
        Column("frames_per_second", "frames over seconds", "1/s"),
    ),
)
DIFFERENCES = File(
    "slamref.score(...).differences",
    "Filters (a) against smoothers (b) under the same association, on logs with truth: a minus b.",
    (
        LOG,
        TASK,
        ASSOCIATION,
        text("a", "the filter"),
        text("b", "the smoother"),
        text("phase_a", "its phase"),
        text("phase_b", "its phase"),
        Column("rmse_position_m", "difference of the position RMSE", "m"),
        Column("rmse_position_lower", "lower end of its 95 % interval", "m"),
        Column("rmse_position_upper", "upper end of its 95 % interval", "m"),
        Column("rmse_position_p", "p value of no difference"),
        Column("nees_pose", "difference of the mean pose NEES"),
        Column("nees_pose_lower", "lower end of its 95 % interval"),
        Column("nees_pose_upper", "upper end of its 95 % interval"),
        Column("nees_pose_p", "p value of no difference"),
        Column("block_frames", "mean block of the bootstrap", "frames"),
        text("rmse_position_why", "why the interval of the RMSE is missing"),
        text("nees_pose_why", "why the interval of the NEES is missing"),
    ),
)
NOTICES = File(
    "notices.csv",
    "Everything that was found about logs and runs: questions, notes, why runs stopped, are implausible or lost, and"
    " what is to be doubted.",
    (
        text("code", "what was found, in a word: one of a fixed list"),
        text("severity", "`info`, `warning` or `error`: a fact, something to look at, a reason not to use the result"),
        text("log", "name of the log; blank where it is about none"),
        text("task", "of the run or the comparison; blank where it is about the log"),
        text("estimator", "of the run; blank where it is about no single one"),
        text("association", "of the run; blank where it is about the log"),
        count("frame", "frame that it is about, or that it begins in; blank: none"),
        text("values", "its numbers and names, as JSON with the names in alphabetical order; unknown is `null`"),
        text("text", "the sentence of the report"),
    ),
)
TOP = (METRICS, DECISION_COUNTS, CONSISTENCY, TRUST, RELATIONS, PUBLISHED, NOTICES, TIMING)
