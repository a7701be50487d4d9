"""Two paths in space made by formulas, and what evo 1.38.1 says of them when called as `test_evo.py` does."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from tests.oracle.evo_numbers import Said

ALONG = np.arange(240)
TIME = 0.1 * ALONG


def poses():
    """True and estimated positions (240, 3) and rotations; the estimate drifts, and is scaled, turned and shifted."""
    s = 2.0 * np.pi * ALONG / 240
    p = np.column_stack([12.0 * np.sin(s), 6.0 * np.sin(2.0 * s), 2.0 * np.cos(3.0 * s)])
    yaw = np.arctan2(12.0 * np.cos(2.0 * s), 12.0 * np.cos(s))
    R = Rotation.from_euler("ZYX", np.column_stack([yaw, 0.3 * np.sin(2.0 * s), 0.2 * np.cos(5.0 * s)]))
    wobble = np.column_stack([0.02 * np.sin(0.7 * ALONG), 0.03 * np.cos(1.3 * ALONG), 0.01 * np.sin(0.31 * ALONG)])
    drift = np.column_stack([0.002 * ALONG, -0.001 * ALONG, 0.0015 * ALONG])
    turn = Rotation.from_rotvec(np.column_stack([0.01 * np.sin(0.4 * ALONG), 2e-4 * ALONG, 0.02 * np.cos(0.2 * ALONG)]))
    whole = Rotation.from_rotvec([0.03, -0.05, 0.4])
    return (p, R), (1.04 * whole.apply(p + wobble + drift) + [0.3, -0.2, 0.15], whole * R * turn)


def files(folder):
    """`truth.tum`, `estimate.tum`, and `sparse.tum`: every second pose, 30 ms late, so that truth is interpolated."""
    truth, estimate = poses()
    some = ALONG[:236:2]
    for name, (p, R), time, rows in (
        ("truth", truth, TIME, ALONG),
        ("estimate", estimate, TIME, ALONG),
        ("sparse", estimate, TIME + 0.03, some),
    ):
        table = np.column_stack([time, p, R.as_quat()])[rows]
        np.savetxt(folder / f"{name}.tum", table, fmt="%.17g")


SAID = (
    Said(
        "evo_ape -r trans_part",
        "estimate",
        "none",
        {
            "rmse_position_3d_m": 3.992932162301987,
            "mean_position_3d_m": 3.7228152790247773,
            "median_position_3d_m": 4.2977076756764285,
            "std_position_3d_m": 1.4436598113840016,
            "min_position_3d_m": 0.2945651371203078,
            "max_position_3d_m": 5.42493038640052,
        },
    ),
    Said(
        "evo_ape -r angle_deg",
        "estimate",
        "none",
        {"rmse_rotation_3d_deg": 23.226078129996576, "max_rotation_3d_deg": 24.820739676217016},
    ),
    Said("evo_ape -r rot_part", "estimate", "none", {"rmse_rotation_part_3d": 0.5693454472864401}),
    Said(
        "evo_ape -r trans_part --align",
        "estimate",
        "se3",
        {
            "rmse_position_3d_m": 0.3238666191962971,
            "mean_position_3d_m": 0.31360442194006394,
            "median_position_3d_m": 0.34008859816009807,
            "std_position_3d_m": 0.08088172580550987,
            "min_position_3d_m": 0.07873182150360286,
            "max_position_3d_m": 0.4242432699252698,
        },
    ),
    Said(
        "evo_ape -r angle_deg --align",
        "estimate",
        "se3",
        {"rmse_rotation_3d_deg": 2.0545964616972454, "max_rotation_3d_deg": 3.098504004967742},
    ),
    Said("evo_ape -r rot_part --align", "estimate", "se3", {"rmse_rotation_part_3d": 0.0507094650186312}),
    Said(
        "evo_ape -r trans_part --align --correct_scale",
        "estimate",
        "sim3",
        {
            "rmse_position_3d_m": 0.1246839394302738,
            "mean_position_3d_m": 0.10272407613254421,
            "median_position_3d_m": 0.08278246614649237,
            "std_position_3d_m": 0.07066717013272462,
            "min_position_3d_m": 0.009482740872473978,
            "max_position_3d_m": 0.3347558347000898,
        },
    ),
    Said(
        "evo_ape -r angle_deg --align --correct_scale",
        "estimate",
        "sim3",
        {"rmse_rotation_3d_deg": 2.0545964616972454, "max_rotation_3d_deg": 3.098504004967742},
    ),
    Said(
        "evo_ape -r rot_part --align --correct_scale", "estimate", "sim3", {"rmse_rotation_part_3d": 0.0507094650186312}
    ),
    Said(
        "evo_ape -r trans_part --align_origin",
        "estimate",
        "first",
        {
            "rmse_position_3d_m": 0.47803649611056687,
            "mean_position_3d_m": 0.4420946762265016,
            "median_position_3d_m": 0.4090502398907227,
            "std_position_3d_m": 0.18185485659132875,
            "min_position_3d_m": 0.0,
            "max_position_3d_m": 0.7559552863061446,
        },
    ),
    Said(
        "evo_ape -r angle_deg --align_origin",
        "estimate",
        "first",
        {"rmse_rotation_3d_deg": 2.153370742385815, "max_rotation_3d_deg": 3.571621242165978},
    ),
    Said("evo_ape -r rot_part --align_origin", "estimate", "first", {"rmse_rotation_part_3d": 0.05314629789168759}),
    Said(
        "evo_ape -r trans_part --sync_method interpolation --t_max_diff 0.05",
        "sparse",
        "none",
        {
            "rmse_position_3d_m": 4.022957063113075,
            "mean_position_3d_m": 3.7713770093662737,
            "median_position_3d_m": 4.362423386116801,
            "std_position_3d_m": 1.400321029219682,
            "min_position_3d_m": 0.35993628633508246,
            "max_position_3d_m": 5.351541718702394,
        },
    ),
    Said(
        "evo_ape -r angle_deg --sync_method interpolation --t_max_diff 0.05",
        "sparse",
        "none",
        {"rmse_rotation_3d_deg": 23.2724781407997, "max_rotation_3d_deg": 25.623343696020886},
    ),
    Said(
        "evo_rpe -r trans_part -d 1 -u f --all_pairs --pairs_from_reference",
        "estimate",
        "none",
        {"rpe_frame_3d_m": 0.0335956088636002},
    ),
    Said(
        "evo_rpe -r angle_deg -d 1 -u f --all_pairs --pairs_from_reference",
        "estimate",
        "none",
        {"rpe_frame_3d_deg": 0.2397609394065358},
    ),
    Said(
        "evo_rpe -r trans_part -d 1 -u m --all_pairs --pairs_from_reference",
        "estimate",
        "none",
        {"rpe_1m_3d_m": 0.07149939051390515},
    ),
    Said(
        "evo_rpe -r angle_deg -d 1 -u m --all_pairs --pairs_from_reference",
        "estimate",
        "none",
        {"rpe_1m_3d_deg": 0.8539901271608944},
    ),
    Said(
        "evo_rpe -r trans_part -d 10 -u m --all_pairs --pairs_from_reference",
        "estimate",
        "none",
        {"rpe_10m_3d_m": 0.4407638730133984},
    ),
    Said(
        "evo_rpe -r trans_part -d 10 -u m --all_pairs --pairs_from_reference --align --correct_scale",
        "estimate",
        "sim3",
        {"rpe_10m_3d_m": 0.26483475625281777},
    ),
    Said(
        "evo_rpe -r angle_deg -d 10 -u m --all_pairs --pairs_from_reference",
        "estimate",
        "none",
        {"rpe_10m_3d_deg": 2.2857426002839905},
    ),
    Said(
        "evo_rpe -r angle_deg -d 10 -u m --all_pairs --pairs_from_reference --align --correct_scale",
        "estimate",
        "sim3",
        {"rpe_10m_3d_deg": 2.2857426002839905},
    ),
)
