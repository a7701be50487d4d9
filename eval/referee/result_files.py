"""Files of the result folder: columns with unit and meaning, and how rows become a table and a CSV file."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

import pandas as pd

from data.inputs import ERRORS
from eval.referee.metrics import OF_DECISIONS, OF_ESTIMATES, Metric

Row = dict[str, object]  # a row of a result table by its columns


def is_blank(value: object) -> bool:
    """Whether a cell holds nothing: None, NaN, infinite, or an empty text."""
    return value is None or value is pd.NA or value == "" or (isinstance(value, float) and not math.isfinite(value))


def rows_of(frame: pd.DataFrame) -> list[Row]:
    """The rows of a table; None: a blank cell."""
    return [{str(k): None if is_blank(v) else v for k, v in r.items()} for r in frame.to_dict("records")]


def value_of(row: Row, column: str) -> float:
    """A number of a row, NaN where it is blank."""
    value = row.get(column)
    return math.nan if is_blank(value) else float(value)  # type: ignore[arg-type]


Kind = Literal["text", "count", "number"]
BLANKS = {"text": "str", "count": "Int64", "number": "float64"}
"""Type of a column in a table: unknown is NaN, of a count (an integer column of pandas) `pd.NA`."""


@dataclass(frozen=True)
class Column:
    """A column of a CSV."""

    name: str
    about: str
    unit: str = ""
    kind: Kind = "number"  # a frame and the number of a landmark are counts

    def __post_init__(self) -> None:
        if not self.about.strip():
            raise ValueError(f"column {self.name!r} has no description")


text, count = partial(Column, kind="text"), partial(Column, kind="count")  # columns of words, and of whole numbers


def measured(metric: Metric) -> Column:
    """The column of a metric."""
    expected = "" if metric.expected is None else f" (expected {metric.expected:.3g})"
    kind: Kind = {"d": "count", "s": "text"}.get(metric.form, "number")  # type: ignore[assignment]
    unit = "share" if metric.percent else metric.unit
    return Column(metric.column, f"{metric.about or metric.spelled or metric.heading}{expected}", unit, kind)


@dataclass(frozen=True)
class File:
    """A file of the result folder, or a kind of them."""

    path: str  # below the result folder; `<...>` stands for names
    about: str
    columns: tuple[Column, ...] = ()  # of a CSV, in order
    optional: tuple[str, ...] = ()  # columns of some of these files only
    when: str = ""  # condition under which the file exists; empty: always

    @property
    def name(self) -> str:
        """The last component of the path."""
        return self.path.rpartition("/")[2]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns."""
        return tuple(c.name for c in self.columns)

    def table(self, rows: Sequence[Mapping[str, object]]) -> pd.DataFrame:
        """Rows as a table of exactly these columns, each of its type; missing values are unknown."""
        unknown = {k for row in rows for k in row} - set(self.names)
        if unknown:
            raise AssertionError(f"{self.path}: columns {sorted(unknown)} are none of {', '.join(self.names)}")
        return pd.DataFrame({c.name: _typed([row.get(c.name) for row in rows], c.kind) for c in self.columns})

    def write(self, table: pd.DataFrame, place: Path) -> None:
        """Write `place/name`; AssertionError where the columns are not those described here."""
        given = tuple(str(c) for c in table.columns)
        if given != tuple(n for n in self.names if n in given or n not in self.optional):
            raise AssertionError(f"{self.path} has the columns {', '.join(self.names)}, not {', '.join(given)}")
        table.to_csv(place / self.name, index=False, lineterminator="\n")


def _typed(values: Sequence[Any], kind: Kind) -> pd.Series:
    unknown = math.nan if kind == "number" else None
    return pd.Series([unknown if v != "" and is_blank(v) else v for v in values], dtype=BLANKS[kind])


LOG_FOLDER = "runs/<log>"
RUN_FOLDER = f"{LOG_FOLDER}/<task>-<estimator>-<association>"


def covariance(names: str, about: str) -> tuple[Column, ...]:
    """The upper triangle of a covariance; `names` as in `xyt`."""
    units = ("m²", "m rad", "rad²")
    pairs = ((a, b) for i, a in enumerate(names) for b in names[i:])
    return tuple(Column(f"c_{a}{b}", about, units[(a == "t") + (b == "t")]) for a, b in pairs)


