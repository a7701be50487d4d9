"""Two paths in space made by formulas, and what evo 1.38.1 says of them when called as `test_evo.py` does."""

import numpy as np
from scipy.spatial.transform import Rotation

from tests.oracle.evo_numbers import said

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
        ("truth", truth, TIME, ALONG), ("estimate", estimate, TIME, ALONG), ("sparse", estimate, TIME + 0.03, some),
    ):  # fmt: skip
        np.savetxt(folder / f"{name}.tum", np.column_stack([time, p, R.as_quat()])[rows], fmt="%.17g")


SAID = said("space")
