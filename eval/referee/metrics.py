"""What the referee measures, each once: its column, unit, what it is called, how it is written, and what is best.

`metrics.csv` and `association.csv` take their columns from here in this order, the report and step mode their heads.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from eval.referee.consistency import CHI2_3_MEDIAN, INSIDE_3SIGMA

Better = Literal["smaller", "larger", "nearer", "neither"]
"""Which of two values is the better one; `nearer`: to the expected value; `neither`: a count that is no merit."""


@dataclass(frozen=True)
class Metric:
    """A number per run and phase.

    Attributes:
        column: of the CSV.
        heading: short, for the head of a table; `spelled`: in full, for a line of text (the heading, if not given).
        unit: of the heading's number; `%`: the column is a share, which tables show in percent.
        better: which values are.
        expected: what a consistent estimator has; None if nothing is expected.
        form: how one value is written alone; `d`: a whole number, `s`: a text.
        about: what the column holds, for docs/results-folder.md, where `spelled` or the heading does not say it all.
    """

    column: str
    heading: str
    unit: str = ""
    better: Better = "neither"
    expected: float | None = None
    form: str = ".4g"
    spelled: str = ""
    about: str = ""

    @property
    def percent(self) -> bool:
        """Whether the column is a share that tables show in percent."""
        return self.unit == "%"

    @property
    def head(self) -> str:
        """Head of a column in a table: heading, expected value, unit."""
        scale = 100.0 if self.percent else 1.0
        expected = "" if self.expected is None else f" (expected {scale * self.expected:.3g})"
        return f"{self.heading}{expected}{self._unit}"

    @property
    def line(self) -> str:
        """Name in front of a value as the column has it: spelled, unit, expected value."""
        expected = "" if self.expected is None else f" ({self.expected:.3g} expected)"
        return f"{self.spelled or self.heading}{'' if self.percent else self._unit}{expected}"

    @property
    def _unit(self) -> str:
        return f" [{self.unit}]" if self.unit else ""


def _count(column: str, heading: str, better: Better = "neither", spelled: str = "", about: str = "") -> Metric:
    return Metric(column, heading, better=better, form="d", spelled=spelled, about=about)


def _error(column: str, heading: str, unit: str, about: str = "") -> Metric:
    return Metric(column, heading, unit, "smaller", about=about)


def _relative(column: str, heading: str, unit: str, about: str) -> Metric:
    return _error(column, heading, unit, f"RMS relative error (all pairs, docs/results-files.md): {about}")


def _consistent(column: str, heading: str, expected: float, spelled: str, unit: str = "") -> Metric:
    return Metric(column, heading, unit, "nearer", expected, spelled=spelled)


RUN = ("log", "task", "estimator", "association", "phase")
"""Columns that say which run and phase a row is about."""
OF_ESTIMATES = (
    _count("frames", "frames", about="frames of the log: instants at which the pose is estimated"),
    _count("observations", "observations", about="observations of the log; on laser logs loop closures looked at"),
    _count("accepted", "accepted", about="observations paired with a landmark"),
    _count("rejected", "rejected", about="observations gated out or discarded (-2); the rest created landmarks"),
    _count("landmarks", "landmarks", spelled="landmarks in the map"),
    _error("rmse_position_m", "position RMSE", "m", "RMSE of the position over frames with truth, no alignment"),
    _error("rmse_heading_deg", "heading RMSE", "deg"),
    _error("max_position_m", "largest position error", "m"),
    _error("rmse_aligned_m", "aligned position RMSE", "m", "position RMSE after the best fit of rotation and shift"),
    _error("rmse_landmark_m", "landmark RMSE", "m", "RMSE of the landmarks of the last map, no alignment"),
    _error("rms_from_batch_m", "RMS from batch", "m", "RMS distance from the path of `batch` with `known`"),
    _consistent("nees_pose", "pose NEES", 3.0, "mean pose NEES"),
    _consistent("nees_position", "position NEES", 2.0, "mean position NEES"),
    _consistent("nees_heading", "heading NEES", 1.0, "mean heading NEES"),
    _consistent("nis", "NIS per dof", 1.0, "NIS per degree of freedom"),
    Metric(
        "nis_lower",
        "lower 95 % bound of NIS",
        about="lower end of the interval that holds 95 % of consistent runs' NIS per dof",
    ),
    Metric("nis_upper", "upper 95 % bound of NIS", about="upper end of that interval"),
    _consistent("inside_3sigma", "inside 3σ", INSIDE_3SIGMA, "share of frames inside 3σ", "%"),
    _error("rmse_time_m", "time-weighted RMSE", "m", "RMSE of the position, each frame weighted by its time"),
    _error("sse_position_m2", "sum of squared errors of positions", "m²"),
    _error("sse_landmark_m2", "sum of squared errors of landmarks", "m²"),
    Metric(
        "innovation_lag1",
        "lag-1 correlation of innovations ± SE",
        "",
        "nearer",
        0.0,
        ".3f",
        about="correlation of a landmark's innovations in successive frames",
    ),
    Metric("innovation_lag1_se", "standard error of the lag-1 correlation", form=".3f"),
    Metric("nis_expected", "NIS per dof that the gates let expect"),
    _consistent("nees_pose_median", "median pose NEES", CHI2_3_MEDIAN, "median pose NEES"),
    _count("nees_left_out", "frames left out", spelled="frames whose covariance is nearly singular, in no NEES"),
    _count("lost_frame", "lost from frame", about="frame from which the filter is lost; blank: never"),
    Metric("lost_why", "why lost", form="s", about="by what it shows that the filter is lost, without any truth"),
    _error("rmse_position_lower", "lower 95 % bound of position RMSE", "m"),
    _error("rmse_position_upper", "upper 95 % bound of position RMSE", "m"),
    Metric("nees_pose_lower", "lower 95 % bound of mean pose NEES"),
    Metric("nees_pose_upper", "upper 95 % bound of mean pose NEES"),
    Metric("log_score", "log score", "nats", "smaller", spelled="mean log score of the pose"),
    _error("crps_x_m", "CRPS of x", "m"),
    _error("crps_y_m", "CRPS of y", "m"),
    _error("crps_heading_rad", "CRPS of heading", "rad"),
    _error("energy_score_m", "energy score of the position", "m"),
    Metric("block_frames", "mean block of the intervals", "frames", about="mean block of the bootstrap behind bounds"),
    _error("rmse_landmark_majority_m", "landmark RMSE, named by majority", "m"),
    _count("iterations", "iterations", spelled="iterations of the optimizer"),
    Metric("last_step_sigma", "last step", "sigmas", "smaller", form=".1e", spelled="Newton step left in the end"),
    _relative("rpe_frame_m", "relative error a frame", "m", "translation, from a frame with truth to the next"),
    _relative("rpe_frame_deg", "relative turn error a frame", "deg", "turn, from a frame with truth to the next"),
    _relative("rpe_1m_m", "relative error over 1 m", "m", "translation, over 1 m of the true path"),
    _relative("rpe_1m_deg", "relative turn error over 1 m", "deg", "turn, over 1 m of the true path"),
    _relative("rpe_10m_m", "relative error over 10 m", "m", "translation, over 10 m of the true path"),
    _relative("rpe_10m_deg", "relative turn error over 10 m", "deg", "turn, over 10 m of the true path"),
    _count("matched", "matched", spelled="poses of a result that the truth is known at"),
    _count("unmatched", "unmatched", spelled="poses of a result that the truth is not known at"),
)
"""Columns of metrics.csv after `status`."""
OF_DECISIONS = (
    _count("tp", "TP", about="decisions for a landmark, the right one; on laser logs loop closures, as all here"),
    _count("tn", "TN", about="decisions for none, where none is right"),
    _count("fp", "FP", "smaller", about="decisions for a wrong landmark: wrong and spurious"),
    _count("fn", "FN", "smaller", about="decisions for none, where there is one: duplicate, missed and deferred"),
    Metric("precision", "precision", "%", "larger", about="TP of TP + FP"),
    Metric("recall", "recall", "%", "larger", about="TP of TP + FN"),
    _count("wrong", "wrong (FP)", "smaller", about="FP where another landmark is right"),
    _count("spurious", "spurious (FP)", "smaller", about="FP where none is right"),
    _count("duplicate", "duplicate (FN)", "smaller", about="FN that created a second landmark"),
    _count("missed", "missed (FN)", "smaller", about="FN that was discarded for good"),
    _count("deferred", "deferred (FN)", "smaller", about="FN that was discarded and paired later"),
    Metric("share_within", "paired near the right landmark", "%", "larger"),
    Metric("within_m", "what counts as near", "m"),
    Metric("majority_agreement", "paired with the landmark's majority", "%", "larger"),
)
"""Columns of association.csv after those of the run."""
_BY_COLUMN = {m.column: m for m in (*OF_ESTIMATES, *OF_DECISIONS)}


def metric(column: str) -> Metric:
    """The metric of a column; KeyError for a column that is none."""
    return _BY_COLUMN[column]


def is_share(column: str) -> bool:
    """Whether a column is a share, which tables show in percent."""
    return column in _BY_COLUMN and _BY_COLUMN[column].percent


def heads(columns: Sequence[str]) -> dict[str, str]:
    """Head of each column in a table; a column that is no metric is called by its own name."""
    return {c: _BY_COLUMN[c].head if c in _BY_COLUMN else c for c in columns}