POSITION = tuple(Column(name, "position in the world frame", "m") for name in "xy")
PATH = (
    Column("t", "time of the frame; its number if the log has no stamps", "s"),
    *POSITION,
    Column("theta", "heading, counter-clockwise from the x axis", "rad"),
    *covariance("xyt", "covariance of the pose error in the world frame"),
)
_CALIBRATED = "systematic error (`--calibrate`) and its standard deviation"
ESTIMATED = tuple(
    Column(f"{prefix}{name}", _CALIBRATED, "" if unit == "1" else unit)
    for name, unit in ERRORS.items()
    for prefix in ("", "sigma_")
)  # estimated systematic errors; these columns come last
OPTIONAL = tuple(c.name for c in ESTIMATED)
ONLINE = File(
    f"{RUN_FOLDER}/online.csv",
    "Path with each pose estimated from the data up to its frame. One row per frame; not for batch smoothers.", (
        *PATH, Column("log_likelihood", "log-likelihood of the innovations used in the frame"),
        count("state_size", "length of the state vector after the frame"), *ESTIMATED,
    ), OPTIONAL,
)  # fmt: skip
FROM_ALL = "Path estimated from all data. One row per frame; not for filters."
FINAL = File(f"{RUN_FOLDER}/final.csv", FROM_ALL, (*PATH, *ESTIMATED), OPTIONAL)
LANDMARKS = File(
    f"{RUN_FOLDER}/landmarks.csv",
    "The last map of SLAM, or an uncertain map as estimated. For walls x and y are rho [m] and alpha [rad].", (
        count("landmark", "landmark number, never reused"), *POSITION,
        *covariance("xy", "covariance of the position error"),
        count("true_id", "true id of its first observation; -1: clutter"),
        count("first_frame", "frame of its initialization"),
        count("times_seen", "observations paired with it, the first included"),
        count("ambiguous",
              "nearest landmark that may be the same one (no common frame, difference inside the 99 % gate)"),
        count("until", "frame of its last observation, if it left the world before the end (`jcbb-hindsight`)"),
    ),
)  # fmt: skip
DECISIONS = File(
    f"{RUN_FOLDER}/decisions.csv",
    "Association decisions, one row per observation; not for dead reckoning and laser logs.", (
        count("frame", "frame of the observation"), count("observation", "index within the frame, from 0"),
        count("decision", "online decision"), count("truth", "right landmark at that frame"),
        text("outcome", "`tp`, `tn`, `fp` or `fn` of the online decision"),
        count("final_decision", "decision after all revisions"),
        text("final_outcome", "its outcome against the remaining landmarks"),
        count("begins", "landmark that it initializes after all revisions, -1 for none"),
    ),
)  # fmt: skip
LOOPS = File(
    f"{LOG_FOLDER}/loops.csv", "All loop closures tested.", (
        count("key1", "earlier key pose"), count("key2", "later key pose"),
        *(Column(name, "position of key2 in the body frame of key1", "m") for name in ("dx", "dy")),
        Column("dtheta", "heading of key2 relative to key1", "rad"),
        *covariance("xyt", "covariance of this relative pose"),
        Column("score", "share of the scan that the match explains"), count("accepted", "1: added to the graph"),
        count("final", "1: kept its weight to the end"),
    ), when="laser logs with matched scans",
)  # fmt: skip
LASER = "laser logs; final phase of isam2, else the first estimator"
LAB_TEXT = File(
    f"{RUN_FOLDER}/lab.txt",
    "Every step in the format of the lab's program; steps and landmarks count from 1, 0 is none.",
    when="`--lab-text`",
)
OF_RUNS = (
    ONLINE, FINAL,
    File(f"{RUN_FOLDER}/<phase>.tum", "The path as lines `t x y z qx qy qz qw`; frames without a pose are left out."),
    LANDMARKS, DECISIONS, LAB_TEXT,
)  # fmt: skip
OF_LOGS = (
    File(f"{LOG_FOLDER}/truth.tum", "The true path in the same format.", when="logs with true poses"),
    LOOPS,
    File(f"{LOG_FOLDER}/graph.g2o", "Key poses, relative motions and accepted loop closures.", when=LASER),
    File(
        f"{LOG_FOLDER}/map.<type>", "Occupancy grid: `png` with the path, `pgm` and `yaml` for map servers.", when=LASER
    ),
)
TEAM = File(
    "tables/team-<team>-<task>.csv",
    "Robots of a team, one row per robot, exchange, estimator, association and phase.", (
        count("robot", "number of the robot"),
        text("exchange", "`joint`, `naive`, `intersection`, `alone`; `none`: dead reckoning"),
        *(text(name, "as in `metrics.csv`") for name in ("estimator", "association", "phase", "status")),
        Column("rmse_position_m", "position RMSE without alignment", "m"),
        Column("nees_pose", "mean pose NEES (expected 3)"),
        count("robots_tp", "observations of robots paired with the right robot"),
        count("robots_tn", "unpaired, and of no robot of the team"), count("robots_fp", "paired with a wrong robot"),
        count("robots_fn", "unpaired, but of a robot of the team"),
    ), when="`--cooperative`",
)  # fmt: skip
OTHERS = (
    File("report.<type>", "The report as `html` and `md`; `json` has its facts as numbers, names and codes."),
    File("details/<page>.html", "Details that report.html leaves out, one page per subject."),
    File("players/<log>.html", "All runs on a log, frame by frame, in a browser.", when="not with `--no-plots`"),
    File(
        "tables/<name>.<type>",
        "Tables of the report: `csv` with every digit, `md` and `tex` rounded (`--table-width`, `--columns`).",
    ),
    TEAM,
    File("tables/notes.tex", "Explanations of the LaTeX tables."),
    File(
        "figures/<name>.<type>",
        "Figures: `png` (for phones `-narrow.png`), `pdf` (`--formats pdf`, `--write-up` and other options for papers),"
        " `svg` (small maps), `pgf` (`--pgf`), `webm` (`--animate`); for papers also their data (`csv`);"
        " none with `--no-plots`.",
    ),
    File("write-up.tex", "Answers, tables and figures for pdflatex, one page per log.", when="`--write-up`"),
    File("provenance.json", "Command, versions, seed, and the SHA-256 of every input."),
    File("run.log", "Messages of the run."),
)


