"""What a log says of itself, made by hand: a `Trust` with any statistics, twins and blame."""

import math
from dataclasses import replace

from eval.referee.attribution import NOISE, NOTHING, Finding
from eval.referee.truth_free import Statistic
from eval.studies.diagnosis import Blame, Row, Trust
from eval.studies.sampled import Sample

MEASURED = {
    ("ekf", "nis"): Statistic(0.91, 1.0),
    ("ekf", "filter_smoother_median"): Statistic(30.3, 1.46),
    ("ekf", "filter_smoother_semidefinite"): Statistic(0.09, 1.0),
    ("ekf", "filter_smoother_largest"): Statistic(108.0, frame=61),
    ("batch", "nis"): Statistic(0.88, 1.0),
    ("batch", "residual_z1_mean"): Statistic(0.04, 0.0),
    ("batch", "residual_z1_spread"): Statistic(0.4),
    ("batch", "slope_odometry_theta_turn"): Statistic(-0.05, 0.0, 0.001),
    ("batch", "slope_z1_range"): Statistic(0.001, 0.0, 0.001),
}
TURN = Finding(NOISE, "systematic", "odometry_theta_turn", -0.05, 0.001, 900.0)


def sample(apart: float = 13.0, shift: float = 0.0, **more) -> Sample:
    """A log's, or a twin's, whose statistics are off by `shift`."""
    measured = {key: m._replace(value=m.value + shift) for key, m in MEASURED.items()}
    return Sample(measured, apart={"ekf": apart}, **more)


def said(*, twins: int = 0, association: str = "known", notices=(), **more) -> Trust:
    """A log beside `twins` twins that are 0.5 m, 0.6 m, ... from their smoother; NEES 2.9 where 3 is expected."""
    drawn = tuple(
        sample(0.5 + 0.1 * i, 0.01 * i, nees={("ekf", "online"): 2.9}, counts={"ekf": (90, 8, 1, 1)})
        for i in range(twins)
    )
    p = 1.0 / (twins + 1) if twins else math.nan
    rows = tuple(Row(e, n, m, m.expected, twins, p, p) for (e, n), m in MEASURED.items())
    return Trust("home", "slam", association, sample(), drawn, rows, notices=tuple(notices), **more)


def blamed(*findings: Finding, cause: str = NOTHING, objected: int = 0, **more) -> Trust:
    """The same beside 20 twins, with what is to blame."""
    made = said(twins=20, **more)
    keys = tuple(MEASURED)[:objected]
    return replace(made, blame=Blame(cause, findings, keys, len(MEASURED), 1 / 21 if objected else 0.6))
