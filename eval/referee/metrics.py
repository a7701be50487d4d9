"""The metrics of the referee, in the order of tables: column, unit, heading, format and preferred values of each."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from eval.referee.consistency import CHI2_3_MEDIAN, INSIDE_3SIGMA

Better = Literal["smaller", "larger", "nearer", "neither"]
"""The better one of two values; `nearer`: to the expected value."""


@dataclass(frozen=True)
class Metric:
    """A number per run and phase."""

    column: str
    heading: str  # short name, for tables
    unit: str = ""  # of the heading's number; `%`: a share, which tables show in percent
    better: Better = "neither"
    expected: float | None = None  # value of a consistent estimator, if there is one
    form: str = ".4g"  # format of one value; `d`: a whole number, `s`: a text
    spelled: str = ""  # full name, for lines of text; empty: the heading
    about: str = ""  # description in docs/results-folder.md; empty: the full name

    @property
    def percent(self) -> bool:
        """Whether tables show the column in percent."""
        return self.unit == "%"

    @property
    def head(self) -> str:
        """Head of a table's column: heading, expected value, unit."""
        scale = 100.0 if self.percent else 1.0
        expected = "" if self.expected is None else f" (expected {scale * self.expected:.3g})"
        return f"{self.heading}{expected}{self._unit}"

    @property
    def line(self) -> str:
        """Label of a single value in the column's unit: full name, unit, expected value."""
        expected = "" if self.expected is None else f" ({self.expected:.3g} expected)"
        return f"{self.spelled or self.heading}{'' if self.percent else self._unit}{expected}"

    @property
    def _unit(self) -> str:
        return f" [{self.unit}]" if self.unit else ""


def _count(column: str, heading: str, better: Better = "neither", spelled: str = "", about: str = "") -> Metric:
    return Metric(column, heading, better=better, form="d", spelled=spelled, about=about)


def _error(column: str, heading: str, unit: str, about: str = "") -> Metric:
    return Metric(column, heading, unit, "smaller", about=about)


def _consistent(column: str, heading: str, expected: float, spelled: str, unit: str = "") -> Metric:
    return Metric(column, heading, unit, "nearer", expected, spelled=spelled)


