"""The CSV files at the top of the result folder."""

from __future__ import annotations

from eval.referee.files.described import Column, File, count, measured, text
from eval.referee.metrics import OF_DECISIONS, OF_ESTIMATES

LOG = text("log", "name of the log")
TASK = text("task", "`localization` (in a known map) or `slam`")
ESTIMATOR = text("estimator", "name of the estimator, as on the command line")
ASSOCIATION = text(
    "association", "who paired the observations, as on the command line; `none`: nobody (dead reckoning)"
)
PHASE = text("phase", "`online`: each pose from the data up to its frame; `final`: every pose from all data")
RUN = (LOG, TASK, ESTIMATOR, ASSOCIATION, PHASE)

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
DECISIONS = File(
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
        TASK, ASSOCIATION, PHASE,
        Column("power", "probability that this test rejects a covariance claimed at 0.8 of the true one"),
        count("diverged", "runs that diverged or are implausible, in no average"),
    ),
)  # fmt: skip
TRUST = File(
    "trust.csv",
    "What each log says about itself, without any truth: statistics of innovations and residuals, beside those of"
    " twins (`--twins`).",
    (
        LOG, TASK, ESTIMATOR, ASSOCIATION,
        text("statistic", "its name: `nis`, `innovation_lag1`, `filter_smoother_...`, `residual_...`, `slope_...`"),
        Column("value", "of the log"),
        Column("expected", "by theory where there is a theory, else the median of the twins"),
        count("twins", "twins it is compared with"),
        Column("p", "p value against the twins, by rank; blank without twins"),
        Column("p_family", "p value corrected for all statistics of this log"),
        Column("se", "standard error of the value, where one is known"),
        count("frame", "frame that a largest value is found in"),
    ),
)  # fmt: skip
RELATIONS = File(
    "relations.csv",
    "Errors of the runs against a log's reference relations.",
    (
        LOG, ESTIMATOR, ASSOCIATION, PHASE,
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
)  # fmt: skip
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
)  # fmt: skip
TIMING = File(
    "timing.csv",
    "How long each estimator took; never the same twice, so not part of any comparison of bytes.",
    (
        LOG, TASK, ESTIMATOR, ASSOCIATION,
        count("frames", "frames of the log"),
        Column("seconds", "wall time of the estimation; of a laser log with the front end", "s"),
        Column("frames_per_second", "frames over seconds", "1/s"),
    ),
)  # fmt: skip
DIFFERENCES = File(
    "slamref.score(...).differences",
    "Filters (a) against smoothers (b) under the same association, on logs with truth: a minus b.",
    (
        LOG, TASK, ASSOCIATION,
        text("a", "the filter"), text("b", "the smoother"),
        text("phase_a", "its phase"), text("phase_b", "its phase"),
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
)  # fmt: skip
TOP = (METRICS, DECISIONS, CONSISTENCY, TRUST, RELATIONS, PUBLISHED, TIMING)