LOG = text("log", "name of the log")
TASK = text("task", "`localization` (in a known map) or `slam`")
ESTIMATOR = text("estimator", "estimator, as on the command line")
ASSOCIATION = text("association", "association method, as on the command line; `none`: dead reckoning")
PHASE = text("phase", "`online`: poses from data up to their frame; `final`: from all data")
WHO = (LOG, TASK, ESTIMATOR, ASSOCIATION)
RUN = (*WHO, PHASE)

METRICS = File(
    "metrics.csv",
    "Accuracy and consistency, one row per run and phase; filters have no `final` row, batch smoothers no"
    " `online` row. docs/results-files.md defines the relative errors.", (
        *RUN, text("status", "`ok`; `diverged`, `incomplete`: no numbers; `implausible`: physically impossible"
                   " numbers, in no average"),
        *(measured(m) for m in OF_ESTIMATES),
    ),
)  # fmt: skip
DECISION_COUNTS = File(
    "association.csv",
    "Outcomes of association decisions, one row per run and phase; on laser logs of loop closures.",
    (*RUN, *(measured(m) for m in OF_DECISIONS)),
)
CONSISTENCY = File(
    "consistency.csv", "Verdicts of Monte Carlo studies, one row per estimator and quantity.", (
        text("scenario", "name of the study"), ESTIMATOR,
        text(
            "quantity",
            "`pose`, `position`, `heading`, `landmarks`: NEES; `nis`: NIS per dof; `whiteness`: lag-1 correlation of"
            " innovations; `coverage_...`: share of last positions inside that ellipse; `covers_...`: share of runs"
            " whose systematic error is inside its 95 % interval",
        ),
        count("dof", "degrees of freedom, the expected mean"), count("runs", "runs without failures"),
        Column("mean", "mean of the runs' means; for coverages the share"),
        *(Column(name, "95 % bounds of the mean") for name in ("lower", "upper")),
        text("verdict", "a word of [verdicts](verdicts.md#verdicts-over-many-runs), or `not enough runs`"),
        TASK, ASSOCIATION, PHASE,
        Column("power", "probability of rejecting a covariance stated at 0.8 of the true one"),
        count("diverged", "diverged or implausible runs"),
    ),
)  # fmt: skip
TRUST = File(
    "trust.csv", "Consistency statistics that need no truth, compared with bootstrap replicates (`--twins`).", (
        *WHO, text("statistic", "`nis`, `innovation_lag1`, `filter_smoother_...`, `residual_...`, `slope_...`"),
        Column("value", "value of the log"),
        Column("expected", "expected by theory, else the median of the replicates"),
        count("twins", "number of replicates"), Column("p", "p value by rank among the replicates"),
        Column("p_family", "p value corrected for all statistics of the log"),
        Column("se", "standard error of the value"), count("frame", "frame of a largest value"),
    ),
)  # fmt: skip
RELATIONS = File(
    "relations.csv", "Errors against reference relations.", (
        LOG, ESTIMATOR, ASSOCIATION, PHASE, text("tie", "relations matched to frames by `row` of the log or by `time`"),
        text("subset", "`all` relations or only the `exact` ones"), count("relations", "number of relations"),
        *(
            Column(f"{part}_{of}_{unit}", "mean, standard deviation and maximum of the error", unit)
            for part, unit in (("trans", "m"), ("rot", "deg"))
            for of in ("mean", "std", "max")
        ),
    ),
    when="logs with reference relations",
)  # fmt: skip
OF_SOURCES = "inliers accepted, outliers rejected, outliers accepted, inliers rejected"
SOURCES = File(
    "sources.csv", "[Fixes and closures](notes/verdict-rules.md#fixes-and-closures) by source.", (
        *RUN, text("source", "name of the source"), text("kind", "`position`, `heading`, `pose` or `closure`"),
        count("count", "measurements in the log"), count("used", "accepted ones"),
        Column("nis_mean", "NIS of the accepted ones per degree of freedom"),
        count("nis_dof", "their degrees of freedom"),
        *(Column(name, "95 % bounds behind the gate") for name in ("nis_low", "nis_high")),
        text("verdict", "a word of [verdicts](verdicts.md)"),
        *(count(name, OF_SOURCES) for name in ("tp", "tn", "fp", "fn")),
    ),
    when="logs with fixes or closures",
)  # fmt: skip
SPACE = File(
    "space.csv", "[Scores in 3-D](notes/results-files.md), a row per quantity.",
    (*WHO, PHASE, text("quantity", "name"), Column("value", "value")), when="results in 3-D",
)  # fmt: skip
PUBLISHED = File(
    "published.csv", "Comparison with published numbers.", (
        text("scenario", "name of the study"), ESTIMATOR, text("quantity", "compared quantity"),
        *(Column(name, "our number and its standard error") for name in ("ours", "se_ours")),
        *(Column(name, "published number and its standard error") for name in ("published", "se_published")),
        Column("difference_in_se", "difference in standard errors of the difference"),
    ),
    when="scenarios with published numbers",
)  # fmt: skip
TIMING = File(
    "timing.csv", "Run times of the estimators; they differ from run to run.", (
        *WHO, count("frames", "frames of the log"),
        Column("seconds", "wall time of the estimation, laser front end included", "s"),
        Column("frames_per_second", "frames / seconds", "1/s"),
    ),
)  # fmt: skip
DIFFERENCES = File(
    "slamref.score(...).differences", "Filter minus smoother under the same association method, for logs with truth.", (
        LOG, TASK, ASSOCIATION, text("a", "the filter"), text("b", "the smoother"),
        *(text(name, "their phases") for name in ("phase_a", "phase_b")),
        *(
            Column(f"{name}{suffix}", about, unit)
            for name, first, unit, what in (
                ("rmse_position", "_m", "m", "position RMSE (SLAM: after alignment)"),
                ("nees_pose", "", "", "mean pose NEES"),
            )
            for suffix, about, unit in (
                (first, f"difference in {what}", unit),
                ("_lower", "its 95 % bounds", unit),
                ("_upper", "its 95 % bounds", unit),
                ("_p", "p value of no difference", ""),
            )
        ),
        Column("block_frames", "mean block length of the bootstrap", "frames"),
        *(text(name, "reasons for missing bounds") for name in ("rmse_position_why", "nees_pose_why")),
    ),
)  # fmt: skip
_SUBJECT = "log, task, estimator and association method, where they apply"
NOTICES = File(
    "notices.csv", "Diagnostics of logs and runs: questions, notes, failures, implausible and lost runs.", (
        text("code", "one of a fixed list"), text("severity", "`info`, `warning`, or `error`: do not use the result"),
        *(text(name, _SUBJECT) for name in ("log", "task", "estimator", "association")),
        count("frame", "first frame, where it applies"),
        text("values", "JSON object of numbers and names, sorted by name"), text("text", "sentence of the report"),
    ),
)  # fmt: skip
TOP = (METRICS, DECISION_COUNTS, CONSISTENCY, TRUST, RELATIONS, SOURCES, SPACE, PUBLISHED, NOTICES, TIMING)