RUN = ("log", "task", "estimator", "association", "phase")  # columns that name the run and phase of a row
LAG1 = "lag-1 correlation of innovations"
MAJORITY = "landmark RMSE, true ids by majority of observations"
AGREEMENT = "share of pairings that agree with most pairings of the landmark"
RMSE_BOUNDS = "95 % bounds of position RMSE in localization (measured coverage 65 to 97 %)"
NEES_BOUNDS = "95 % bounds of mean pose NEES in localization (measured coverage 84 to 93 %)"
RELATIVE = (
    ("frame", "a frame", "over a frame"),
    *((f"{d}m", f"over {d} m", f"over {d} m of true path") for d in (1, 10)),
)
OF_ESTIMATES = (
    _count("frames", "frames", about="frames of the log"),
    _count("observations", "observations", about="observations; on laser logs tested loop closures"),
    _count("accepted", "accepted", about="observations paired with a landmark"),
    _count("rejected", "rejected", about="observations discarded (-2), gated out or deferred"),
    _count("landmarks", "landmarks", spelled="landmarks in the map"),
    _error("rmse_position_m", "position RMSE", "m", "position RMSE without alignment"),
    _error("rmse_heading_deg", "heading RMSE", "deg"),
    _error("max_position_m", "largest position error", "m"),
    _error("rmse_aligned_m", "aligned position RMSE", "m", "position RMSE after the best rigid alignment"),
    _error("rmse_landmark_m", "landmark RMSE", "m", "landmark RMSE of the last map without alignment"),
    _error("rms_from_batch_m", "RMS from batch", "m", "RMS distance from the path of `batch` with `known`"),
    _consistent("nees_pose", "pose NEES", 3.0, "mean pose NEES"),
    _consistent("nees_position", "position NEES", 2.0, "mean position NEES"),
    _consistent("nees_heading", "heading NEES", 1.0, "mean heading NEES"),
    _consistent("nis", "NIS per dof", 1.0, "NIS per degree of freedom"),
    Metric("nis_lower", "lower 95 % bound of NIS", about="95 % bounds of NIS per dof, for independent innovations"),
    Metric("nis_upper", "upper 95 % bound of NIS", about="95 % bounds of NIS per dof, for independent innovations"),
    _consistent("inside_3sigma", "inside 3σ", INSIDE_3SIGMA, "share of frames inside 3σ", "%"),
    _error("rmse_time_m", "time-weighted RMSE", "m", "position RMSE weighted by time"),
    _error("sse_position_m2", "sum of squared errors of positions", "m²"),
    _error("sse_landmark_m2", "sum of squared errors of landmarks", "m²"),
    Metric("innovation_lag1", f"{LAG1} ± SE", "", "nearer", 0.0, ".3f", about=LAG1),
    Metric("innovation_lag1_se", "standard error of the lag-1 correlation", form=".3f", about="its standard error"),
    Metric("nis_expected", "expected NIS", about="expected NIS per dof behind the gates"),
    _consistent("nees_pose_median", "median pose NEES", CHI2_3_MEDIAN, "median pose NEES"),
    _count("nees_left_out", "frames left out", spelled="frames whose covariance is nearly singular, in no NEES"),
    _count("lost_frame", "lost from frame", about="first frame in which the estimator is lost"),
    Metric("lost_why", "why lost", form="s", about="evidence for it, found without truth"),
    *(_error(f"rmse_position_{s}", f"{s} 95 % bound of position RMSE", "m", RMSE_BOUNDS) for s in ("lower", "upper")),
    *(Metric(f"nees_pose_{s}", f"{s} 95 % bound of mean pose NEES", about=NEES_BOUNDS) for s in ("lower", "upper")),
    Metric("log_score", "log score", "nats", "smaller", spelled="mean log score of the pose"),
    _error("crps_x_m", "CRPS of x", "m"),
    _error("crps_y_m", "CRPS of y", "m"),
    _error("crps_heading_rad", "CRPS of heading", "rad"),
    _error("energy_score_m", "energy score of the position", "m"),
    Metric("block_frames", "mean block of the intervals", "frames", about="mean block length of the bootstrap"),
    _error("rmse_landmark_majority_m", "landmark RMSE, named by majority", "m", MAJORITY),
    _count("iterations", "iterations", spelled="iterations of the optimizer"),
    Metric("last_step_sigma", "last step", "sigmas", "smaller", form=".1e", spelled="Newton step left in the end"),
    *(
        _error(f"rpe_{name}_{unit}", f"relative {kind} {over}", unit, f"RMS relative error {whole}")
        for name, over, whole in RELATIVE
        for kind, unit in (("error", "m"), ("turn error", "deg"))
    ),
    _count("matched", "matched", "neither", "poses of a result that the truth is known at", "poses with truth"),
    _count(
        "unmatched", "unmatched", "neither", "poses of a result that the truth is not known at", "poses without truth"
    ),
)  # columns of metrics.csv after `status`
OF_DECISIONS = (
    _count("tp", "TP", about="paired with the right landmark"),
    _count("tn", "TN", about="unpaired, and no landmark is right"),
    _count("fp", "FP", "smaller", about="paired with a wrong landmark: wrong + spurious"),
    _count("fn", "FN", "smaller", about="unpaired, but a landmark is right: duplicate + missed + deferred"),
    Metric("precision", "precision", "%", "larger", about="TP / (TP + FP)"),
    Metric("recall", "recall", "%", "larger", about="TP / (TP + FN)"),
    _count("wrong", "wrong (FP)", "smaller", about="FP where another landmark is right"),
    _count("spurious", "spurious (FP)", "smaller", about="FP where no landmark is right"),
    _count("duplicate", "duplicate (FN)", "smaller", about="FN that initialized another landmark"),
    _count("missed", "missed (FN)", "smaller", about="FN discarded finally"),
    _count("deferred", "deferred (FN)", "smaller", about="FN discarded first and paired later"),
    Metric(
        "share_within", "paired near the right landmark", "%", "larger", about="share of pairings within `within_m`"
    ),
    Metric("within_m", "what counts as near", "m", about="distance from the right landmark that counts as near"),
    Metric("majority_agreement", "paired with the landmark's majority", "%", "larger", about=AGREEMENT),
)  # columns of association.csv after those of the run
_BY_COLUMN = {m.column: m for m in (*OF_ESTIMATES, *OF_DECISIONS)}


def metric(column: str) -> Metric:
    """The metric of a column; KeyError if there is none."""
    return _BY_COLUMN[column]


def is_share(column: str) -> bool:
    """Whether tables show the column in percent."""
    return column in _BY_COLUMN and _BY_COLUMN[column].percent


def heads(columns: Sequence[str]) -> dict[str, str]:
    """Head of each column in a table: the metric's, else the column's name."""
    return {c: _BY_COLUMN[c].head if c in _BY_COLUMN else c for c in columns}
