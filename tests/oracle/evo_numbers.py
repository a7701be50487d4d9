"""Paths in the plane and in space by formulas, and what evo 1.38.1 says of them when called as `test_evo.py` does."""

import csv
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

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
    estimate = truth + wobble + np.column_stack([0.002 * ALONG, -0.001 * ALONG, 0.0 * ALONG])
    return truth, se2.compose(np.array([0.3, -0.2, 0.05]), estimate)


class Said(NamedTuple):
    """A call of evo on the truth and an estimate (`estimate` or `sparse`); what `eval.score` has to print for it."""

    call: str
    estimate: str
    align: str
    numbers: dict[str, float]


def said(space: str) -> tuple[Said, ...]:
    """Its calls and numbers as recorded in `evo.csv`, in the `plane` or in `space`."""
    found: dict[tuple[str, str, str], dict[str, float]] = {}
    with (Path(__file__).parent / "evo.csv").open(newline="") as file:
        for where, *call, number, value in list(csv.reader(file))[1:]:
            if where == space:
                found.setdefault((*call,), {})[number] = float(value)
    return tuple(Said(*call, numbers) for call, numbers in found.items())


SAID = said("plane")


def paths_in_space():
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


def files_in_space(folder):
    """`truth.tum`, `estimate.tum`, and `sparse.tum`: every second pose, 30 ms late, so that truth is interpolated."""
    truth, estimate = paths_in_space()
    some = ALONG[:236:2]
    for name, (p, R), time, rows in (
        ("truth", truth, TIME, ALONG), ("estimate", estimate, TIME, ALONG), ("sparse", estimate, TIME + 0.03, some),
    ):  # fmt: skip
        np.savetxt(folder / f"{name}.tum", np.column_stack([time, p, R.as_quat()])[rows], fmt="%.17g")


SAID_IN_SPACE = said("space")
