"""Two paths made by formulas, and what evo 1.38.1 says of them when called as `test_evo.py` does."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from data import se2
from eval.report.publish import write_tum

ALONG = np.arange(240)
TIME = 0.1 * ALONG


def files(folder):
    """`truth.tum`, `estimate.tum`, and `sparse.tum`: every second pose, 30 ms late, so that truth is interpolated."""
    truth, estimate = paths()
    some = ALONG[:236:2]
    write_tum(folder / "truth.tum", TIME, truth)
    write_tum(folder / "estimate.tum", TIME, estimate)
    write_tum(folder / "sparse.tum", TIME[some] + 0.03, estimate[some])


def paths():
    """True and estimated poses (240, 3) on a figure of eight; the estimate drifts, turned and shifted as a whole."""
    s = 2.0 * np.pi * ALONG / 240
    x, y = 12.0 * np.sin(s), 6.0 * np.sin(2.0 * s)
    truth = np.column_stack([x, y, np.arctan2(12.0 * np.cos(2.0 * s), 12.0 * np.cos(s))])
    wobble = np.column_stack(
        [0.02 * np.sin(0.7 * ALONG), 0.03 * np.cos(1.3 * ALONG), 0.01 * np.sin(0.31 * ALONG) + 2e-4 * ALONG]
    )
    drift = np.column_stack([0.002 * ALONG, -0.001 * ALONG, 0.0 * ALONG])
    estimate = truth + wobble + drift
    return truth, se2.compose(np.array([0.3, -0.2, 0.05]), estimate)


class Said(NamedTuple):
    """A call of evo on the truth and an estimate (`estimate` or `sparse`); what `eval.score` has to print for it."""

    call: str
    estimate: str
    align: str
    numbers: dict[str, float]


SAID = (
    Said(
        "evo_ape -r trans_part",
        "estimate",
        "none",
        {
            "rmse_position_m": 0.8412089618067852,
            "mean_position_m": 0.7585676776470719,
            "median_position_m": 0.7456744639807377,
            "std_position_m": 0.36360362464251833,
            "min_position_m": 0.0847118972484748,
            "max_position_m": 1.356583873632605,
        },
    ),
    Said("evo_ape -r angle_deg", "estimate", "none", {"rmse_heading_deg": 4.3279425138202905}),
    Said(
        "evo_ape -r trans_part --align",
        "estimate",
        "se2",
        {
            "rmse_position_m": 0.1390818023709938,
            "mean_position_m": 0.12838764027054653,
            "median_position_m": 0.12630479470762182,
            "std_position_m": 0.053482348270479964,
            "min_position_m": 0.004043540964870641,
            "max_position_m": 0.2820304704498254,
        },
    ),
    Said("evo_ape -r angle_deg --align", "estimate", "se2", {"rmse_heading_deg": 1.2782710415334722}),
    Said(
        "evo_ape -r trans_part --align_origin",
        "estimate",
        "first",
        {
            "rmse_position_m": 0.32277483041095284,
            "mean_position_m": 0.2839051492983978,
            "median_position_m": 0.28166331289098423,
            "std_position_m": 0.15356255190857512,
            "max_position_m": 0.5660801470118264,
        },
    ),
    Said("evo_ape -r angle_deg --align_origin", "estimate", "first", {"rmse_heading_deg": 1.6286065993212075}),
    Said(
        "evo_ape -r trans_part --sync_method interpolation --t_max_diff 0.05",
        "sparse",
        "none",
        {
            "rmse_position_m": 0.8442039186835377,
            "mean_position_m": 0.7701864206040949,
            "median_position_m": 0.8144765076242024,
            "std_position_m": 0.34567778904305285,
            "min_position_m": 0.00952488782286537,
            "max_position_m": 1.2928855175397782,
        },
    ),
    Said(
        "evo_ape -r angle_deg --sync_method interpolation --t_max_diff 0.05",
        "sparse",
        "none",
        {"rmse_heading_deg": 4.276259344785447},
    ),
    Said(
        "evo_rpe -r trans_part -d 1 -u f --all_pairs --pairs_from_reference",
        "estimate",
        "none",
        {"rpe_frame_m": 0.028993865337704736},
    ),
    Said(
        "evo_rpe -r angle_deg -d 1 -u f --all_pairs --pairs_from_reference",
        "estimate",
        "none",
        {"rpe_frame_deg": 0.12518953431528876},
    ),
    Said(
        "evo_rpe -r trans_part -d 1 -u m --all_pairs --pairs_from_reference",
        "estimate",
        "none",
        {"rpe_1m_m": 0.04753124065872655},
    ),
    Said(
        "evo_rpe -r angle_deg -d 1 -u m --all_pairs --pairs_from_reference",
        "estimate",
        "none",
        {"rpe_1m_deg": 0.4475166488175642},
    ),
    Said(
        "evo_rpe -r trans_part -d 10 -u m --all_pairs --pairs_from_reference",
        "estimate",
        "none",
        {"rpe_10m_m": 0.23665074448123719},
    ),
    Said(
        "evo_rpe -r angle_deg -d 10 -u m --all_pairs --pairs_from_reference",
        "estimate",
        "none",
        {"rpe_10m_deg": 0.6352038320487171},
    ),
)
